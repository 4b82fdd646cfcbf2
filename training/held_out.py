"""Held-out parts of records: whole records or blocks, each run free from two starts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from narxcal.narx.forms import DynamicModel
from narxcal.record import Record
from narxcal.support.arrays import FloatArray, spans

FOLDS = 4
WINDOW = 50  # measured samples before the longer of two held-out runs, at most a fifth of it
_PARTS = 3  # of a record from which one fold holds blocks out
_LONG = 4 * WINDOW  # samples of such a block at least: at most a quarter of it is the start
SHORTEST = 8  # samples of a piece; fewer leave nothing to hold out


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
class Fold:
    """What is fitted and what is held out."""

    fit: tuple[Record, ...]
    held: tuple[Run, ...]


def known_start(y: FloatArray, samples: int) -> FloatArray:
    """The first `samples` outputs; a masked one takes its channel's first known value."""
    first = y[np.isfinite(y).argmax(axis=0), np.arange(y.shape[1])]
    return np.where(np.isfinite(y[:samples]), y[:samples], np.nan_to_num(first))


def folds_of(records: Sequence[Record], gap: int, count: int = 2 * FOLDS) -> list[Fold]:
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
        runs = [run for k, a, b in held for run in runs_of(_cut(records[k], a, b))]
        if fit and runs:
            found.append(Fold(tuple(fit), tuple(runs)))
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


def _cut(record: Record, a: int, b: int) -> Record:
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
    return [_cut(record, a, b) for a, b in spans(keep) if b - a >= SHORTEST]


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
            part = _cut(record, first, min(first + each, len(record)))
            if np.isfinite(part.y).any():
                found.append(part)
    return found


def by_piece(runs: Sequence[Run], errors: Sequence[FloatArray]) -> list[float]:
    """Root mean square over the runs of each held-out piece."""
    found: dict[str, list[FloatArray]] = {}
    for run, error in zip(runs, errors, strict=True):
        found.setdefault(run.record.name, []).append(error.ravel() ** 2)
    return [float(np.sqrt(np.nanmean(np.concatenate(each)))) for each in found.values()]
