"""What the rungs of the ladder share: records, what is held out of them, what was tried, a budget.

Records of any system have no altitude or power: of fewer than four, blocks are held out, each run
free from two starts. With e the RMS errors of a piece in standard deviations of the outputs, forms
are compared piece by piece through ln e: a piece on which every form errs much, such as a record of
another kind, counts as much as any other. The score of a form is the geometric mean of e.

Work is planned in nominal microseconds, so that a choice does not depend on how busy the machine
is: what a step of Levenberg-Marquardt consists of, times rates that a command measures. The clock
ends a search, and a fit within it, only where the machine is slower than `_PACE` allows for.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TypeVar

import numpy as np

from narxcal.narx.forms import DynamicModel
from narxcal.narx.network import Scaling
from narxcal.record import Record, known_start
from narxcal.support.arrays import FloatArray, spans
from narxcal.support.progress import Progress
from training.estimator.latent import Data
from training.folds import surely_below

UNITS_PER_S = 1_000_000  # nominal microseconds in a CPU second
_PACE = 0.75  # of nominal speed: work that is not counted, and what other programs take of caches
_SEARCH = 0.85  # of the processor time at most; the rest is for the fit to all records
_GRACE_S = 1.0  # of processor time beyond the limit: modules are imported, linear forms are tried
LAG, ARX, OUTPUT_ERROR = "first-order lag", "ARX", "linear output error"
NETWORK, LATENT, MEAN = "NARX network", "latent states", "mean"
FEW = 400  # samples per fold on which no form is worth trying
PLENTY = 30.0  # rows per parameter beyond which every further one is skipped while searching
_FAR = 3.0  # times the lowest loss of several draws: twice its error or nearly so
_BETTER = 0.98  # of a simpler form's score, as for lags: folds have less data than the fit
_LEAST_ERROR = 1e-9  # standard deviations: pieces without any error compare, too
FOLDS = 4
WINDOW = 50  # measured samples before the longer of two held-out runs, at most a fifth of it
_PARTS = 3  # of a record from which one fold holds blocks out
_LONG = 4 * WINDOW  # samples of such a block at least: at most a quarter of it is the start
SHORTEST = 8  # samples of a piece; fewer leave nothing to hold out

T = TypeVar("T")
Build = Callable[[float], DynamicModel]  # fit with a share of what is left of the budget


@dataclass(frozen=True)
class Form:
    """What is tried: rung, description, number of parameters, samples per fold, and its sizes."""

    rung: str
    text: str
    parameters: int
    samples: int
    delay: tuple[int, ...] = ()
    order: int = 0
    hidden: int = 0


@dataclass(frozen=True, eq=False)
class Tried:
    """A form with its score by held-out piece, held-out errors and the fit to all records.

    One that is not `whole` was judged on some of the folds, and can't lead.
    """

    form: Form
    scores: FloatArray
    errors: tuple[FloatArray, ...]
    build: Build
    whole: bool = True

    @property
    def logs(self) -> FloatArray:
        """Natural logarithm of the error of each piece; infinite where a free run is not finite."""
        known = np.isfinite(self.scores)
        return np.log(np.where(known, np.maximum(self.scores, _LEAST_ERROR), np.inf))

    @property
    def score(self) -> float:
        """Geometric mean over pieces; infinite where one has no finite free run."""
        return float(np.exp(np.mean(self.logs)))


def beats(one: Tried, other: Tried) -> bool:
    """Whether `one` is clearly better (`training.folds.surely_below`), and by two percent."""
    return bool(surely_below(one.logs - other.logs, -float(np.log(_BETTER))))


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


# Written by `python -m eval.benchmarks.speed` of 5da55ff.
LATENT_STEP = Rates(180.0, 0.24, 0.0034, 9.6e-4, 2.3e-5, 4.0e-5)
NETWORK_STEP = Rates(440.0, 0.0, 0.056, 1.3e-4, 2.4e-5, 1.4e-5)
_LEAST_SQUARES = 4000.0  # multiply-adds of a least-squares product in a microsecond


def least_squares_cost(samples: float, width: int) -> float:
    """Nominal microseconds of a regression on `width` columns."""
    return samples * width**2 / _LEAST_SQUARES


class Budget:
    """Nominal microseconds spent of a budget, within a limit of processor time.

    `cut` is whether the clock shortened anything.
    """

    def __init__(self, limit_s: float) -> None:
        self.budget = _PACE * limit_s * UNITS_PER_S
        self.spent = 0.0
        self.cut = False
        self._began = time.process_time()
        self._limit_s, self._share, self._pace = limit_s, _SEARCH, _PACE

    def left(self) -> float:
        """Nominal microseconds not spent yet, fewer where the clock leaves fewer."""
        by_count = self.budget - self.spent
        in_time = self._pace * (self._limit_s + _GRACE_S - self._busy_s()) * UNITS_PER_S
        self.cut |= in_time < by_count
        return min(by_count, in_time)

    def spend(self, units: float) -> None:
        self.spent += units

    def late(self) -> bool:
        """Whether the search, or after it the fit to all records, has to end by the clock."""
        late = self._busy_s() > self._share * self._limit_s + _GRACE_S
        self.cut |= late
        return late

    def end_search(self) -> None:
        """Leave what is left of the time to the fit to all records, at the pace seen so far."""
        self._share = 1.0
        self._pace = min(_PACE, self.spent / (self._busy_s() * UNITS_PER_S))

    def _busy_s(self) -> float:
        return time.process_time() - self._began


@dataclass(eq=False)
class Search:
    """One search: its records and folds, what was tried and what was spent."""

    records: list[Record]
    folds: list[RecordFold]
    work: Budget
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
        count: int = self.records[0].u.shape[1]
        return count

    @property
    def outputs(self) -> int:
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

    def data(self, records: Sequence[Record], delay: tuple[int, ...], every: float = 1.0) -> Data:
        """Records as latent models are fitted to them, within the time of this search."""
        found = Data.of(records, delay, self.scalings, every, self.longest)
        return replace(found, late=self.work.late)

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


# ---- what is held out of records


@dataclass(frozen=True, eq=False)
class Run:
    """A held-out free run: all rows of `record` from `begin` on, `start` samples of it given."""

    record: Record
    begin: int
    start: int

    def error(self, model: DynamicModel) -> FloatArray:
        """Free run less measurement (scored samples, outputs)."""
        u, y = self.record.u[self.begin :], self.record.y[self.begin :]
        free = model.simulate(u, known_start(y, self.start))
        return (free - y)[self.start :]


@dataclass(frozen=True, eq=False)
class RecordFold:
    """Records to fit to, and held-out runs to judge on."""

    fit: tuple[Record, ...]
    held: tuple[Run, ...]


def record_folds(records: Sequence[Record], gap: int, count: int = 2 * FOLDS) -> list[RecordFold]:
    """Held-out records, or blocks where there are fewer than four; `gap` samples around left out.

    A fold of blocks holds out a sixth of all samples. Long records give two or three shorter blocks
    from different parts: a manoeuvre that is flown once would otherwise be held out whole, and the
    folds would ask for what no fit can know. Blocks overlap by a third from fold to fold, so that
    what happens rarely is not always at the edge of one.
    """
    if len(records) >= FOLDS:
        turns = min(count, len(records))
        groups = [
            [(k, 0, len(records[k])) for k in range(turn, len(records), turns)]
            for turn in range(turns)
        ]
    else:
        each = -(-count // len(records))
        groups = [
            [(k, a, b) for a, b in blocks]
            for k, record in enumerate(records)
            for blocks in _blocks(len(record), _block(record, len(records), each), each)
        ]
    found = []
    for held in groups:
        fit = [part for k, record in enumerate(records) for part in _without(record, k, held, gap)]
        runs = [run for k, a, b in held for run in runs_of(_cut_record(records[k], a, b))]
        if fit and runs:
            found.append(RecordFold(tuple(fit), tuple(runs)))
    return found


def _blocks(length: int, held: int, turns: int) -> list[list[tuple[int, int]]]:
    """In every turn `held` samples, in one to three blocks from different parts of a record."""
    parts = min(max(held // _LONG, 1), _PARTS)
    block, part = held // parts, length // parts
    firsts = np.linspace(0, part - block, turns).astype(int).tolist()
    return [
        [
            (first, first + block)
            for i in range(parts)
            for first in [i * part + firsts[(turn + i * turns // parts) % turns]]
        ]
        for turn in range(turns)
    ]


def _block(record: Record, records: int, each: int) -> int:
    """Length of a held-out block of one of few records."""
    return min(max(len(record) * records // 6, len(record) // each), len(record) // 2)


def _cut_record(record: Record, a: int, b: int) -> Record:
    weight = None if record.weight is None else record.weight[a:b]
    return Record(record.u[a:b], record.y[a:b], f"{record.name}[{a}:{b}]", weight)


def _without(
    record: Record, number: int, held: Sequence[tuple[int, int, int]], gap: int
) -> list[Record]:
    """What is left of a record, in pieces long enough to fit."""
    keep = np.ones(len(record), dtype=bool)
    for k, a, b in held:
        if k == number:
            keep[max(a - gap, 0) if a else 0 : b + gap if b < len(record) else b] = False
    return [_cut_record(record, a, b) for a, b in spans(keep) if b - a >= SHORTEST]


def runs_of(record: Record) -> list[Run]:
    """From the beginning with a window of outputs, from a third of it with half that window."""
    length = len(record)
    if length < SHORTEST:
        return []
    window = max(min(WINDOW, length // 5), 1)
    found = [Run(record, 0, window), Run(record, length // 3, max(window // 2, 1))]
    return [run for run in found if np.isfinite(record.y[run.begin + run.start :]).any()]


def thinned(records: Sequence[Record], most: int) -> list[Record]:
    """Records, or contiguous parts spread over each where all have more samples than `most`."""
    total = sum(map(len, records))
    if total <= most:
        return list(records)
    found = []
    for record in records:
        length = int(len(record) * most / total)
        chunks = max(min(4, length // 1000), 1)
        each = max(length // chunks, 4 * SHORTEST)
        for first in np.linspace(0, max(len(record) - each, 0), chunks).astype(int).tolist():
            part = _cut_record(record, first, min(first + each, len(record)))
            if np.isfinite(part.y).any():
                found.append(part)
    return found


def by_piece(runs: Sequence[Run], errors: Sequence[FloatArray]) -> list[float]:
    """Root mean square over the runs of each held-out piece."""
    found: dict[str, list[FloatArray]] = {}
    for run, error in zip(runs, errors, strict=True):
        found.setdefault(run.record.name, []).append(error.ravel() ** 2)
    return [float(np.sqrt(np.nanmean(np.concatenate(each)))) for each in found.values()]
