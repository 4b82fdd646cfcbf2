"""Whether two logs are one flight, whatever their names, clocks, rates and calibrations.

Two flights of one schedule share every movement that somebody commanded, and no other: the noise of
sensors, the air that a flight met, a hand on the lever. Of a log, as recorded, these small
movements of each channel are kept: fourth differences of means over half a second (half a sample
where that is longer), in standard deviations of their noise, without those beyond four. An offset
or a slow drift is not in them, nor is a gain. A channel counts where it has noise and where they do
not follow each other as in a decaying response; a lever that steps by a programme does not.

For the movements a, b of two logs, with b shifted by tau and summed over time and channels,

    z(tau) = sum a b / sqrt(sum a^2 b^2)

is a standard normal variable of two flights, widened by the movements' correlation in time, which
the spread over all tau shows. They are one flight where z is beyond seven deviations of that:
of whole logs, or of two minutes of one stretched by up to 2 %, and correlated by 0.35 in what
they have in common. Of logs with differently named engines only the outputs are compared: engines
of one flight share its air. What has no such movement, as a simulation
without noise, is known by its hash alone.
"""

from __future__ import annotations

import base64
import hashlib
import math
import zlib
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, NamedTuple, Self

import numpy as np
from scipy import fft

from narxcal.channels import CHANNELS, described
from narxcal.support.arrays import FloatArray, bridge_gaps, noise_level
from narxcal.support.errors import DataError, ModelError
from narxcal.support.moments import stamp

if TYPE_CHECKING:
    from data_prep.log import Log, Source

_SURE: Final = 7.0  # deviations: 1e-12 by chance, of 1e5 shifts in 1e4 pairs of logs
_LARGEST: Final = 4.0  # standard deviations of a small movement
# Least correlation: what remains of commanded movements, of many slams, is 0.2.
_ALIKE: Final = 0.35
_PARTS: Final = 8.0  # of a standard deviation that are stored
# Largest correlation of neighbours: -0.8 of white noise, 0.17 of samples joined by lines at half
# their interval, beyond 0.5 of a response that decays over more than a second.
_FOLLOW: Final = 0.3
_RESOLUTION: Final = 1e-7  # of the largest value: smaller movements are the rounding of a computer
_SPAN_S: Final = 0.5
# A response of 1.5 s falls to 1/150 in four differences, while noise grows by sqrt(70).
_ORDER: Final = 4
_AFTER: Final = 4  # spans after a large movement
_WINDOW, _WINDOWS, _SHORTEST = 256, 4, 40  # rows of a stretch, stretches of a log, rows in common
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
        names, moves = _moves(time_s, channels, _middles(time_s, span_s))
        moves = np.rint(_PARTS * moves) / _PARTS
        return cls(_digest(len(time_s), channels), names, span_s, moves)

    def within(self, log: Log, *, outputs: bool = False) -> Overlap | None:
        """Where `log`, as recorded, is the flight of this log; None where it is not.

        `outputs` compares outputs alone.
        """
        time_s = log.time_s
        if self.digest == log.identity.digest:
            return Overlap(1.0, float(time_s[0]), float(time_s[-1]))
        names = [
            name
            for name in self.channels
            if name in log.channels and not (outputs and described(name).role != "output")
        ]
        if not names:
            return None
        given = {name: log.channels[name] for name in names}
        for stretch in _STRETCHES:
            for late in (0.0, 1.0 / 3.0, 2.0 / 3.0):
                middles = _middles(time_s, self.span_s * stretch, late)
                found, moves = _moves(time_s, given, middles)
                if not found:
                    return None
                own = self.moves[:, [self.channels.index(name) for name in found]]
                shift = _shift(own, moves, whole=stretch == 1.0)
                if shift is not None:
                    return _overlap(own, moves, shift, middles)
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
        """Rebuild from `to_json`, without movements the hash; raises `ModelError` for another."""
        try:
            names = tuple(str(name) for name in stored["channels"])
            packed = base64.b64decode(stored["moves"], validate=True)
            table = zlib.decompress(packed) if packed else b""
            rows = np.frombuffer(table, dtype=np.int8).reshape(-1, max(1, len(names)))
            return cls(str(stored["digest"]), names, float(stored["span_s"]), rows / _PARTS)
        except (KeyError, TypeError, ValueError, zlib.error) as error:
            raise ModelError(f"the identity of a log cannot be read: {error}") from None


def _middles(time_s: FloatArray, span_s: float, late: float = 0.0) -> FloatArray:
    """Middles of the spans of a log, the first of which begins late by a share of one."""
    return np.arange(time_s[0] + (0.5 + late) * span_s, time_s[-1] - 0.5 * span_s, span_s)


def _moves(
    time_s: FloatArray, channels: Mapping[str, FloatArray], middles: FloatArray
) -> tuple[tuple[str, ...], FloatArray]:
    """Small movements (spans - 4, channels) of the channels that have some, and their names."""
    found: dict[str, FloatArray] = {}
    for name in _ordered(channels) if len(middles) > _SHORTEST else ():
        if described(name).role not in {"time", "switch"}:
            moves = _small(time_s, channels[name], middles)
            found |= {} if moves is None else {name: moves}
    return tuple(found), np.column_stack([*found.values()]) if found else np.empty((0, 1))


def _small(time_s: FloatArray, values: FloatArray, middles: FloatArray) -> FloatArray | None:
    """Small movements of one channel; None where they are not those of noise."""
    known = bridge_gaps(values)
    if not np.isfinite(known).all():
        return None
    span_s = float(middles[1] - middles[0])
    area = np.concatenate([[0.0], np.cumsum(0.5 * np.diff(time_s) * (known[1:] + known[:-1]))])
    ends = np.concatenate([middles - 0.5 * span_s, [middles[-1] + 0.5 * span_s]])
    bends = np.diff(np.interp(ends, time_s, area), 1 + _ORDER) / span_s
    lost = np.interp(middles[2:-2], time_s, (~np.isfinite(values)).astype(np.float64)) > 0.0
    in_span = max(1.0, span_s / float(np.median(np.diff(time_s))))
    size = noise_level(known) * math.sqrt(math.comb(2 * _ORDER, _ORDER) / in_span)
    if size <= _RESOLUTION * float(np.abs(known).max()):
        return None
    # What follows a large movement decays through the small ones.
    large = np.convolve(np.abs(bends) > _LARGEST * size, np.ones(1 + _AFTER))[: len(bends)] > 0.5
    kept = np.where(large | lost, 0.0, bends)
    spread = math.sqrt(float(np.mean(kept[kept != 0.0] ** 2))) if kept.any() else 1.0
    kept = np.clip(kept / spread, -15.0, 15.0)  # a byte of eighths
    follow = float(kept[1:] @ kept[:-1])
    if not kept.any() or follow > _FOLLOW * float(kept @ kept):
        return None
    return kept


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
    """The row of `long` where `short` begins, if z is beyond chance there; negative before it."""
    size = fft.next_fast_len(len(long) + len(short), real=True)
    over = min(_SHORTEST, len(short), len(long))
    shifts = np.arange(over - len(short), len(long) - over + 1)

    def product(a: FloatArray, b: FloatArray) -> FloatArray:
        spectrum = fft.rfft(a, size, axis=0) * np.conj(fft.rfft(b, size, axis=0))
        return np.asarray(fft.irfft(spectrum.sum(axis=1), size)[shifts])

    common = product(long**2, short**2)
    enough = common > over
    if not enough.any():
        return None
    z = np.where(enough, product(long, short), 0.0) / np.sqrt(np.where(enough, common, 1.0))
    spread = max(1.0, float(np.median(np.abs(z[enough]))) / 0.6745)
    best = int(np.argmax(z))
    if z[best] <= _SURE * spread:
        return None
    shift = int(shifts[best])
    a, b = long[max(0, shift) : shift + len(short)], short[max(0, -shift) : len(long) - shift]
    a, b = np.where(b != 0.0, a, 0.0), np.where(a != 0.0, b, 0.0)
    alike = float(np.sum(a * b)) / math.sqrt(float(np.sum(a**2)) * float(np.sum(b**2)))
    return shift if alike >= _ALIKE else None


def _overlap(own: FloatArray, other: FloatArray, shift: int, middles: FloatArray) -> Overlap:
    """The part of `other` (at `middles`) in which its movements are those of `own`."""
    rows = np.arange(len(other)) + shift
    inside = np.flatnonzero((rows >= 0) & (rows < len(own)))
    products = np.zeros(len(other))
    products[inside] = np.sum(own[rows[inside]] * other[inside], axis=1)
    starts = np.arange(0, len(products), _SHORTEST)
    sums = np.add.reduceat(products, starts)
    alike = starts[sums > 0.2 * sums.max()]
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
    for name, source, identity in others:
        own = log.source
        engines = bool(source.engine and own.engine) and source.engine != own.engine
        parts = bool(own.file) and source.file == own.file and name != log.name
        if parts or (engines and source.sha256 == own.sha256):
            continue
        overlap = identity.within(log, outputs=engines)
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
