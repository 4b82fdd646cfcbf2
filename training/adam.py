"""Adam on the whole batch, behind the same iteration as Levenberg-Marquardt."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from narxcal.support.arrays import FloatArray


class GradientProblem(Protocol):
    """What Adam needs to know."""

    def gradient(self, theta: FloatArray) -> tuple[float, FloatArray]: ...  # noqa: D102


@dataclass(frozen=True)
class Moments:
    """State of Adam: first and second moments (P,) and the number of steps taken."""

    first: FloatArray
    second: FloatArray
    steps: int

    @classmethod
    def start(cls, size: int) -> Moments:
        """Before the first step."""
        return cls(np.zeros(size), np.zeros(size), 0)


@dataclass(frozen=True)
class AdamStep:
    """One step; `loss` is that before it, which costs nothing more."""

    theta: FloatArray
    loss: float
    moments: Moments


def minimise(
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
