"""What the rungs of a choice share: records, folds, a budget of work, and what was tried.

Work is counted in nominal microseconds, so that a choice does not depend on how busy the machine
is: what a step of Levenberg-Marquardt consists of, times rates that a command measures.
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
from narxcal.support.progress import Progress
from training.folds import RecordFold, by_piece
from training.ranking import Build, Form, Tried

UNITS_PER_S = 1_000_000  # nominal microseconds in a CPU second
_EMERGENCY = 4.0, 60.0  # the clock stops the search at so many times the limit and CPU s more
LAG, ARX, OUTPUT_ERROR = "first-order lag", "ARX", "linear output error"
NETWORK, LATENT, MEAN = "NARX network", "latent states", "mean"
FEW = 400  # samples per fold on which no form is worth trying
PLENTY = 30.0  # rows per parameter beyond which every further one is skipped while searching
_FAR = 3.0  # times the lowest loss of several draws: twice its error or nearly so

T = TypeVar("T")


@dataclass(frozen=True)
class Rates:
    """Microseconds of what a step of Levenberg-Marquardt consists of.

    | rate | counted |
    |---|---|
    | call | steps |
    | sample | samples |
    | unit | hidden units of every sample |
    | passed | entries of the sensitivities of every sample's states and scored outputs |
    | product | entries of J'J at every scored row |
    | factor | parameters, cubed |
    """

    call: float
    sample: float
    unit: float
    passed: float
    product: float
    factor: float

    def step(self, samples: float, rows: float, size: int, kind: tuple[int, int]) -> float:
        """Microseconds of a step on samples of which `rows` are scored, with `size` parameters.

        `kind` are the hidden units, and the states by which a sample acts on the next.
        """
        rates = (self.call, self.sample, self.unit, self.passed, self.product, self.factor)
        return sum(a * b for a, b in zip(rates, counted(samples, rows, size, kind), strict=True))


def counted(samples: float, rows: float, size: int, kind: tuple[int, int]) -> tuple[float, ...]:
    """How often each of the `Rates` is paid in a step."""
    hidden, states = kind
    return (
        1.0, samples, samples * hidden, (samples * states + rows) * size, rows * size**2,
        float(size) ** 3,
    )  # fmt: skip


# Written by `python -m eval.benchmarks.speed`.
LATENT_STEP = Rates(180.0, 0.24, 0.0034, 9.6e-4, 2.3e-5, 4.0e-5)
NETWORK_STEP = Rates(440.0, 0.0, 0.056, 1.3e-4, 2.4e-5, 1.4e-5)
_LEAST_SQUARES = 4000.0  # multiply-adds of a least-squares product in a microsecond


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

    @property
    def left(self) -> float:
        """Nominal microseconds not spent yet; below zero where more was spent."""
        return self.budget - self.spent

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
    folds: list[RecordFold]
    work: Work
    seed: int
    progress: Progress
    tried: list[Tried] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

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
        build: Build,
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

    def watch(self, share: float, what: str) -> None:
        """Show that this share of the work is done."""
        self.progress(round(100.0 * share), 100, what)

    def show(self) -> None:
        """Show how far the search is."""
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
