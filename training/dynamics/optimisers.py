"""Optimisers that yield their steps: Levenberg-Marquardt and Adam, on any problem.

Damping is by Nielsen's rule (1999, Damping parameter in Marquardt's method, IMM-REP-1999-05),
scaled by the diagonal after Marquardt (1963).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from scipy.linalg import LinAlgError, cho_factor, cho_solve

from narxcal.support.arrays import BoolArray, FloatArray

Late = Callable[[], bool]  # whether a descent has to end and give what it has found


def unlimited() -> bool:
    return False


@dataclass(frozen=True, eq=False)
class Equations:
    """Loss, gradient (P,) and Gauss-Newton matrix (P, P) at one point."""

    loss: float
    gradient: FloatArray
    hessian: FloatArray


class Problem(Protocol):
    """What the optimiser needs."""

    def loss(self, theta: FloatArray) -> float: ...
    def normal_equations(self, theta: FloatArray) -> Equations: ...


@dataclass(frozen=True)
class Step:
    """One accepted step."""

    theta: FloatArray
    loss: float
    damping: Damping


@dataclass(frozen=True)
class Damping:
    """State of Nielsen's rule: the damping and the factor by which the next failure grows it."""

    value: float = 1e-3
    growth: float = 2.0

    def worse(self) -> Damping:
        """After a step that did not lower the loss."""
        return Damping(self.value * self.growth, self.growth * 2.0)

    def better(self, gain: float) -> Damping:
        """After a step that lowered it by `gain` times what the linear model promised."""
        shrink = max(1.0 / 3.0, 1.0 - (2.0 * gain - 1.0) ** 3)
        return Damping(max(self.value * shrink, 1e-12))


class Proposal(Protocol):
    """Give the step that solves the damped equations from (gradient, hessian) at theta."""

    def __call__(
        self, theta: FloatArray, slopes: tuple[FloatArray, FloatArray], damping: float
    ) -> FloatArray: ...


def minimise(
    problem: Problem,
    theta: FloatArray,
    decay: float = 0.0,
    damping: Damping | None = None,
    propose: Proposal | None = None,
) -> Iterator[Step]:
    """Yield accepted steps downhill from `theta` until none is found any more.

    There is none where the normal equations overflow, as those of a diverging run do. `decay` adds
    decay/2 * |theta|^2 to the loss. The caller decides when to stop, and can go on from any step by
    giving its theta and damping back: the path is the same.
    """
    propose = propose or _free
    damping = damping or Damping()
    while True:
        equations = problem.normal_equations(theta)
        gradient = equations.gradient + decay * theta
        hessian = equations.hessian + decay * np.eye(len(theta))
        loss = equations.loss + 0.5 * decay * float(theta @ theta)
        if not (np.isfinite(gradient).all() and np.isfinite(hessian).all()):
            return
        while True:
            step = propose(theta, (gradient, hessian), damping.value)
            trial = theta + step
            after = problem.loss(trial) + 0.5 * decay * float(trial @ trial)
            promised = -float(step @ gradient) - 0.5 * float(step @ hessian @ step)
            if after < loss and promised > 0:
                damping = damping.better((loss - after) / promised)
                break
            damping = damping.worse()
            if damping.value > 1e12:
                return
        theta = trial
        yield Step(theta, after, damping)


def _free(theta: FloatArray, slopes: tuple[FloatArray, FloatArray], damping: float) -> FloatArray:
    del theta
    gradient, hessian = slopes
    diagonal = np.diag(hessian)
    scale = np.maximum(diagonal, 1e-9 * diagonal.max() + 1e-30)
    try:
        factor = cho_factor(hessian + damping * np.diag(scale))
    except LinAlgError:
        return np.zeros_like(gradient)
    solution: FloatArray = cho_solve(factor, -gradient)
    return solution


def within(low: FloatArray, high: FloatArray) -> Proposal:
    """Steps projected on the bounds (P,); what a bound stops is left out (Bertsekas 1982).

    SIAM J. Control 20(2).
    """

    def propose(
        theta: FloatArray, slopes: tuple[FloatArray, FloatArray], damping: float
    ) -> FloatArray:
        gradient, hessian = slopes
        move = np.flatnonzero(~stopped(theta, gradient, low, high))
        step = np.zeros_like(theta)
        if len(move):
            part = gradient[move], hessian[np.ix_(move, move)]
            step[move] = _free(theta[move], part, damping)
        return np.clip(theta + step, low, high) - theta

    return propose


def stopped(
    theta: FloatArray, gradient: FloatArray, low: FloatArray, high: FloatArray
) -> BoolArray:
    """Parameters on a bound beyond which the loss would fall."""
    return ((theta <= low) & (gradient > 0.0)) | ((theta >= high) & (gradient < 0.0))


# ---- Adam on the whole batch


class GradientProblem(Protocol):
    """What Adam needs."""

    def gradient(self, theta: FloatArray) -> tuple[float, FloatArray]: ...


@dataclass(frozen=True)
class Moments:
    """State of Adam: first and second moments (P,) and the number of steps taken."""

    first: FloatArray
    second: FloatArray
    steps: int

    @classmethod
    def start(cls, size: int) -> Moments:
        return cls(np.zeros(size), np.zeros(size), 0)


@dataclass(frozen=True)
class AdamStep:
    """One step; `loss` is that before it, which costs nothing more."""

    theta: FloatArray
    loss: float
    moments: Moments


def adam(
    problem: GradientProblem,
    theta: FloatArray,
    rate: float,
    decay: float = 0.0,
    moments: Moments | None = None,
) -> Iterator[AdamStep]:
    """Yield steps of torch.optim.Adam for ever; going on from any step gives the same path."""
    import torch  # noqa: PLC0415 (takes seconds; only this optimiser needs it)

    moments = moments or Moments.start(len(theta))
    parameter = torch.nn.Parameter(torch.from_numpy(theta.copy()))
    optimiser = torch.optim.Adam([parameter], lr=rate)
    state = optimiser.state[parameter]
    state["step"] = torch.tensor(float(moments.steps))
    state["exp_avg"] = torch.from_numpy(moments.first.copy())
    state["exp_avg_sq"] = torch.from_numpy(moments.second.copy())
    while True:
        here = parameter.detach().numpy()
        loss, gradient = problem.gradient(here)
        parameter.grad = torch.from_numpy(gradient + decay * here)
        loss += 0.5 * decay * float(here @ here)
        optimiser.step()
        after = Moments(
            state["exp_avg"].numpy().copy(), state["exp_avg_sq"].numpy().copy(), int(state["step"])
        )
        yield AdamStep(parameter.detach().numpy().copy(), loss, after)
