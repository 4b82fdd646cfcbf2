"""Output error for a discrete linear state-space model, started from given matrices.

    x(k+1) = A x(k) + B u(k),   y(k) = C x(k) + D u(k),   x(0) = x0 of each record

All entries are free, so the n^2 directions of a change of state coordinates change no output; the
damping of Levenberg-Marquardt keeps the search where it is along them (Wills and Ninness, IEEE
Trans. Signal Processing 56(6), 2008). Such a fit has no standard deviations of entries, but errors,
and an AIC that counts the directions that are determined.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from narxcal.output_error.blocks import recursion
from narxcal.output_error.engine import Parameter
from narxcal.record import Record
from narxcal.transfer.state_space import StateSpace
from training.output_error import Plan, fit
from training.output_error_result import OutputErrorFit

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class LinearOutputError:
    """The system as a model for `training.output_error.fit`; entries are named like A_0_1."""

    start: StateSpace
    feedthrough: bool = True

    @property
    def parameters(self) -> Sequence[Parameter]:
        """All entries, and the initial state x0."""
        entries = [
            Parameter(name, value, free=matrix != "D" or self.feedthrough)
            for matrix in "ABCD"
            for name, value in self._entries(matrix)
        ]
        return [*entries, *(Parameter(f"x0_{i}", 0.0) for i in range(len(self.start.A)))]

    @property
    def output_names(self) -> Sequence[str]:
        """Numbered outputs."""
        return [f"y_{i}" for i in range(len(self.start.C))]

    @property
    def states(self) -> Sequence[str]:
        """Names of the initial states, which each record has of its own."""
        return [f"x0_{i}" for i in range(len(self.start.A))]

    def _entries(self, matrix: str) -> Iterator[tuple[str, float]]:
        for (i, j), value in np.ndenumerate(getattr(self.start, matrix)):
            yield f"{matrix}_{i}_{j}", float(value)

    def matrices(self, values: Mapping[str, complex]) -> list[NDArray[Any]]:
        """A, B, C, D from entries by name."""
        return [
            np.array([values[name] for name, _ in self._entries(matrix)]).reshape(
                getattr(self.start, matrix).shape
            )
            for matrix in "ABCD"
        ]

    def simulate(self, values: Mapping[str, complex], u: FloatArray) -> NDArray[Any]:
        """Outputs (time, p) for inputs (time, m); complex where a value is."""
        A, B, C, D = self.matrices(values)
        states = recursion(A, u[:-1] @ B.T, np.array([values[name] for name in self.states]))
        return np.asarray(states @ C.T + u @ D.T)


@dataclass(frozen=True, eq=False)
class LinearFit:
    """Polished system, initial state of each record by its name, and the fit behind it."""

    system: StateSpace
    x0: Mapping[str, FloatArray]
    fit: OutputErrorFit


def polish(
    start: StateSpace,
    records: Sequence[Record],
    sigma: Sequence[float] | None = None,
    *,
    feedthrough: bool = True,
    iterations: int = 60,
) -> LinearFit:
    """Minimise the free-run error of all records from the matrices `start`.

    `sigma` (p,) weighs the outputs; None estimates it. Without `feedthrough` D is kept. The initial
    states begin at zero. Raises as `fit` does.
    """
    model = LinearOutputError(start, feedthrough)
    known = None if sigma is None else dict(zip(model.output_names, sigma, strict=True))
    plan = Plan(per_record=tuple(model.states), sigma=known, iterations=iterations)
    found = fit(model, records, plan)
    x0 = {
        name: np.array([values[state] for state in model.states])
        for name, values in found.by_record.items()
    }
    A, B, C, D = model.matrices(found.parameters())
    return LinearFit(StateSpace(A, B, C, D, start.dt_s), x0, found)
