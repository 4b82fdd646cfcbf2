"""Gross errors of single samples: 3-sigma and Grubbs on the residual to a running median.

Signals and masks are `(time,)`, NaN where nothing was measured.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d, median_filter, minimum_filter1d
from scipy.special import stdtrit

from narxcal.support.arrays import BoolArray, FloatArray, bridge_gaps

Method = Literal["3-sigma", "grubbs"]

# The spread of the residual is taken over this many median windows.
_SPREAD_WINDOWS = 10
# Less than this part of the channel's range is no gross error, however quiet the channel is:
# without it the last digit of a noise-free simulation would be one.
_LEAST_PART = 0.002
# Significance of the Grubbs test, per block.
_ALPHA = 0.05


def running_median(values: FloatArray, window: int) -> FloatArray:
    """Median over a centred odd window; where a signal is monotone, that is the signal."""
    return np.asarray(median_filter(values, size=window, mode="nearest"))


def robust_range(values: FloatArray) -> tuple[float, float]:
    """Estimate the 0.5 and 99.5 percentile of the known samples; NaN where there are none."""
    known = values[np.isfinite(values)]
    if not len(known):
        return float("nan"), float("nan")
    low, high = np.percentile(known, (0.5, 99.5))
    return float(low), float(high)


def resolution(values: FloatArray) -> float:
    """Estimate the step of a quantised channel: small among the changes that happen at all."""
    steps = np.abs(np.diff(values))
    steps = steps[steps > 0.0]
    return float(np.percentile(steps, 5)) if len(steps) else 0.0


def gross_errors(
    values: FloatArray, window: int, sigmas: float, method: Method = "3-sigma"
) -> BoolArray:
    """Flag samples `(time,)` that stand off the running median; NaN never does.

    Local: a sample has to leave the median by `sigmas` standard deviations of the residual
    around it, on top of what the median itself moves within its window. A slam is monotone,
    so its residual is zero; a peak is no sharper than the median around it.
    """
    low, high = robust_range(values)
    known = np.isfinite(values)
    if not high > low:
        return np.zeros(len(values), dtype=np.bool_)
    filled = bridge_gaps(values)
    median = running_median(filled, window)
    residual = filled - median
    swing = maximum_filter1d(median, window) - minimum_filter1d(median, window)
    least = _LEAST_PART * (high - low)
    if method == "grubbs":
        flagged = _grubbs(np.where(known, residual, np.nan), window * _SPREAD_WINDOWS)
        return flagged & (np.abs(residual) > least + swing)
    # The median of a quantised residual is short of its spread by up to half a step, and may
    # be zero where the noise is not.
    step = resolution(values)
    spread = 1.4826 * _slow_median(np.abs(residual), window)
    spread = np.maximum(spread + 0.5 * step, step)
    return known & (np.abs(residual) > np.maximum(sigmas * spread, least) + swing)


def _slow_median(values: FloatArray, window: int) -> FloatArray:
    """Median over ten windows, evaluated once per window and interpolated in between."""
    coarse = np.nanmedian(_blocks(values, window), axis=1)
    slow = median_filter(coarse, size=_SPREAD_WINDOWS + 1, mode="nearest")
    centres = (np.arange(len(coarse)) + 0.5) * window
    return np.interp(np.arange(len(values)), centres, slow)


def _blocks(values: FloatArray, size: int) -> FloatArray:
    """Cut `(time,)` into `(block, size)`; the last block is filled up with NaN."""
    padded = np.full(-(-len(values) // size) * size, np.nan)
    padded[: len(values)] = values
    return padded.reshape(-1, size)


def _grubbs(residual: FloatArray, block: int) -> BoolArray:
    """Two-sided Grubbs test in blocks, repeated until no block loses a sample.

    Grubbs (1969), Technometrics 11: G = max|x - mean| / s against
    (N - 1)/sqrt(N) * sqrt(t^2 / (N - 2 + t^2)) with t the alpha/(2N) quantile of Student's t.
    """
    table = _blocks(residual, block)
    rows = np.arange(len(table))
    while True:
        known = np.isfinite(table)
        count = known.sum(axis=1)
        mean = np.where(known, table, 0.0).sum(axis=1) / np.maximum(count, 1)
        away = np.where(known, np.abs(table - mean[:, None]), 0.0)
        spread = np.sqrt((away**2).sum(axis=1) / np.maximum(count - 1, 1))
        worst = away.argmax(axis=1)
        bad = away[rows, worst] > _critical(count) * spread
        if not bad.any():
            break
        table[rows[bad], worst[bad]] = np.nan
    kept = np.isfinite(table.ravel()[: len(residual)])
    return np.asarray(np.isfinite(residual) & ~kept)


def _critical(count: NDArray[np.intp]) -> FloatArray:
    """Tabulate the critical G per block size; a block below three samples rejects nothing."""
    number = np.maximum(count, 3).astype(np.float64)
    quantile = stdtrit(number - 2.0, 1.0 - _ALPHA / (2.0 * number))
    limit = (number - 1) / np.sqrt(number) * np.sqrt(quantile**2 / (number - 2 + quantile**2))
    return np.where(count < 3, np.inf, limit)
