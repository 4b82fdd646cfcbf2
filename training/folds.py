"""What is held out: recordings, regions or blocks of few, and how scores on it are compared.

A model is chosen for flights that it has not seen. With three recordings or more each is held out
whole, in a few folds. One or two recordings are cut into stretches, and a fold holds out those of

    the highest third in altitude, the lowest third in power, the last third in time

and each of two recordings. A choice between models is by the mean over the held-out pieces of the
logarithm of their errors, so that a model which does well in the middle and fails at an edge loses.

Records of any system (`Narx`) have no altitude or power: of fewer than four, blocks are held out,
each run free from two starts.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Final, NamedTuple, TypeVar

import numpy as np
from scipy.special import ndtr, stdtrit

from data_prep.log import Log
from narxcal.narx.forms import DynamicModel
from narxcal.record import Record, known_start
from narxcal.support.arrays import BoolArray, FloatArray, known_mean, spans

T = TypeVar("T")
_LEAST = 1e-18  # of a mean square: outputs without any error compare, too
_THIRD: Final = 1.0 / 3.0
_RANGE_FT: Final = 1000.0  # of altitude: over it pressure changes by 3 %, outputs by that or less
_STRETCH_S: Final = 60.0  # a move with its settling
_STRETCHES: Final = (6, 24)  # of a log: thirds of it need so many; more divide moves
FOLDS = 4
WINDOW = 50  # measured samples before the longer of two held-out runs, at most a fifth of it
_PARTS = 3  # of a record from which one fold holds blocks out
_LONG = 4 * WINDOW  # samples of such a block at least: at most a quarter of it is the start
SHORTEST = 8  # samples of a piece; fewer leave nothing to hold out


class Fold(NamedTuple):
    """Indices of the items to fit to and of those to judge on."""

    fitted: list[int]
    judged: list[int]

    def of(self, items: Sequence[T]) -> tuple[list[T], list[T]]:
        """Items to fit to, and items to judge on."""
        return [items[k] for k in self.fitted], [items[k] for k in self.judged]


def held_out_folds(recordings: Sequence[str], most: int) -> list[Fold]:
    """Leave each recording out once, in at most `most` folds.

    `recordings` names the recording of each item; those of one recording stay together.
    """
    names = list(dict.fromkeys(recordings))
    fold = {name: number % most for number, name in enumerate(names)}
    of = [fold[name] for name in recordings]
    return [
        Fold(
            [k for k, one in enumerate(of) if one != number],
            [k for k, one in enumerate(of) if one == number],
        )
        for number in sorted(set(of))
    ]


def regions(
    time: FloatArray, power: FloatArray, altitude_ft: FloatArray | None
) -> dict[str, BoolArray]:
    """Which of the items (count,) each region holds; `time` is the share of the recording.

    Empty where items are alike in everything.
    """
    found = {}
    if altitude_ft is not None and np.ptp(altitude_ft) > _RANGE_FT:
        found["highest altitude"] = altitude_ft > np.quantile(altitude_ft, 1.0 - _THIRD)
    found["lowest power"] = power < np.quantile(power, _THIRD)
    found["last third"] = time > 1.0 - _THIRD
    return {name: held for name, held in found.items() if held.any() and not held.all()}


@dataclass(frozen=True, eq=False)
class LogFold:
    """Logs and parts of logs to fit to and to judge on; `name` says what is held out.

    `whole` tells recordings from regions.
    """

    name: str
    fitted: tuple[Log, ...]
    judged: tuple[Log, ...]
    whole: bool

    def piece(self, log: Log) -> str:
        """What a judged log counts for: its recording, or the region."""
        return log.source.file if self.whole else self.name


def log_folds(
    logs: Sequence[Log], power: Callable[[Log], FloatArray], most: int = 3
) -> list[LogFold]:
    """Folds of logs: of recordings in at most `most` folds, of one or two of them also of regions.

    `power` gives the power of a log (time,) in any unit.
    """
    files = [log.source.file for log in logs]
    many = len(set(files))
    found = [] if many > 2 else list(_of_regions(logs, power))
    if many > 1:
        for fold in held_out_folds(files, most):
            fitted, judged = fold.of(logs)
            name = ", ".join(dict.fromkeys(log.source.file for log in judged))
            found.append(LogFold(name, tuple(fitted), tuple(judged), whole=True))
    return found


def thirds(logs: Sequence[Log], most: int = 3) -> tuple[list[Log], list[Fold]]:
    """Logs and folds of whole recordings; of a single one, its thirds in time."""
    files = [log.source.file for log in logs]
    if len(set(files)) > 1:
        return list(logs), held_out_folds(files, most)
    parts, numbers = [], []
    for log in logs:
        edges = np.linspace(0, len(log), most + 1).astype(int).tolist()
        for number, (a, b) in enumerate(pairwise(edges)):
            parts.append(replace(log.part(a, b), name=f"{log.name}[{a}:{b}]"))
            numbers.append(str(number))
    return parts, held_out_folds(numbers, most)


def _of_regions(logs: Sequence[Log], power: Callable[[Log], FloatArray]) -> Iterator[LogFold]:
    cuts = [_edges(log) for log in logs]
    time = np.concatenate([(at[:-1] + at[1:]) / (2.0 * at[-1]) for at in cuts])
    level = np.concatenate([_means(power(log), at) for log, at in zip(logs, cuts, strict=True)])
    altitude = None
    if all(log.recorded(["ALT_ft"]) for log in logs):
        parts = [_means(log["ALT_ft"], at) for log, at in zip(logs, cuts, strict=True)]
        altitude = np.concatenate(parts)
    numbers = np.cumsum([0, *(len(at) - 1 for at in cuts)])
    for name, held in regions(time, level, altitude).items():
        fitted: list[Log] = []
        judged: list[Log] = []
        for log, at, (first, last) in zip(logs, cuts, pairwise(numbers), strict=True):
            for start, stop, out in _runs(held[first:last]):
                part = log.part(int(at[start]), int(at[stop]))
                part = replace(part, name=f"{log.name}[{at[start]}:{at[stop]}]")
                (judged if out else fitted).append(part)
        if fitted and judged:
            yield LogFold(name, tuple(fitted), tuple(judged), whole=False)


def _edges(log: Log) -> FloatArray:
    """Rows at which a log is cut into stretches of one length."""
    count = int(np.clip(len(log) * log.dt_s / _STRETCH_S, *_STRETCHES))
    return np.unique(np.linspace(0, len(log), count + 1).astype(int))


def _means(values: FloatArray, edges: FloatArray) -> FloatArray:
    """Mean of the known values in each stretch; the mean of all where none is known."""
    parts = [values[a:b][np.isfinite(values[a:b])] for a, b in pairwise(edges.astype(int).tolist())]
    usual = float(np.nanmean(values)) if np.isfinite(values).any() else 0.0
    return np.array([float(part.mean()) if len(part) else usual for part in parts])


def _runs(held: BoolArray) -> list[tuple[int, int, bool]]:
    """(start, stop, value) of the runs of equal values."""
    edges = [0, *(np.flatnonzero(np.diff(held.astype(int))) + 1).tolist(), len(held)]
    return [(a, b, bool(held[a])) for a, b in pairwise(edges)]


def geometric_rms(errors: Sequence[FloatArray]) -> float:
    """Geometric mean over the outputs of the RMS of `errors`, (time, outputs) each.

    Infinite where an output has no error that is a number.
    """
    square = np.concatenate([error**2 for error in errors]) if errors else np.empty((0, 1))
    mean = known_mean(square)
    if np.isnan(mean).any():
        return np.inf
    return float(np.exp(0.5 * np.mean(np.log(np.maximum(mean, _LEAST)))))


def surely_below(ratios: FloatArray, margin: float = 0.0) -> BoolArray:
    """Whether means (...,) of logarithms of ratios (pieces, ...) lie clearly below `-margin`.

    Student's one-sided t test on the pieces at 16 %, the risk of one standard error of many: the
    standard error of few is uncertain itself, and widened for it. Of one piece alone a `margin`
    above zero decides; without one it says nothing.
    """
    count, mean = len(ratios), ratios.mean(axis=0)
    if count < 2:
        return np.asarray((mean < -margin) & (margin > 0.0))
    error = ratios.std(axis=0, ddof=1) / np.sqrt(count) * stdtrit(count - 1, ndtr(1.0))
    return np.asarray(mean < -np.maximum(error, margin))


# ---- records of any system


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
