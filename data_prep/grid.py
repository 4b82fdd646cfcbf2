"""Samples to a uniform raster: what is taken over, interpolated, averaged, held or left out.

The audit of a log that is read block by block: every row and every sample counted once.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from data_prep.log import AuditEntry
from narxcal.support.arrays import FloatArray, runs

if TYPE_CHECKING:
    from numpy.typing import NDArray

from data_prep.log import Audit

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from numpy.typing import NDArray

    from data_prep.log import Action

ON_RASTER = 0.01  # of the interval: samples closer than this to a raster time are on it
OWN_INTERVALS = 2.5  # a slower channel may miss one of its own samples
LONG_SPAN_S = 1.0
SLOW = "slower than the raster"  # why a sample lies between two of its channel's own
LARGEST = 1e30  # beyond it a number is a fault, and its arithmetic would overflow


@dataclass(frozen=True)
class Raster:
    """Uniform times `start_s + k * interval_s`, and the longest blank that is bridged."""

    start_s: float
    interval_s: float
    samples: int
    bridge_s: float

    @property
    def time_s(self) -> FloatArray:
        """The times `(samples,)`."""
        return self.start_s + np.arange(self.samples, dtype=np.float64) * self.interval_s

    def steps(self, time: FloatArray) -> FloatArray:
        """`time` in intervals since the start; within 1 % of a raster time exactly that one."""
        steps = (time - self.start_s) / self.interval_s
        nearest = np.round(steps)
        return np.asarray(np.where(np.abs(steps - nearest) <= ON_RASTER, nearest, steps))


def lay(time: FloatArray, interval_s: float, bridge_s: float) -> Raster:
    """Make the raster that starts with the first stamp and ends at or before the last."""
    span = (time[-1] - time[0]) / interval_s
    return Raster(float(time[0]), interval_s, int(np.floor(span + 0.01)) + 1, bridge_s)


def resample(
    name: str, time: FloatArray, values: FloatArray, raster: Raster, *, hold: bool
) -> tuple[FloatArray, tuple[AuditEntry, ...]]:
    """One channel on the raster `(samples,)`, with the account of what that took.

    * A sample on a raster time is taken over bit for bit.
    * Between two of the channel's own samples the value is on the straight line, when they are
      no further apart than `bridge_s` or 2.5 of the channel's own median intervals; over longer
      blanks and outside the channel's first and last sample it stays NaN ("missing").
    * A channel sampled more than 1.5 times as fast as the raster is averaged over the raster
      interval centred on each raster time, against aliasing; neither rule shifts the phase.
    * `hold` (switches): the last sample at or before the raster time, however old.
    * Of several samples with one stamp the last counts.
    """
    valid = np.abs(values) < LARGEST
    absurd = int((~valid & ~np.isnan(values)).sum())
    steps, values, repeated = _last_of_equal(raster.steps(time[valid]), values[valid])
    entries = [
        AuditEntry(name, "dropped", "not finite", absurd),
        AuditEntry(name, "dropped", "duplicate time stamp", repeated),
    ]
    grid = np.arange(raster.samples, dtype=np.float64)
    if not len(steps):
        result = np.full(raster.samples, np.nan)
    elif hold:
        result = _held(grid, steps, values)
    else:
        result = _bridged(grid, steps, values, raster)
        means = int(np.isfinite(result).sum()) if _fast(steps) else 0
        entries.append(AuditEntry(name, "repaired", "averaged: faster than the raster", means))
    return result, (*entries, *_account(name, result, steps, raster))


def drawn(time: FloatArray, values: FloatArray, raster: Raster) -> NDArray[np.bool_]:
    """Samples `(samples,)` of a channel slower than the raster that are nearest to none of its own.

    What `resample` gives there is on the line between two measurements and is none itself.
    """
    steps = np.unique(raster.steps(time[np.abs(values) < LARGEST]))
    if not _slow(steps):
        return np.zeros(raster.samples, dtype=np.bool_)
    flags = np.ones(raster.samples, dtype=np.bool_)
    own = np.floor(steps + 0.5).astype(np.intp)
    flags[own[(own >= 0) & (own < raster.samples)]] = False
    return flags


def _last_of_equal(steps: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray, int]:
    last = np.append(np.diff(steps) > 0.0, True)[: len(steps)]
    if last.all():
        return steps, values, 0
    return steps[last], values[last], int((~last).sum())


def _held(grid: FloatArray, steps: FloatArray, values: FloatArray) -> FloatArray:
    at = np.searchsorted(steps, grid, side="right") - 1
    return np.where(at >= 0, values[np.maximum(at, 0)], np.nan)


def _bridged(grid: FloatArray, steps: FloatArray, values: FloatArray, raster: Raster) -> FloatArray:
    if len(steps) == 1:
        return np.where(grid == steps[0], values[0], np.nan)
    apart = np.diff(steps)
    own = float(np.median(apart))
    result = _averaged(grid, steps, values) if _fast(steps) else np.interp(grid, steps, values)
    limit = max(raster.bridge_s / raster.interval_s, OWN_INTERVALS * own) + 1e-9
    before = np.clip(np.searchsorted(steps, grid, side="right") - 1, 0, len(apart) - 1)
    inside = (grid > steps[before]) & (grid < steps[before + 1])
    result[inside & (apart[before] > limit)] = np.nan
    result[(grid < steps[0]) | (grid > steps[-1])] = np.nan
    return result


def _fast(steps: FloatArray) -> bool:
    """Whether samples at `steps` come so often that they are averaged, against aliasing."""
    return len(steps) > 1 and float(np.median(np.diff(steps))) * 1.5 < 1.0


def _slow(steps: FloatArray) -> bool:
    """Whether samples at `steps` come so seldom that the raster lies between them."""
    return len(steps) > 1 and float(np.median(np.diff(steps))) > 1.5


def _averaged(grid: FloatArray, steps: FloatArray, values: FloatArray) -> FloatArray:
    """Mean over `[k - 1/2, k + 1/2]` of the straight lines between samples."""
    area = np.concatenate([[0.0], np.cumsum(0.5 * (values[1:] + values[:-1]) * np.diff(steps))])

    def integral(x: FloatArray) -> FloatArray:
        left = np.clip(np.searchsorted(steps, x, side="right") - 1, 0, len(steps) - 2)
        dx = x - steps[left]
        slope = (values[left + 1] - values[left]) / (steps[left + 1] - steps[left])
        return np.asarray(area[left] + dx * (values[left] + 0.5 * slope * dx))

    low, high = np.maximum(grid - 0.5, steps[0]), np.minimum(grid + 0.5, steps[-1])
    # The interval is cut symmetrically at the ends of the channel: no shift there either.
    half = np.maximum(np.minimum(grid - low, high - grid), 0.0)
    width = 2.0 * half
    mean = (integral(grid + half) - integral(grid - half)) / np.where(width > 0.0, width, 1.0)
    return np.where(width > 0.0, mean, np.interp(grid, steps, values))


def _account(
    name: str, result: FloatArray, steps: FloatArray, raster: Raster
) -> tuple[AuditEntry, ...]:
    missing = np.isnan(result)
    touched = np.zeros(raster.samples, dtype=np.bool_)
    for side in (np.floor(steps), np.ceil(steps)):
        index = side.astype(np.intp)
        touched[index[(index >= 0) & (index < raster.samples)]] = True
    filled = ~missing & ~touched
    reason = SLOW if _slow(steps) else "blank"
    return (
        AuditEntry(name, "filled", reason, int(filled.sum()), _spans(filled, raster)),
        AuditEntry(name, "masked", "missing", int(missing.sum()), _spans(missing, raster)),
    )


def _spans(flags: NDArray[np.bool_], raster: Raster) -> tuple[tuple[float, float], ...]:
    """Find runs of true of at least a second, as (first, last) times."""
    starts, stops = runs(flags)
    long = (stops - starts) * raster.interval_s >= LONG_SPAN_S
    time = raster.time_s
    return tuple(
        (float(time[start]), float(time[stop - 1]))
        for start, stop in zip(starts[long], stops[long], strict=True)
    )


_Key = tuple[str, "Action", str]
_ROWS = ("dropped", "duplicate time stamp"), ("dropped", "not finite")  # in blocks that overlap


class StreamAudit:
    """Adds entries up; spans that meet at the edge of two blocks become one."""

    def __init__(self) -> None:
        self._samples: dict[_Key, int] = {}
        self._spans: dict[_Key, list[tuple[float, float]]] = {}

    def count(self, channel: str, action: Action, reason: str, samples: int) -> None:
        """Add `samples`."""
        key = channel, action, reason
        self._samples[key] = self._samples.get(key, 0) + samples

    def add(self, entries: Iterable[AuditEntry], interval_s: float) -> None:
        """Add entries about samples `interval_s` apart; those about rows are counted elsewhere."""
        for entry in entries:
            if (entry.action, entry.reason) in _ROWS:
                continue
            self.count(entry.channel, entry.action, entry.reason, entry.samples)
            key = entry.channel, entry.action, entry.reason
            spans = self._spans.setdefault(key, [])
            for start, stop in entry.spans_s:
                if spans and start - spans[-1][1] < 1.5 * interval_s:
                    spans[-1] = spans[-1][0], stop
                else:
                    spans.append((start, stop))

    def rows(
        self, time: FloatArray, rows: Mapping[str, FloatArray], new: NDArray[np.bool_], on: Raster
    ) -> None:
        """Count the faults of those rows `(rows,)`, in order of time, that are `new`."""
        steps = on.steps(time)
        self.count("*", "repaired", "time stamp off the raster", _uneven(steps[new]))
        for name, values in rows.items():
            if name == "time_s":
                continue
            valid = np.abs(values) < LARGEST
            absurd = ~valid & ~np.isnan(values) & new
            self.count(name, "dropped", "not finite", int(absurd.sum()))
            again = (np.diff(steps[valid]) <= 0.0) & new[valid][1:]
            self.count(name, "dropped", "duplicate time stamp", int(again.sum()))

    def taken(self) -> Audit:
        """Everything so far as an audit; the count begins anew."""
        entries = [
            AuditEntry(*key, samples, tuple(self._spans.get(key, ())))
            for key, samples in self._samples.items()
        ]
        self._samples, self._spans = {}, {}
        return Audit().add(*entries)


def _uneven(steps: FloatArray) -> int:
    return int((steps != np.round(steps)).sum())
