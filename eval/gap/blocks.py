"""Pairs as one batch: block means down to a common raster, padded to one length, with the noise."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from eval.gap.data import GapData, Pair
from narxcal.effects.base import Signals
from narxcal.effects.running import Flights
from narxcal.support.arrays import FloatArray, noise_level

RATE_HZ = 8.0
KEEP_HZ = 12.0  # slower logs are taken as they are
_STILL = 1e-6  # of a channel's size: what changes by less does not change
_SILENT = 1e-5  # of a channel's range: logs that agree to the digit have no less noise
_TRIMMED = 90.0  # percentile of the second differences that counts where their median is none


def batch(pairs: Sequence[Pair], rate_hz: float = RATE_HZ, keep_hz: float = KEEP_HZ) -> GapData:
    """Put all pairs on one raster of about `rate_hz`, by means over whole blocks of samples.

    Logs of up to `keep_hz` keep their own. Means do not shift recorded against simulated, and white
    noise falls with the root of the block. A block is known where at least half of it is.
    """
    size = block_size(pairs[0].dt_s, rate_hz, keep_hz)
    inputs, outputs = tuple(pairs[0].inputs), tuple(pairs[0].sim)
    u = [_blocks(pair.inputs, inputs, size) for pair in pairs]
    y = [_blocks(pair.sim, outputs, size) for pair in pairs]
    real = [_blocks(pair.real, outputs, size) for pair in pairs]
    signals = _signals(pairs[0], (u, y), pairs[0].dt_s * size)
    longest = max(len(each) for each in u)
    flights = Flights(
        signals,
        np.stack([_padded(each, longest) for each in u]),
        np.stack([_padded(each, longest) for each in y]),
        np.array([len(each) for each in u]),
    )
    measured = np.stack([_padded(each, longest, np.nan) for each in real])
    gaps = [r - s for r, s in zip(real, y, strict=True)]
    noise = np.maximum(_noise(gaps), _SILENT * (signals.high - signals.low))
    fast = _fast_energy(pairs, outputs, gaps)
    return GapData(flights, measured, noise, fast, tuple(pair.name for pair in pairs))


def block_size(dt_s: float, rate_hz: float = RATE_HZ, keep_hz: float = KEEP_HZ) -> int:
    """Samples in a block."""
    return 1 if 1.0 / dt_s <= keep_hz else max(1, round(1.0 / (dt_s * rate_hz)))


def block_means(values: FloatArray, size: int) -> FloatArray:
    """Means over `size` rows of (time, ...), NaN where less than half is known; a rest is cut."""
    whole = len(values) // size
    parts = values[: whole * size].reshape(whole, size, *values.shape[1:])
    known = np.isfinite(parts)
    count = known.sum(axis=1)
    total = np.where(known, parts, 0.0).sum(axis=1)
    return np.where(2 * count >= size, total / np.maximum(count, 1), np.nan)


def _blocks(channels: Mapping[str, FloatArray], names: Sequence[str], size: int) -> FloatArray:
    return block_means(np.column_stack([channels[name] for name in names]), size)


def _padded(rows: FloatArray, length: int, filling: float | None = None) -> FloatArray:
    last = rows[-1] if filling is None else np.full(rows.shape[1], filling)
    rest = np.repeat(last[None], length - len(rows), axis=0)
    return np.concatenate([rows, rest])


def _signals(
    pair: Pair, arrays: tuple[Sequence[FloatArray], Sequence[FloatArray]], dt_s: float
) -> Signals:
    u, y = (np.concatenate(part) for part in arrays)
    names = tuple(pair.inputs)
    size = np.maximum(np.abs(u).max(axis=0), 1e-9)
    active = tuple(np.array(names)[np.ptp(u, axis=0) > _STILL * size].tolist())
    driver = u[:, names.index(pair.driver)]
    return Signals(
        names,
        tuple(pair.sim),
        dt_s,
        pair.driver,
        y.min(axis=0),
        y.max(axis=0),
        (float(driver.min()), float(driver.max())),
        active,
    )


def _fast_energy(
    pairs: Sequence[Pair], outputs: Sequence[str], means: Sequence[FloatArray]
) -> FloatArray:
    """What block means take from the mean squared gap of each output, (outputs,)."""
    whole = np.concatenate([[p.real[n] - p.sim[n] for n in outputs] for p in pairs], axis=1)
    slow = np.concatenate(means)
    lost = np.nanmean(whole**2, axis=1) - np.nanmean(slow**2, axis=0)
    return np.asarray(np.maximum(lost, 0.0))


def _noise(gaps: Sequence[FloatArray]) -> FloatArray:
    """Standard deviation (outputs,) of the part of the gaps that changes from sample to sample."""
    return np.array(
        [float(np.median([_fast_part(gap[:, k]) for gap in gaps])) for k in range(gaps[0].shape[1])]
    )


def _fast_part(gap: FloatArray) -> float:
    """Noise of one gap: robust, and not fooled by a coarse resolution.

    Readings that mostly repeat give a median of none; the smaller nine tenths of the second
    differences then tell.
    """
    found = noise_level(gap)
    if found > 0.0:
        return found
    bends = np.abs(np.diff(gap, 2))
    bends = bends[np.isfinite(bends)]
    if not len(bends):
        return 0.0
    small = bends[bends <= np.percentile(bends, _TRIMMED)]
    return float(np.sqrt(np.mean(small**2) / 6.0))
