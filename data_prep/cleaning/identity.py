"""Whether two logs are one flight, whatever their names, clocks, rates, filters and calibrations.

Two flights of one schedule share every movement that somebody commanded, and no other: the noise of
sensors, the air that a flight met, a hand on the lever. Of a log these small movements of each
channel are kept: fourth differences of means over half a second (half a sample where that is
longer), without those beyond four of their usual size and what follows these, over their
root mean square of four seconds. An offset or a slow drift is not in them, nor is a gain or what a
filter leaves of noise. A channel counts where it keeps moving and where the movements do not follow
each other as in a decaying response; a lever that steps by a programme does not.

For the movements a, b of two logs, with b shifted by tau and summed over time and channels,

    r(tau) = sum a b / sqrt(sum a^2 sum b^2),    z(tau) = sum a b / sqrt(sum a^2 b^2)

are their correlation and a standard normal variable of two flights, widened by the movements'
correlation in time, which the spread over all tau shows. They are one flight where r z is beyond 4
deviations of that, by chance once in 1e9 tau: of whole logs, or of two minutes of one stretched by
up to 2 %. Of logs with differently named engines only the outputs are compared: engines of one
flight share its air. What has no such movement, as a simulation without noise in still air, is
known by its hash alone: its copy and a repetition of its programme are alike.
"""

from __future__ import annotations

import base64
import hashlib
import math
import zlib
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import TYPE_CHECKING, Any, Final, NamedTuple, Self

import numpy as np
from scipy import fft

from narxcal.channels import CHANNELS, described
from narxcal.support.arrays import FloatArray, IntArray, bridge_gaps
from narxcal.support.errors import DataError, ModelError
from narxcal.support.moments import stamp

if TYPE_CHECKING:
    from data_prep.log import Log, Source

# Of r z: flights of slams every twelve seconds reach 3.1, copies smoothed over a second 4.2.
_SURE: Final = 4.0
_LARGEST: Final = 4.0  # standard deviations of a small movement
_ALIKE: Final = 0.3  # least r of a shift that sums over channels suggest
_PARTS: Final = 8.0  # of a movement of usual size that are stored
# Largest correlation of neighbours: -0.8 of white noise, 0.17 of samples joined by lines at half
# their interval, beyond 0.5 of a response that decays over more than a second.
_FOLLOW: Final = 0.3
_MOVING: Final = 0.3  # of its spans, a channel that keeps moving
_RESOLUTION: Final = 1e-7  # of the largest value: smaller movements are the rounding of a computer
_SPAN_S: Final = 0.5
# A response of 1.5 s falls to 1/150 in four differences, while noise grows by sqrt(70).
_ORDER: Final = 4
_AFTER: Final = 4  # spans after a large movement
_AROUND: Final = 9  # spans over which the size of movements is found
_WINDOW, _WINDOWS, _SHORTEST = 256, 4, 80  # rows of a stretch, stretches of a log, rows in common
_LIKELY: Final = 3  # shifts that sums over channels suggest
_MEDIAN_OF_NORMAL: Final = 0.6745  # absolute deviation
_STRETCHES: Final = (1.0, 0.995, 1.005, 0.99, 1.01, 0.985, 1.015, 0.98, 1.02)


class Overlap(NamedTuple):
    """Where a log holds the samples of another one: `share` of it, from `from_s` to `to_s`."""

    share: float
    from_s: float
    to_s: float


@dataclass(frozen=True, eq=False)
class Identity:
    """What a log is known by: its hash, and small movements (spans, channels); 0 where none."""

    digest: str
    channels: tuple[str, ...]
    span_s: float
    moves: FloatArray

    @classmethod
    def of(cls, time_s: FloatArray, channels: Mapping[str, FloatArray]) -> Self:
        """Identify canonical channels (time,) at increasing times; NaN where nothing is known."""
        span_s = max(_SPAN_S, 0.5 * float(np.median(np.diff(time_s)))) if len(time_s) > 1 else 1.0
        moves = _Recorded(time_s, channels).moves(span_s, 0.0)
        table = np.column_stack([*moves.values()]) if moves else np.empty((0, 1))
        table = np.rint(_PARTS * table) / _PARTS
        return cls(_digest(len(time_s), channels), tuple(moves), span_s, table)

    def within(
        self, log: Log, *, outputs: bool = False, recorded: _Recorded | None = None
    ) -> Overlap | None:
        """Where `log`, as recorded, is the flight of this log; None where it is not.

        `outputs` compares outputs alone; `recorded` are the samples of `log`, where many are asked.
        """
        time_s = log.time_s
        if self.digest == log.identity.digest:
            return Overlap(1.0, float(time_s[0]), float(time_s[-1]))
        recorded = recorded or _Recorded(time_s, log.channels)
        names = [n for n in self.channels if not (outputs and described(n).role != "output")]
        for stretch, late in product(_STRETCHES, (0.0, 1.0 / 3.0, 2.0 / 3.0)):
            span_s = self.span_s * stretch
            moves = recorded.moves(span_s, late)
            common = [name for name in names if name in moves]
            if not common:
                continue
            own = self.moves[:, [self.channels.index(name) for name in common]]
            other = np.column_stack([moves[name] for name in common])
            shift = _shift(own, other, whole=stretch == 1.0)
            if shift is not None:
                return _overlap(own, other, shift, _middles(time_s, span_s, late))
        return None

    def to_json(self) -> dict[str, Any]:
        """For a document; the movements as base64 of bytes, row by row."""
        table = zlib.compress(np.rint(_PARTS * self.moves).astype(np.int8).tobytes())
        return {
            "digest": self.digest,
            "channels": list(self.channels),
            "span_s": self.span_s,
            "moves": base64.b64encode(table).decode("ascii"),
        }

    @classmethod
    def from_json(cls, stored: Mapping[str, Any]) -> Self:
        """Rebuild from `to_json`; raises `ModelError` for anything else."""
        try:
            names = tuple(str(name) for name in stored["channels"])
            table = zlib.decompress(base64.b64decode(stored["moves"], validate=True))
            rows = np.frombuffer(table, dtype=np.int8).reshape(-1, max(1, len(names)))
            return cls(str(stored["digest"]), names, float(stored["span_s"]), rows / _PARTS)
        except (KeyError, TypeError, ValueError, zlib.error) as error:
            raise ModelError(f"the identity of a log cannot be read: {error}") from None


def _middles(time_s: FloatArray, span_s: float, late: float = 0.0) -> FloatArray:
    """Middles of the spans of a log, the first of which begins late by a share of one."""
    return np.arange(time_s[0] + (0.5 + late) * span_s, time_s[-1] - 0.5 * span_s, span_s)


class _Recorded:
    """Channels of a log as recorded; their small movements are taken over spans of any length."""

    def __init__(self, time_s: FloatArray, channels: Mapping[str, FloatArray]) -> None:
        # Slow to load, and `prepare` needs none of it.
        from scipy.interpolate import make_interp_spline  # noqa: PLC0415

        self.time_s = time_s
        self._channels: dict[str, tuple[Any, FloatArray, float]] = {}
        for name in _ordered(channels) if len(time_s) > 1 else ():
            known = bridge_gaps(channels[name])
            if described(name).role not in {"time", "switch"} and np.isfinite(known).all():
                area = make_interp_spline(time_s - time_s[0], known, k=1).antiderivative()
                lost = (~np.isfinite(channels[name])).astype(np.float64)
                least = _RESOLUTION * float(np.abs(known).max()) + 1e-30
                self._channels[name] = area, lost, least
        self._known: dict[tuple[float, float], dict[str, FloatArray]] = {}

    def moves(self, span_s: float, late: float) -> Mapping[str, FloatArray]:
        """Small movements (spans - 4,) of the channels that have some, by name."""
        if (span_s, late) not in self._known:
            middles = _middles(self.time_s, span_s, late)
            enough = len(middles) > _SHORTEST
            found = {n: self._small(n, middles, span_s) for n in (self._channels if enough else ())}
            kept = {name: moves for name, moves in found.items() if moves is not None}
            self._known[span_s, late] = kept
        return self._known[span_s, late]

    def _small(self, name: str, middles: FloatArray, span_s: float) -> FloatArray | None:
        """Small movements of one channel; None where they are not those of noise."""
        area, gaps, least = self._channels[name]
        ends = np.concatenate([middles - 0.5 * span_s, [middles[-1] + 0.5 * span_s]])
        bends = np.diff(area(ends - self.time_s[0]), 1 + _ORDER) / span_s
        bends[np.interp(middles[2:-2], self.time_s, gaps) > 0.0] = 0.0
        moving = np.abs(bends[np.abs(bends) > least])
        if len(moving) < _MOVING * len(bends):
            return None
        # What follows a large movement decays through the small ones.
        large = np.abs(bends) > _LARGEST * float(np.median(moving)) / _MEDIAN_OF_NORMAL
        kept = np.where(np.convolve(large, np.ones(1 + _AFTER))[: len(bends)] > 0.5, 0.0, bends)
        size = np.sqrt(np.convolve(kept**2, np.full(_AROUND, 1.0 / _AROUND), mode="same"))
        kept = np.where(size > least, kept / np.maximum(size, least), 0.0)
        follow = float(kept[1:] @ kept[:-1])
        return kept if kept.any() and follow <= _FOLLOW * float(kept @ kept) else None


def _shift(own: FloatArray, other: FloatArray, *, whole: bool) -> int | None:
    """Rows by which `other` begins later than `own` where they are one flight; None of two."""
    if whole:
        shift = _peak(own, other)
        if shift is not None:
            return shift
    swapped = len(own) < len(other)
    short, long = (own, other) if swapped else (other, own)
    starts = np.linspace(0, max(0, len(short) - _WINDOW), _WINDOWS).astype(int)
    for start in dict.fromkeys(starts.tolist()):
        shift = _peak(long, short[start : start + _WINDOW])
        if shift is not None:
            return int(start - shift if swapped else shift - start)
    return None


def _peak(long: FloatArray, short: FloatArray) -> int | None:
    """The row of `long` where `short` begins, if z is beyond chance there; negative before it.

    Where sums over the channels, of turning signs so that what moves all cancels, suggest no shift
    at which the movements are alike, the channels are not correlated one by one.
    """
    signs = (-1.0) ** np.arange(long.shape[1])[:, None]
    shifts, z = _scores(long @ signs, short @ signs)
    likely = shifts[np.argsort(z)[-_LIKELY:]].tolist()
    if not any(_alike(long, short, shift) >= _ALIKE for shift in likely):
        return None
    shifts, z = _scores(long, short)
    if not z.any():
        return None
    best, spread = int(np.argmax(z)), float(np.median(np.abs(z[z != 0.0]))) / _MEDIAN_OF_NORMAL
    shift, spread = int(shifts[best]), max(1.0, spread)
    return shift if z[best] * _alike(long, short, shift) > _SURE * spread else None


def _scores(long: FloatArray, short: FloatArray) -> tuple[IntArray, FloatArray]:
    """Shifts of `short` in `long` (rows, channels) and z at each; 0 with too little in common."""
    size = fft.next_fast_len(len(long) + len(short), real=True)
    over = min(_SHORTEST, len(short), len(long))
    shifts = np.arange(over - len(short), len(long) - over + 1)

    def correlated(a: FloatArray, b: FloatArray) -> FloatArray:
        spectrum = fft.rfft(a, size, axis=0) * np.conj(fft.rfft(b, size, axis=0))
        return np.asarray(fft.irfft(spectrum.sum(axis=1), size)[shifts])

    common = correlated(long**2, short**2)
    enough = common > over
    root = np.sqrt(np.where(enough, common, 1.0))
    return shifts, np.where(enough, correlated(long, short), 0.0) / root


def _alike(long: FloatArray, short: FloatArray, shift: int) -> float:
    """Correlation over all channels where `short` begins in this row of `long`."""
    a, b = long[max(0, shift) : shift + len(short)], short[max(0, -shift) : len(long) - shift]
    a, b = np.where(b != 0.0, a, 0.0), np.where(a != 0.0, b, 0.0)
    size = math.sqrt(float(np.sum(a**2)) * float(np.sum(b**2)))
    return float(np.sum(a * b)) / size if size > 0.0 else 0.0


def _overlap(own: FloatArray, other: FloatArray, shift: int, middles: FloatArray) -> Overlap:
    """The part of `other` (at `middles`) in which its movements are those of `own`."""
    rows = np.arange(len(other)) + shift
    inside = np.flatnonzero((rows >= 0) & (rows < len(own)))
    products = np.zeros(len(other))
    products[inside] = np.sum(own[rows[inside]] * other[inside], axis=1)
    starts = np.arange(0, len(products), _SHORTEST)
    sums = np.add.reduceat(products, starts)
    alike = starts[sums > 0.4 * sums.max()]
    first, last = int(alike[0]), min(len(other), int(alike[-1]) + _SHORTEST) + 3
    share = (last - first + 1.0) / len(middles)
    return Overlap(min(1.0, share), float(middles[first]), float(middles[last]))


def _ordered(channels: Collection[str]) -> list[str]:
    return [*(name for name in CHANNELS if name in channels), *sorted({*channels} - {*CHANNELS})]


def _digest(samples: int, channels: Mapping[str, FloatArray]) -> str:
    found = hashlib.sha256(str(samples).encode())
    for name in _ordered(channels):
        if described(name).role == "output" and np.isfinite(channels[name]).any():
            found.update(name.encode())
            found.update(np.ascontiguousarray(channels[name], dtype="<f4").tobytes())
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
    recorded = None
    for name, source, identity in others:
        own = log.source
        engines = bool(source.engine and own.engine) and source.engine != own.engine
        parts = bool(own.file) and source.file == own.file and name != log.name
        if parts or (engines and source.sha256 == own.sha256):
            continue
        recorded = recorded or _Recorded(log.time_s, log.channels)
        overlap = identity.within(log, outputs=engines, recorded=recorded)
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
