"""Resample channels onto a uniform sampling grid, and account for what that changes.

A sample is taken over, interpolated, averaged, kept (switches) or left missing; every row and every
sample that was changed is counted once in the audit, however the rows arrive.

Reading divides a recording where its rows are more than `max_gap_s` apart, and what is learned
needs inputs without gaps. What is judged is the recording: it has one free run, one set of figures
and one picture, however often its recorder stopped for a moment. `joined` makes one log of its
parts again, in which gaps are samples that nobody measured.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from data_prep.log import LONG_SPAN_S, Action, Audit, AuditEntry, Log
from narxcal.channels import described
from narxcal.support.arrays import BoolArray, FloatArray, runs

ON_GRID = 0.01  # of the interval: samples closer than this to a grid time are on it
OWN_INTERVALS = 2.5  # a slower channel may miss one of its own samples
SLOW = "slower than the grid"  # why a sample lies between two of its channel's own
_GAP = "gap in the recording"
# Times the rows that there are. A recorder that was off for longer wrote several recordings.
_LONGEST = 3.0
LARGEST = 1e30  # beyond it a number is a fault, and its arithmetic would overflow


@dataclass(frozen=True)
class Grid:
    """Uniform times `start_s + k * interval_s`, and the longest blank that is bridged."""

    start_s: float
    interval_s: float
    samples: int
    bridge_s: float

    @property
    def time_s(self) -> FloatArray:
        return self.start_s + np.arange(self.samples, dtype=np.float64) * self.interval_s

    def steps(self, time: FloatArray) -> FloatArray:
        """Convert `time` to intervals since the start; within 1 % of a grid time exactly that."""
        steps = (time - self.start_s) / self.interval_s
        nearest = np.round(steps)
        return np.asarray(np.where(np.abs(steps - nearest) <= ON_GRID, nearest, steps))


def resample(
    name: str, time: FloatArray, values: FloatArray, grid: Grid, *, hold: bool
) -> tuple[FloatArray, tuple[AuditEntry, ...]]:
    """Put one channel on the grid `(samples,)`, with the audit entries of that.

    * A sample on a grid time is taken over bit for bit.
    * Between two of the channel's own samples the value is on the straight line, when they are
      no further apart than `bridge_s` or 2.5 of the channel's own median intervals; over longer
      blanks and outside the channel's first and last sample it stays NaN ("missing").
    * A channel sampled more than 1.5 times as fast as the grid is averaged over the grid
      interval centred on each grid time, against aliasing; neither rule shifts the phase.
    * `hold` (switches): the last sample at or before the grid time, however old.
    * Of several samples with one stamp the last counts there and after, and the first is where the
      line from before ends: two rows at one stamp are a step, not a ramp that begins too early.
    """
    valid = np.abs(values) < LARGEST
    stamps, given = grid.steps(time[valid]), values[valid]
    rises = np.diff(stamps) > 0.0
    steps, values = (each[np.append(rises, True)[: len(each)]] for each in (stamps, given))
    ends = given[np.append(True, rises)[: len(given)]]
    entries = []
    at = np.arange(grid.samples, dtype=np.float64)
    if not len(steps):
        result = np.full(grid.samples, np.nan)
    elif hold:
        row = np.searchsorted(steps, at, side="right") - 1
        result = np.where(row >= 0, values[np.maximum(row, 0)], np.nan)
    else:
        result = _bridged(at, steps, (values, ends), grid)
        means = int(np.isfinite(result).sum()) if _fast(steps) else 0
        entries.append(AuditEntry(name, "repaired", "averaged: faster than the grid", means))
    return result, (*entries, *_account(name, result, steps, grid))


def interpolated(time: FloatArray, values: FloatArray, grid: Grid) -> BoolArray:
    """Flag samples `(samples,)` between two measurements of a channel slower than the grid.

    They are nearest to none of the channel's own samples; `resample` interpolates there.
    """
    steps = grid.steps(time[np.abs(values) < LARGEST])
    steps = steps[np.diff(steps, prepend=-np.inf) > 0.0]
    if not _slow(steps):
        return np.zeros(grid.samples, dtype=np.bool_)
    flags = np.ones(grid.samples, dtype=np.bool_)
    own = np.floor(steps + 0.5).astype(np.intp)
    flags[own[(own >= 0) & (own < grid.samples)]] = False
    return flags


def _bridged(
    at: FloatArray, steps: FloatArray, both: tuple[FloatArray, FloatArray], grid: Grid
) -> FloatArray:
    """Values on the lines between stamps; `both` are those after each stamp and those before."""
    values, ends = both
    if len(steps) == 1:
        return np.where(at == steps[0], values[0], np.nan)
    apart = np.diff(steps)
    own = float(np.median(apart))
    result = _averaged(at, steps, values) if _fast(steps) else np.interp(at, steps, values)
    limit = max(grid.bridge_s / grid.interval_s, OWN_INTERVALS * own) + 1e-9
    before = np.clip(np.searchsorted(steps, at, side="right") - 1, 0, len(apart) - 1)
    inside = (at > steps[before]) & (at < steps[before + 1])
    if not _fast(steps):
        stepped = inside & (ends != values)[before + 1]
        k = before[stepped]
        share = (at[stepped] - steps[k]) / apart[k]
        result[stepped] = values[k] + share * (ends[k + 1] - values[k])
    result[inside & (apart[before] > limit)] = np.nan
    result[(at < steps[0]) | (at > steps[-1])] = np.nan
    return result


def _fast(steps: FloatArray) -> bool:
    """Whether samples at `steps` come so often that they are averaged, against aliasing."""
    return len(steps) > 1 and float(np.median(np.diff(steps))) * 1.5 < 1.0


def _slow(steps: FloatArray) -> bool:
    """Whether samples at `steps` come so seldom that grid times lie between them."""
    return len(steps) > 1 and float(np.median(np.diff(steps))) > 1.5


def _averaged(at: FloatArray, steps: FloatArray, values: FloatArray) -> FloatArray:
    """Mean over `[k - 1/2, k + 1/2]` of the straight lines between samples."""
    area = np.concatenate([[0.0], np.cumsum(0.5 * (values[1:] + values[:-1]) * np.diff(steps))])

    def integral(x: FloatArray) -> FloatArray:
        left = np.clip(np.searchsorted(steps, x, side="right") - 1, 0, len(steps) - 2)
        dx = x - steps[left]
        slope = (values[left + 1] - values[left]) / (steps[left + 1] - steps[left])
        return np.asarray(area[left] + dx * (values[left] + 0.5 * slope * dx))

    low, high = np.maximum(at - 0.5, steps[0]), np.minimum(at + 0.5, steps[-1])
    # The interval is cut symmetrically at the ends of the channel: no shift there either.
    half = np.maximum(np.minimum(at - low, high - at), 0.0)
    width = 2.0 * half
    mean = (integral(at + half) - integral(at - half)) / np.where(width > 0.0, width, 1.0)
    return np.where(width > 0.0, mean, np.interp(at, steps, values))


def _account(
    name: str, result: FloatArray, steps: FloatArray, grid: Grid
) -> tuple[AuditEntry, ...]:
    missing = np.isnan(result)
    touched = np.zeros(grid.samples, dtype=np.bool_)
    for side in (np.floor(steps), np.ceil(steps)):
        index = side.astype(np.intp)
        touched[index[(index >= 0) & (index < grid.samples)]] = True
    filled = ~missing & ~touched
    reason = SLOW if _slow(steps) else "blank"
    return (
        AuditEntry(name, "filled", reason, int(filled.sum()), _times(filled, grid)),
        AuditEntry(name, "masked", "missing", int(missing.sum()), _times(missing, grid)),
    )


def _times(flags: BoolArray, grid: Grid) -> tuple[tuple[float, float], ...]:
    starts, stops = runs(flags)
    time = grid.time_s
    return tuple(zip(time[starts].tolist(), time[stops - 1].tolist(), strict=True))


_Key = tuple[str, "Action", str]


class StreamAudit:
    """Adds entries up block by block.

    Spans that meet at the edge of two blocks become one; those of a second or more are kept.
    """

    def __init__(self) -> None:
        self._samples: dict[_Key, int] = {}
        self._spans: dict[_Key, list[tuple[float, float]]] = {}
        self._interval_s = 1.0

    def count(self, channel: str, action: Action, reason: str, samples: int) -> None:
        key = channel, action, reason
        self._samples[key] = self._samples.get(key, 0) + samples

    def add(self, entries: Iterable[AuditEntry], interval_s: float) -> None:
        """Add entries about samples `interval_s` apart."""
        self._interval_s = interval_s
        for entry in entries:
            self.count(entry.channel, entry.action, entry.reason, entry.samples)
            key = entry.channel, entry.action, entry.reason
            spans = self._spans.setdefault(key, [])
            for first, last in entry.spans_s:
                if spans and first - spans[-1][1] < 1.5 * interval_s:
                    spans[-1] = spans[-1][0], last
                else:
                    self._drop_short(spans)
                    spans.append((first, last))

    def _drop_short(self, spans: list[tuple[float, float]]) -> None:
        """Drop the last one, which has ended, if it is short."""
        if spans:
            first, last = spans[-1]
            samples = round((last - first) / self._interval_s) + 1
            if samples * self._interval_s < LONG_SPAN_S:
                spans.pop()

    def rows(
        self, time: FloatArray, rows: Mapping[str, FloatArray], new: BoolArray, grid: Grid
    ) -> None:
        """Count the faults of those rows `(rows,)`, in order of time, that are `new`."""
        steps = grid.steps(time)
        uneven = steps[new] != np.round(steps[new])
        self.count("*", "repaired", "time stamp off the grid", int(uneven.sum()))
        for name, values in rows.items():
            if name == "time_s":
                continue
            valid = np.abs(values) < LARGEST
            absurd = ~valid & ~np.isnan(values) & new
            self.count(name, "dropped", "not finite", int(absurd.sum()))
            again = (np.diff(steps[valid]) <= 0.0) & new[valid][1:]
            self.count(name, "dropped", "duplicate time stamp", int(again.sum()))

    def taken(self) -> Audit:
        """Return everything so far, first of rows, then channel by channel, and begin anew."""
        for spans in self._spans.values():
            self._drop_short(spans)
        channels = list(dict.fromkeys(key[0] for key in self._samples))
        channels.sort(key=lambda name: name != "*")
        entries = [
            AuditEntry(*key, samples, tuple(self._spans.get(key, ())))
            for key, samples in sorted(
                self._samples.items(), key=lambda item: channels.index(item[0][0])
            )
        ]
        self._samples, self._spans = {}, {}
        return Audit().add(*entries)


def joined(logs: Sequence[Log]) -> list[Log]:
    """Join the parts of each engine of each file, in their order; logs without a file stay."""
    groups: dict[tuple[str, str], list[Log]] = {}
    for number, log in enumerate(logs):
        file = log.source.file or f"log {number}"
        groups.setdefault((file, log.source.engine), []).append(log)
    return [log for parts in groups.values() for log in _one(parts)]


def _one(parts: list[Log]) -> list[Log]:
    first, dt_s = parts[0], parts[0].dt_s
    if len(parts) == 1:
        return parts
    count = round((parts[-1].time_s[-1] - first.time_s[0]) / dt_s) + 1
    known = sum(map(len, parts))
    same = all(one.channels.keys() == first.channels.keys() for one in parts)
    if not same or not known <= count <= _LONGEST * known:
        return parts
    time_s = first.time_s[0] + dt_s * np.arange(count, dtype=np.float64)
    channels = {name: np.full(count, np.nan) for name in first.channels}
    between = {name: np.zeros(count, dtype=np.bool_) for one in parts for name in one.interpolated}
    measured = np.zeros(count, dtype=np.bool_)
    for one in parts:
        start = int(np.ceil((one.time_s[0] - time_s[0]) / dt_s - ON_GRID))
        stop = min(count, int(np.floor((one.time_s[-1] - time_s[0]) / dt_s + ON_GRID)) + 1)
        rows = slice(start, stop)
        measured[rows] = True
        for name, values in channels.items():
            values[rows] = _at(time_s[rows], one, name)
        for name, flags in one.interpolated.items():
            near = np.clip(np.searchsorted(one.time_s, time_s[rows]), 0, len(one) - 1)
            between[name][rows] = flags[near]
    lost = int((~measured).sum())
    gaps = [AuditEntry(name, "masked", _GAP, lost) for name in channels]
    audit = Audit(tuple(entry for one in parts for entry in one.audit.entries)).add(*gaps)
    found = (replace(each, log=first.name) for one in parts for each in one.findings)
    findings = tuple(dict.fromkeys(found))
    whole = replace(first, time_s=time_s, channels=channels, audit=audit, findings=findings)
    return [replace(whole, interpolated=between)]


def _at(time_s: FloatArray, part: Log, name: str) -> FloatArray:
    """Channel of a part at grid times: as it is on its own grid, else between two known values."""
    values, switch = part[name], described(name).role == "switch"
    steps = (time_s - part.time_s[0]) / part.dt_s
    nearest = np.clip(np.round(steps), 0, len(part) - 1).astype(np.intp)
    if switch or (np.abs(steps - nearest) <= ON_GRID).all():
        return np.asarray(values[nearest])
    below = np.clip(np.floor(steps), 0, len(part) - 1).astype(np.intp)
    above = np.minimum(below + 1, len(part) - 1)
    share = steps - below
    return np.asarray((1.0 - share) * values[below] + share * values[above])
