"""Array types, and what every room does with gaps and flags of a signal.

Signals are `(time,)` with NaN where nothing was measured, flags are bool `(time,)`.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
AnyFloats = NDArray[np.floating[Any]]
BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.int64]

# Median of |N(0, 1)|: turns a median of absolute values into a standard deviation.
_MEDIAN_OF_NORMAL = 0.6745


def runs(flags: BoolArray) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Find the runs of True: their starts and (exclusive) stops."""
    edges = np.diff(np.concatenate(([0], flags.view(np.int8), [0])))
    return np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)


def spans(flags: BoolArray) -> list[tuple[int, int]]:
    """List the runs of True as (start, stop)."""
    starts, stops = runs(flags)
    return list(zip(starts.tolist(), stops.tolist(), strict=True))


def long_runs(flags: BoolArray, longest: int) -> BoolArray:
    """Keep only the runs of True that are longer than `longest` samples."""
    kept = np.zeros(len(flags), dtype=np.bool_)
    for start, stop in spans(flags):
        kept[start:stop] = stop - start > longest
    return kept


def last_true(flags: BoolArray) -> NDArray[np.intp]:
    """Index of the last True at or before each sample along the first axis; -1 before any."""
    count = np.arange(len(flags)).reshape(-1, *[1] * (flags.ndim - 1))
    return np.asarray(np.maximum.accumulate(np.where(flags, count, -1), axis=0))


def sample_and_hold(values: FloatArray) -> FloatArray:
    """Fill NaN with the last finite value; leading NaN with the first one. (time,) -> (time,)."""
    known = np.isfinite(values)
    if not known.any():
        return values
    at = last_true(known)
    return values[np.where(at < 0, known.argmax(), at)]


def bridge_gaps(values: FloatArray) -> FloatArray:
    """Fill NaN linearly between its neighbours, and with the nearest value at the ends."""
    known = np.isfinite(values)
    if known.all() or not known.any():
        return values
    index = np.arange(len(values))
    return np.interp(index, index[known], values[known])


def on_lines(at: AnyFloats, times: AnyFloats, rows: FloatArray) -> FloatArray:
    """Values `at` some times on the lines between `rows` (time, n) at `times`, held beyond."""
    return np.column_stack([np.interp(at, times, column) for column in rows.T])


def known_mean(values: FloatArray, axis: int = 0) -> FloatArray:
    """Mean of the finite values along an axis; NaN where there are none."""
    known = np.isfinite(values)
    count = known.sum(axis=axis)
    total = np.where(known, values, 0.0).sum(axis=axis)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


def block_means(values: FloatArray, size: int) -> FloatArray:
    """Means over `size` rows of (time, ...), NaN where less than half is known; a rest is cut."""
    whole = len(values) // size
    parts = values[: whole * size].reshape(whole, size, *values.shape[1:])
    known = np.isfinite(parts)
    count = known.sum(axis=1)
    total = np.where(known, parts, 0.0).sum(axis=1)
    return np.where(2 * count >= size, total / np.maximum(count, 1), np.nan)


def noise_level(values: FloatArray) -> float:
    """Estimate the standard deviation of white noise on a smooth signal; 0 for under 3 samples.

    A second difference of white noise has variance 6 s^2; the median keeps steps and manoeuvres
    out of it.
    """
    bends = np.abs(np.diff(values, 2))
    bends = bends[np.isfinite(bends)]
    return float(np.median(bends) / (_MEDIAN_OF_NORMAL * np.sqrt(6.0))) if len(bends) else 0.0


def robust_range(values: FloatArray) -> tuple[float, float]:
    """Estimate the 0.5 and 99.5 percentile of the finite samples; NaN where there are none."""
    known = values[np.isfinite(values)]
    if not len(known):
        return float("nan"), float("nan")
    low, high = np.percentile(known, (0.5, 99.5)).tolist()
    return low, high
