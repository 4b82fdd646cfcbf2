"""What the rungs of a choice share: records, folds, a budget of work, and what was tried.

Work is counted in nominal microseconds of a sample-step, so that a choice does not depend on how
busy the machine is. The costs below are multiply-adds over measured rates.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TypeVar

import numpy as np

from narxcal.narx.forms import DynamicModel
from narxcal.narx.network import Scaling
from narxcal.record import Record
from training.held_out import Fold, by_piece
from training.ranking import Form, Tried

UNITS_PER_S = 1_000_000  # sample-steps of one nominal microsecond in a CPU second
_EMERGENCY = 4.0, 60.0  # the clock stops the search at so many times the limit and CPU s more
_STEP = 0.6  # nominal microseconds of a free run's sample-step in addition to its products
_CALL = 200.0  # nominal microseconds of a step of Levenberg-Marquardt on no samples
# Multiply-adds in a nominal microsecond: of a least-squares product, of the recursion of
# sensitivities, of J'J, of which half is computed, and of its factor.
_LEAST_SQUARES, _RECURSION, _PRODUCT, _CHOLESKY = 4000.0, 10_000.0, 20_000.0, 15_000.0
LAG, ARX, OUTPUT_ERROR = "first-order lag", "ARX", "linear output error"
NETWORK, LATENT, MEAN = "NARX network", "latent states", "mean"
FEW = 400  # samples per fold on which no form is worth trying
PLENTY = 30.0  # rows per parameter beyond which every further one is skipped while searching
_FAR = 3.0  # times the lowest loss of several draws: twice its error or nearly so

Watch = Callable[[float, str], None]
T = TypeVar("T")


def step_cost(samples: float, rows: float, size: int, fed: int) -> float:
    """Nominal microseconds of a step of Levenberg-Marquardt on samples of which `rows` are scored.

    `size` parameters act through `fed` products of sensitivities a sample.
    """
    own = samples * (_STEP + fed * size / _RECURSION) + rows * size**2 / _PRODUCT
    return own + _CALL + size**3 / _CHOLESKY


def least_squares_cost(samples: float, width: int) -> float:
    """Nominal microseconds of a regression on `width` columns."""
    return samples * width**2 / _LEAST_SQUARES


@dataclass
class Work:
    """Nominal microseconds spent of a budget; the clock stops a search only in an emergency."""

    limit_s: float
    spent: float = 0.0
    began: float = field(default_factory=time.process_time)

    @property
    def budget(self) -> float:
        """Nominal microseconds in all."""
        return self.limit_s * UNITS_PER_S

    def spend(self, units: float) -> None:
        """Count work that is done."""
        self.spent += units

    @property
    def late(self) -> bool:
        """Whether the machine is so slow that the search has to end."""
        return time.process_time() - self.began > _EMERGENCY[0] * self.limit_s + _EMERGENCY[1]


@dataclass(eq=False)
class Search:
    """One search: its records and folds, what was tried and what was spent."""

    records: list[Record]
    folds: list[Fold]
    work: Work
    seed: int
    watch: Watch
    tried: list[Tried] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    finals: int = 1  # models to be fitted to all records, which share what is kept for that

    @cached_property
    def scalings(self) -> tuple[Scaling, Scaling]:
        """Of inputs and outputs over all records."""
        return (
            Scaling.of(np.concatenate([record.u for record in self.records])),
            Scaling.of(np.concatenate([record.y for record in self.records])),
        )

    @property
    def inputs(self) -> int:
        """Number of inputs."""
        count: int = self.records[0].u.shape[1]
        return count

    @property
    def outputs(self) -> int:
        """Number of outputs."""
        count: int = self.records[0].y.shape[1]
        return count

    @cached_property
    def samples(self) -> int:
        """Samples of all records."""
        return sum(map(len, self.records))

    @cached_property
    def longest(self) -> int:
        """Samples of the longest record."""
        return max(map(len, self.records))

    @cached_property
    def whole(self) -> int:
        """Samples that the largest fold fits."""
        return max(sum(map(len, fold.fit)) for fold in self.folds)

    def judge(
        self,
        form: Form,
        fits: Sequence[DynamicModel],
        build: Callable[[], DynamicModel],
        folds: Sequence[int] | None = None,
    ) -> Tried:
        """Judge one model per fold, or per fold of the given numbers, on what it held out."""
        scores, errors, scale = [], [], self.scalings[1].scale
        numbers = range(len(self.folds)) if folds is None else folds
        for model, number in zip(fits, numbers, strict=True):
            fold = self.folds[number]
            own = [run.error(model) / scale for run in fold.held]
            errors += own
            scores += by_piece(fold.held, own)
        whole = len(numbers) == len(self.folds)
        return Tried(form, np.array(scores), tuple(errors), build, whole)

    def note(self, text: str) -> None:
        """Add to the status once."""
        self.notes += [] if text in self.notes else [text]

    def show(self) -> None:
        """Tell how far the search is."""
        self.watch(min(0.1 + 0.8 * self.work.spent / self.work.budget, 0.9), "choosing")


def near_the_best(fits: Sequence[T], loss: Callable[[T], float]) -> list[T]:
    """Fits of several draws without those that ended in a minimum far above the lowest one."""
    least = min(map(loss, fits))
    return [fit for fit in fits if loss(fit) <= _FAR * least]


def most_samples(cost: Callable[[int], float], units: float, limit: int) -> int:
    """Samples, at most `limit`, on which a step of rising `cost` takes `units`."""
    low, high = 0, limit
    while low < high:
        middle = (low + high + 1) // 2
        if cost(middle) <= units:
            low = middle
        else:
            high = middle - 1
    return low


def dead(delay: tuple[int, ...]) -> str:
    """Dead times in words."""
    return f", dead time {', '.join(map(str, delay))}" if any(delay) else ""
