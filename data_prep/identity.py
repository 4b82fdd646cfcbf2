"""Whether two logs hold the same samples, whatever their files, clocks and sampling rates.

`Identity.of` takes from a log, as recorded, a hash of its canonical samples and one anchor in every
four seconds: the mean of each engine channel over the second of it that changes least.
`Identity.within` looks for these anchors in another log, at any shift of its clock:

| step | how |
|---|---|
| agree | of an anchor and a second of the other log, all engine channels but at most one agree |
| tolerance | 3e-4 of the channel's largest value, four standard deviations of the noise of both means, and what the other log changes within half a second |
| shift | of those at which most anchors agree, the one with the best stretch, to 0.04 s |
| stretch | consecutive anchors, each that agrees counting 1, each other one -3: the largest sum |
| levels | of the stretch, the anchors that differ from the level counted before by more than the tolerance |
| same | at least five levels, and shifts x p^levels < 1e-4 with the share p of all anchors and seconds that agree |

So a cut, a resampled or renamed copy, and one with another channel altered is recognised; two
steady cruises or two slams of one engine are not the same, nor are the engines of one flight. A
stretch without five levels is recognised by its hash alone. One channel of two may differ, none of
one.
"""  # noqa: E501 -- a table

from __future__ import annotations

import base64
import hashlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, NamedTuple, Self

import numpy as np

from narxcal.channels import CHANNELS, described
from narxcal.support.arrays import BoolArray, FloatArray, IntArray, bridge_gaps, noise_level
from narxcal.support.errors import DataError, ModelError
from narxcal.support.moments import stamp

if TYPE_CHECKING:
    from data_prep.log import Log, Source

_EVERY_S: Final = 4.0
_MOST: Final = 20_000  # anchors of one log: 22 h at full density
_ROUNDING: Final = 3e-4  # of the largest value: a copy in four digits
_NOISES: Final = 4.0
_LEAST_LEVELS: Final = 5
_CHANCE: Final = 1e-4
_LARGEST_MISFIT: Final = 0.4  # of the tolerance, which is four deviations of the noise
_SHIFTS: Final = 6  # that are looked at closely
_CHUNK, _CHUNKS = 64, 24  # seconds of the other log that are searched, and how many such stretches


class Overlap(NamedTuple):
    """Where a log holds the samples of another one: `share` of it, from `from_s` to `to_s`."""

    share: float
    from_s: float
    to_s: float


class _Means:
    """Means over one second of engine channels of a log, at any time within it."""

    def __init__(self, time_s: FloatArray, channels: Mapping[str, FloatArray]) -> None:
        self.names = tuple(channels)
        self.time_s = time_s
        known = np.column_stack([bridge_gaps(values) for values in channels.values()])
        step = np.diff(time_s)[:, None]
        area = np.concatenate(
            [np.zeros((1, known.shape[1])), np.cumsum(0.5 * step * (known[1:] + known[:-1]), 0)]
        )
        self._area = area
        self._missing = np.column_stack([~np.isfinite(values) for values in channels.values()])
        # Four standard deviations of a mean; of few samples in a second it is one of a sample.
        per_mean = max(1.0, 1.0 / float(np.median(step))) if len(step) else 1.0
        noise = np.array([noise_level(values) for values in known.T])
        self.noise = noise / np.sqrt(per_mean)
        self.largest = np.abs(known).max(axis=0)

    def at(self, times_s: FloatArray) -> FloatArray:
        """Means (times, channels) over [t - 0.5, t + 0.5]; NaN beyond the log and where masked."""
        ends = np.concatenate([times_s - 0.5, times_s + 0.5])
        area = np.column_stack([np.interp(ends, self.time_s, each) for each in self._area.T])
        low, high = np.split(area, 2)
        found = high - low
        found[(times_s < self.time_s[0] + 0.5) | (times_s > self.time_s[-1] - 0.5)] = np.nan
        near = np.clip(np.searchsorted(self.time_s, times_s), 0, len(self.time_s) - 1)
        found[self._missing[near]] = np.nan
        return np.asarray(found)


@dataclass(frozen=True, eq=False)
class Identity:
    """What a log can be recognised by: its hash, and anchors `(n,)` with means `(n, channels)`."""

    digest: str
    channels: tuple[str, ...]
    noise: FloatArray
    time_s: FloatArray
    means: FloatArray

    @classmethod
    def of(cls, time_s: FloatArray, channels: Mapping[str, FloatArray]) -> Self:
        """Identify canonical channels (time,) at increasing times; NaN where nothing is known."""
        own = engine_channels(channels)
        digest = _digest(len(time_s), own)
        if not own or time_s[-1] - time_s[0] < _LEAST_LEVELS * _EVERY_S:
            return cls(digest, tuple(own), np.zeros(len(own)), np.empty(0), np.empty((0, len(own))))
        means = _Means(time_s, own)
        seconds = np.arange(time_s[0] + 1.0, time_s[-1] - 1.0, 1.0)
        found = means.at(seconds)
        change = np.abs(means.at(seconds + 0.5) - means.at(seconds - 0.5))
        change = np.nanmax(np.where(np.isfinite(change), change, 0.0) / (means.largest + 1e-12), 1)
        change = np.where(np.isfinite(found).any(axis=1), change, np.inf)
        block = max(round(_EVERY_S), -(-len(seconds) // _MOST))
        starts = range(0, len(seconds), block)
        rows = np.array([start + int(np.argmin(change[start : start + block])) for start in starts])
        rows = rows[np.isfinite(change[rows])]
        return cls(digest, tuple(own), means.noise, seconds[rows] - time_s[0], found[rows])

    def within(self, log: Log) -> Overlap | None:
        """Where `log`, as recorded, holds samples of this log; None where it does not."""
        time_s = log.time_s
        if self.digest == log.identity.digest:
            return Overlap(1.0, float(time_s[0]), float(time_s[-1]))
        own = engine_channels(log.channels)
        own = {name: own[name] for name in self.channels if name in own}
        if not own or not len(self.time_s) or time_s[-1] - time_s[0] < _LEAST_LEVELS * _EVERY_S:
            return None
        return _Search(self, _Means(time_s, own)).best()

    def to_json(self) -> dict[str, Any]:
        """For a document; the anchors as base64 of little-endian float32."""
        table = np.column_stack([self.time_s, self.means]).astype("<f4")
        return {
            "digest": self.digest,
            "channels": list(self.channels),
            "noise": self.noise.tolist(),
            "anchors": base64.b64encode(table.tobytes()).decode("ascii"),
        }

    @classmethod
    def from_json(cls, stored: Mapping[str, Any]) -> Self:
        """Rebuild from `to_json`; raises `ModelError` for anything else."""
        try:
            names = tuple(str(name) for name in stored["channels"])
            table = np.frombuffer(base64.b64decode(stored["anchors"], validate=True), dtype="<f4")
            rows = table.reshape(-1, 1 + len(names)).astype(np.float64)
            noise = np.asarray(stored["noise"], dtype=np.float64).reshape(len(names))
            return cls(str(stored["digest"]), names, noise, rows[:, 0], rows[:, 1:])
        except (KeyError, TypeError, ValueError) as error:
            raise ModelError(f"the identity of a log cannot be read: {error}") from None


class _Stretch(NamedTuple):
    """Anchors (rows) of one log that agree with another, and the median of off / tolerance."""

    rows: IntArray
    misfit: float
    from_s: float
    to_s: float

    @property
    def order(self) -> tuple[int, float]:
        """By which stretches at several shifts are compared."""
        return len(self.rows), -self.misfit


_NOWHERE: Final = _Stretch(np.empty(0, dtype=np.int64), np.inf, 0.0, 0.0)


class _Search:
    """The anchors of one log in the seconds of another one."""

    def __init__(self, identity: Identity, means: _Means) -> None:
        columns = [identity.channels.index(name) for name in means.names]
        self.anchors = identity.means[:, columns]
        self.times = identity.time_s
        self.means = means
        noise = np.hypot(identity.noise[columns], means.noise)
        self.tolerance = _ROUNDING * means.largest + _NOISES * noise
        self.least = len(columns) - (len(columns) > 2)

    def best(self) -> Overlap | None:
        """The overlap at the most likely shift."""
        seconds = self._seconds()
        agree = self._agreement(seconds)
        anchor, second = np.nonzero(agree)
        if not len(anchor):
            return None
        chance = len(anchor) / agree.size
        shifts = np.rint(seconds[second] - self.times[anchor]).astype(np.int64)
        values, counts = np.unique(shifts, return_counts=True)
        order = np.argsort(-counts, kind="stable")[:_SHIFTS]
        likely = values[order[counts[order] >= max(_LEAST_LEVELS, 0.5 * counts.max())]]
        # Most logs are another flight: their shifts are dismissed before any is looked at closely.
        likely = [float(s) for s in likely if self._beyond_chance(self._near(float(s)), chance)]
        if not likely:
            return None
        found = max((self._refined(shift) for shift in likely), key=lambda one: one.order)
        if found.misfit > _LARGEST_MISFIT or not self._beyond_chance(found.rows, chance):
            return None
        whole = self.means.time_s[-1] - self.means.time_s[0]
        share = min(1.0, (found.to_s - found.from_s + _EVERY_S) / whole)
        return Overlap(float(share), found.from_s, found.to_s)

    def _beyond_chance(self, rows: IntArray, chance: float) -> bool:
        """Whether anchors that agree at one shift are too many levels for two other flights."""
        levels = self._levels(self.anchors[rows]) if len(rows) else 0
        span = self.means.time_s[-1] - self.means.time_s[0] + self.times[-1]
        return levels >= _LEAST_LEVELS and bool(span * chance**levels <= _CHANCE)

    def _near(self, shift: float) -> IntArray:
        """Anchors of the best stretch within half a second of a shift."""
        return self._stretch(shift, self._slopes(self.times + shift)).rows

    def _refined(self, shift: float) -> _Stretch:
        """The best stretch near a shift in whole seconds: to 0.2 s by anchors, then by misfit."""
        near = shift + np.linspace(-1.0, 1.0, 11)
        best = max(near.tolist(), key=lambda each: self._stretch(each).order)
        return min(
            (self._stretch(best + part) for part in np.linspace(-0.2, 0.2, 11)),
            key=lambda each: each.misfit,
        )

    def _seconds(self) -> FloatArray:
        """Times in the other log that are searched: all, or stretches all over a long one."""
        every = np.arange(self.means.time_s[0] + 1.0, self.means.time_s[-1] - 1.0, 1.0)
        if len(every) <= _CHUNK * _CHUNKS:
            return every
        starts = np.linspace(0, len(every) - _CHUNK, _CHUNKS).astype(int)
        return np.concatenate([every[start : start + _CHUNK] for start in starts])

    def _agreement(self, seconds: FloatArray) -> BoolArray:
        """Which anchors and seconds agree (anchors, seconds)."""
        values, slopes = self.means.at(seconds), self._slopes(seconds)
        count = np.zeros((len(self.anchors), len(seconds)), dtype=np.int8)
        for k, tolerance in enumerate(self.tolerance):
            off = np.abs(self.anchors[:, k, None] - values[None, :, k])
            count += off <= tolerance + slopes[None, :, k]
        return np.asarray(count >= self.least)

    def _slopes(self, times_s: FloatArray) -> FloatArray:
        """What the other log changes within half a second (times, channels)."""
        return np.nan_to_num(np.abs(self.means.at(times_s + 0.5) - self.means.at(times_s - 0.5)))

    def _stretch(self, shift: float, slopes: FloatArray | float = 0.0) -> _Stretch:
        """The best stretch at a shift of the clock, with `slopes` (anchors, channels) allowed."""
        at = self.times + shift
        inside = (at > self.means.time_s[0] + 0.5) & (at < self.means.time_s[-1] - 0.5)
        if not inside.any():
            return _NOWHERE
        numbers, at = np.flatnonzero(inside), at[inside]
        allowed = np.broadcast_to(self.tolerance + slopes, self.anchors.shape)[numbers]
        off = np.abs(self.anchors[numbers] - self.means.at(at)) / allowed
        agree = (off <= 1.0).sum(axis=1) >= self.least
        first, last = _largest_sum(np.where(agree, 1, -3))
        rows = np.flatnonzero(agree[first : last + 1]) + first
        if not len(rows):
            return _NOWHERE
        # The channel that may differ is the one that differs most.
        kept = np.sort(off[rows], axis=1)[:, : self.least]
        misfit = float(np.median(kept.max(axis=1)))
        return _Stretch(numbers[rows], misfit, float(at[first]), float(at[last]))

    def _levels(self, anchors: FloatArray) -> int:
        """How often the anchors change to another level."""
        count, level = 1, anchors[0]
        for row in anchors[1:]:
            if np.sum(np.abs(row - level) > 4.0 * self.tolerance) >= self.least:
                count, level = count + 1, row
        return count


def _largest_sum(scores: IntArray) -> tuple[int, int]:
    """First and last index of the stretch with the largest sum."""
    after = np.cumsum(scores)
    before = np.concatenate([[0], after[:-1]])
    least = np.minimum.accumulate(before)
    last = int(np.argmax(after - least))
    return int(np.flatnonzero(before[: last + 1] == least[last])[-1]), last


def engine_channels(channels: Mapping[str, FloatArray]) -> dict[str, FloatArray]:
    """Outputs with a sample; a lever follows the same schedule in many runs."""
    ordered = [*(name for name in CHANNELS if name in channels), *sorted({*channels} - {*CHANNELS})]
    return {
        name: channels[name]
        for name in ordered
        if described(name).role == "output" and np.isfinite(channels[name]).any()
    }


def _digest(samples: int, channels: Mapping[str, FloatArray]) -> str:
    found = hashlib.sha256(str(samples).encode())
    for name, values in channels.items():
        found.update(name.encode())
        found.update(np.ascontiguousarray(values, dtype="<f4").tobytes())
    return found.hexdigest()


class Shared(NamedTuple):
    """A log that holds samples of another one."""

    log: str
    other: str
    overlap: Overlap

    @property
    def words(self) -> str:
        """One sentence without a full stop."""
        share, from_s, to_s = self.overlap
        return (
            f"{self.log} holds the samples of {self.other}: {100.0 * share:.0f} % of it, "
            f"{stamp(from_s)} to {stamp(to_s)}"
        )


def duplicates(logs: Sequence[Log]) -> list[Shared]:
    """Logs that hold samples of an earlier one of `logs`, the earliest such; engines apart."""
    found = []
    for k, log in enumerate(logs):
        shared = first_shared(log, ((one.name, one.source, one.identity) for one in logs[:k]))
        found += [shared] if shared else []
    return found


def first_shared(log: Log, others: Iterable[tuple[str, Source, Identity]]) -> Shared | None:
    """The first of `others` (name, source, identity) whose samples are in `log`; None of none."""
    for name, source, identity in others:
        own = log.source
        engines = bool(own.sha256) and source.sha256 == own.sha256 and source.engine != own.engine
        parts = bool(own.file) and source.file == own.file and name != log.name
        if engines or parts:
            continue
        overlap = identity.within(log)
        if overlap is not None:
            return Shared(log.name, name, overlap)
    return None


def refuse_duplicates(logs: Sequence[Log], what: str) -> None:
    """Raise `DataError` where a recording is among `logs` twice; `what` says why that matters."""
    for shared in duplicates(logs):
        raise DataError(
            f"{shared.words}; {what}",
            hint="Leave one of the two out of [logs] files, or of [split]",
        )
