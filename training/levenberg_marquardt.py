"""Levenberg-Marquardt on any problem that gives its loss and its normal equations.

Straight steps: damping by Nielsen's rule (1999, Damping parameter in Marquardt's method,
IMM-REP-1999-05), scaled by the diagonal after Marquardt (1963).

Geodesic steps: with the straight step v, the acceleration a solves (H + D) a = -J' r'' / 2, r''
the second derivative of the residuals along v, and v + a is taken if 2 |a| <= 0.75 |v|, both
measured by the damping D (Transtrum and Sethna 2012, Improvements to the Levenberg-Marquardt
algorithm for nonlinear least-squares minimization, arXiv 1201.5885). D is the root of the diagonal:
weights of a feedback path move a free run far more than others do, the full diagonal (Marquardt)
damps each of them by as much, and the descent is slow along the valley that they share; without any
scaling (Levenberg, 1944) weak weights wander. The root lies between the two.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from typing import Protocol

import numpy as np
from scipy.linalg import LinAlgError, cho_factor, cho_solve

from narxcal.support.arrays import FloatArray

_MOST_BEND = 0.75  # of the straight step, Transtrum and Sethna (2012)


class Equations(Protocol):
    """Loss, gradient (P,) and Gauss-Newton matrix (P, P) at one point."""

    @property
    def loss(self) -> float: ...  # noqa: D102
    @property
    def gradient(self) -> FloatArray: ...  # noqa: D102
    @property
    def hessian(self) -> FloatArray: ...  # noqa: D102


class Problem(Protocol):
    """What the optimiser needs."""

    def loss(self, theta: FloatArray) -> float: ...  # noqa: D102
    def normal_equations(self, theta: FloatArray) -> Equations: ...  # noqa: D102


class CurvedProblem(Problem, Protocol):
    """A problem that also gives the curvature of its residuals."""

    def curvature(self, theta: FloatArray, step: FloatArray) -> FloatArray:
        """J' r'' (P,), with r'' the second derivative of the residuals along `step`."""


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
    """Give the step v that solves the damped equations, and the step to take.

    Given are theta, (gradient, hessian) there and the damping.
    """

    def __call__(  # noqa: D102
        self, theta: FloatArray, slopes: tuple[FloatArray, FloatArray], damping: float
    ) -> tuple[FloatArray, FloatArray]: ...


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
    propose = propose or _straight
    damping = damping or Damping()
    while True:
        equations = problem.normal_equations(theta)
        gradient = equations.gradient + decay * theta
        hessian = equations.hessian + decay * np.eye(len(theta))
        loss = equations.loss + 0.5 * decay * float(theta @ theta)
        if not (np.isfinite(gradient).all() and np.isfinite(hessian).all()):
            return
        while True:
            straight, step = propose(theta, (gradient, hessian), damping.value)
            trial = theta + step
            after = problem.loss(trial) + 0.5 * decay * float(trial @ trial)
            promised = -float(straight @ gradient) - 0.5 * float(straight @ hessian @ straight)
            if after < loss and promised > 0:
                damping = damping.better((loss - after) / promised)
                break
            damping = damping.worse()
            if damping.value > 1e12:
                return
        theta = trial
        yield Step(theta, after, damping)


def _straight(
    theta: FloatArray, slopes: tuple[FloatArray, FloatArray], damping: float
) -> tuple[FloatArray, FloatArray]:
    del theta
    gradient, hessian = slopes
    diagonal = np.diag(hessian)
    scale = np.maximum(diagonal, 1e-9 * diagonal.max() + 1e-30)
    try:
        factor = cho_factor(hessian + damping * np.diag(scale))
    except LinAlgError:
        return np.zeros_like(gradient), np.zeros_like(gradient)
    solution: FloatArray = cho_solve(factor, -gradient)
    return solution, solution


def minimise_geodesic(
    problem: CurvedProblem, theta: FloatArray, decay: float = 0.0, damping: Damping | None = None
) -> Iterator[Step]:
    """Yield accepted steps downhill as `minimise` does, with geodesic acceleration."""
    return minimise(problem, theta, decay, damping, partial(_geodesic, problem))


def _geodesic(
    problem: CurvedProblem,
    theta: FloatArray,
    slopes: tuple[FloatArray, FloatArray],
    damping: float,
) -> tuple[FloatArray, FloatArray]:
    """Straight step v and v + a; both zero where the curvature is too large for either."""
    gradient, hessian = slopes
    nothing = np.zeros_like(gradient), np.zeros_like(gradient)
    scale = _scale(np.diag(hessian))
    try:
        factor = cho_factor(hessian + damping * np.diag(scale))
    except LinAlgError:
        return nothing
    straight = cho_solve(factor, -gradient)
    curvature = problem.curvature(theta, straight)
    if not np.isfinite(curvature).all():
        return nothing
    bend = -0.5 * cho_solve(factor, curvature)
    if 4.0 * float(bend**2 @ scale) > _MOST_BEND**2 * float(straight**2 @ scale):
        return nothing
    return straight, straight + bend


def _scale(diagonal: FloatArray) -> FloatArray:
    """Root of the diagonal (P,), in its units; never so little that a weight is undamped."""
    floored = np.maximum(diagonal, 1e-9 * diagonal.max() + 1e-30)
    return np.asarray(np.sqrt(floored * floored.mean()))
