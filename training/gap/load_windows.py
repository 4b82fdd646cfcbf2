"""Windows of a load that was found by its levels: when each began and ended, and its size."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from narxcal.effects.running import Flights
from narxcal.support.arrays import BoolArray, FloatArray, spans
from training.budget.result import Interval
from training.gap.levels import Found, Levels, of_paths
from training.gap.load_edges import Change, Heard, Moment, moments
from training.gap.load_noise import restless
from training.gap.path_windows import Window
from training.gap.quadratic import Misfit

_BLOCK_S, _APART_S, _SEEN_S = 0.5, 3.0, 150.0  # between edges of a path, how far one may be off
_SURE_S = 15.0  # of levels at rest that an edge may be wrong by, where the path has them
_Z90 = 1.645
_MEMORY = 10.0  # blocks after which a level wanders anew
_ROUNDS = 2  # edges, then levels and shift by them


@dataclass(frozen=True, eq=False)
class Searched:
    """What windows were found in: flights, their gap, and its levels.

    `shift` (channels,) is given where it is known from other flights.
    """

    flights: Flights
    measure: Misfit
    levels: Levels
    shift: FloatArray | None = None


class _Span(NamedTuple):
    """A window of the flights in `rows`, from `start` to `stop`."""

    rows: tuple[int, ...]
    start: Moment
    stop: Moment


def told(found: Found, searched: Searched) -> tuple[tuple[Window, ...], FloatArray]:
    """Windows of every flight, and `on` (flights, time)."""
    levels, placed = searched.levels, _of_path(found, searched)
    for _ in range(_ROUNDS):
        placed = _placed(placed, found, searched)
        on = _on(placed, searched.flights)
        found = of_paths(_in_blocks(on, levels), levels, searched.shift)
    windows = []
    for rows, start, stop in placed:
        times, size = (start.at_s, stop.at_s), _block_s(searched)
        first, last = (round(each / size) for each in times)
        where = (start.low_s, start.high_s), (stop.low_s, stop.high_s)
        windows += [
            Window(f, *times, _sizes(found, levels, (f, first, last)), 0.0, *where) for f in rows
        ]
    return tuple(windows), on


def _block_s(searched: Searched) -> float:
    """Seconds of a block of the levels."""
    steps, count = searched.measure.gap.shape[1], searched.levels.known.shape[1]
    return float(max(1, steps // count) * searched.flights.signals.dt_s)


def _of_path(found: Found, searched: Searched) -> list[_Span]:
    """Windows as the path of blocks has them; what reaches an end of a flight stays there."""
    size, placed = _block_s(searched), []
    for group in searched.levels.groups:
        for first, stop in spans(found.on[group[0]]):
            start, end = (Moment(k * size, k * size, k * size) for k in (first, stop))
            placed.append(_Span(tuple(group), start, end))
    return placed


def _on(placed: Sequence[_Span], flights: Flights) -> FloatArray:
    """1 in the windows, (flights, time)."""
    on, dt_s = np.zeros(flights.u.shape[:2]), flights.signals.dt_s
    for rows, start, stop in placed:
        on[list(rows), round(start.at_s / dt_s) : round(stop.at_s / dt_s)] = 1.0
    return on


def _in_blocks(on: FloatArray, levels: Levels) -> BoolArray:
    count = levels.known.shape[1]
    size = max(1, on.shape[1] // count)
    return np.asarray(on[:, : count * size].reshape(len(on), count, size).mean(axis=2) > 0.5)


def _placed(placed: Sequence[_Span], found: Found, searched: Searched) -> list[_Span]:
    """The windows with their edges where the gap says."""
    changes = _changes(placed, searched)
    heard = _heard(placed, found, searched)
    size = round(heard.block_s / searched.flights.signals.dt_s)
    at = moments(heard, list(changes.values()), restless(searched.flights, size))
    moved = dict(zip(changes, at, strict=True))
    again = [
        _Span(one.rows, moved.get((j, 1.0), one.start), moved.get((j, -1.0), one.stop))
        for j, one in enumerate(placed)
    ]
    return [each for each in again if each.start.at_s < each.stop.at_s]


def _changes(placed: Sequence[_Span], searched: Searched) -> dict[tuple[int, float], Change]:
    """Edges by window and sign; none where a window reaches an end of its flight.

    An edge is at most half-way to the next one, lest a window go where another one is, and not far
    beyond the rest on either side of it: what the levels there say, a move farther off does not.
    """
    changes, flights = {}, searched.flights
    for rows in dict.fromkeys(each.rows for each in placed):
        own = [j for j, each in enumerate(placed) if each.rows == rows]
        ends = [(j, sign) for j in own for sign in (1.0, -1.0)]
        last = float(flights.lengths[list(rows)].max()) * flights.signals.dt_s
        times = [placed[j].start.at_s if sign > 0.0 else placed[j].stop.at_s for j, sign in ends]
        for k, (key, at) in enumerate(zip(ends, times, strict=True)):
            if _APART_S < at < last - _APART_S:
                near = 0.5 * (at - (times[k - 1] if k else 0.0)), 0.5 * ((*times, last)[k + 1] - at)
                before, after = _rest_beside(at, rows, searched)
                low = max(at - min(near[0], _SEEN_S), before - _SURE_S)
                high = min(at + min(near[1], _SEEN_S), after + _SURE_S)
                changes[key] = Change(rows, at, key[1], low, high)
    return changes


def _rest_beside(at_s: float, rows: tuple[int, ...], searched: Searched) -> tuple[float, float]:
    """End of the last block before `at_s` in which a level is known, begin of the first one after.

    In seconds; the flight's own begin and end where there is none.
    """
    size = _block_s(searched)
    known = np.atleast_1d(searched.levels.known[list(rows)].any(axis=0))
    edge = round(at_s / size)
    before, after = np.flatnonzero(known[:edge]), np.flatnonzero(known[edge:])
    last = size * float(before[-1] + 1) if len(before) else 0.0
    first = size * float(edge + after[0]) if len(after) else size * len(known)
    return last, first


def _heard(placed: Sequence[_Span], found: Found, searched: Searched) -> Heard:
    """The gap with the load in it, less each flight's own nuisances, in short blocks."""
    measure, levels, dt_s = searched.measure, searched.levels, searched.flights.signals.dt_s
    flights, steps, channels = measure.gap.shape
    rows = np.arange(steps) // max(1, steps // levels.known.shape[1])
    own = levels.residual - found.left - found.on[..., None] * found.shift
    known = measure.weights > 0.0
    gap = np.where(known, measure.gap - own[:, np.minimum(rows, own.shape[1] - 1)], 0.0)
    size = max(1, round(_BLOCK_S / dt_s))
    count = steps // size
    shape = (flights, count, size, channels)
    share = known[:, : count * size].reshape(shape).mean(axis=2)
    mean = gap[:, : count * size].reshape(shape).mean(axis=2) / np.maximum(share, 1e-9)
    begin = np.zeros(flights)
    for each in placed:
        if each.start.at_s <= _APART_S < each.stop.at_s:
            begin[list(each.rows)] = 1.0
    return Heard(mean, share, begin, found.shift, size * dt_s)


def _scale(found: Found, levels: Levels) -> FloatArray:
    known = found.left[levels.known]
    return np.asarray(np.maximum(1.4826 * np.median(np.abs(known), axis=0), 1e-9))


def _sizes(found: Found, levels: Levels, where: tuple[int, int, int]) -> tuple[Interval, ...]:
    """Shift in one window of one flight, with 90 % intervals."""
    (f, first, stop), scale = where, _scale(found, levels)
    inside = levels.known[f].copy()
    inside[:first], inside[stop:] = False, False
    off = levels.known[f] & ~found.on[f]
    rest = found.left[f]
    more = rest[inside].mean(axis=0) if inside.any() else np.zeros(len(scale))
    heard = [max(1.0, np.count_nonzero(each) / _MEMORY) for each in (inside, off)]
    reach = _Z90 * scale * np.sqrt(sum(1.0 / each for each in heard))
    value = found.shift + more
    return tuple(
        Interval(float(v), float(v - r), float(v + r)) for v, r in zip(value, reach, strict=True)
    )
