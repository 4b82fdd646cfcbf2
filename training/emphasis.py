"""How much each sample of a flight counts in training, where motion is what has to be learned.

Flights stand still most of the time, and an anchored network is right there by its structure.
Relative errors are judged, so a sample counts the more the lower the engine runs; and Ti is read
off the first tenth of a response, which is over in half a second: the beginnings count more.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d, minimum_filter1d

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
_MOVES, _WITHIN_S = 0.01, 1.0  # share of the largest value that a target moves within this time
_BEFORE_S, _AFTER_S = 1.0, 12.0  # of a move: a response with its settling
_AT_REST = 0.4  # weight elsewhere
_STILL_S, _ONSET_S, _ONSET = 2.0, 1.2, 4.0  # a move after standing still, and what its onset counts
_LEVEL = (0.3, 1.2)  # shares of the largest value; below and beyond, weights go no further


def largest(targets: list[FloatArray]) -> FloatArray:
    """Largest magnitude (n_out,) of steady-state values (time, n_out) over all records."""
    most = np.stack([np.abs(one).max(axis=0) for one in targets]).max(axis=0)
    return np.asarray(np.maximum(most, 1e-9))


def motion_weight(
    target: FloatArray, actual: FloatArray, scale: FloatArray, dt_s: float
) -> FloatArray:
    """Weights (time,) from steady-state values and outputs (time, n_out), NaN where unknown.

    `scale` (n_out,) are the `largest` values.
    """
    moving = _moving(target / scale, dt_s)
    rows = np.arange(len(moving))
    never = len(rows) + round(_AFTER_S / dt_s) + 1
    last = np.maximum.accumulate(np.where(moving, rows, -never))
    following = np.minimum.accumulate(np.where(moving, rows, 2 * never)[::-1])[::-1]
    near = (rows - last <= _AFTER_S / dt_s) | (following - rows <= _BEFORE_S / dt_s)
    level = np.mean(np.where(np.isfinite(actual), actual, target) / scale, axis=1)
    weight = np.where(near, 1.0, _AT_REST)
    weight = weight * np.where(_onset(moving, dt_s), _ONSET, 1.0)
    return np.asarray(weight / np.clip(level, *_LEVEL))


def _moving(share: FloatArray, dt_s: float) -> BoolArray:
    size = round(_WITHIN_S / dt_s) | 1
    swing = maximum_filter1d(share, size, axis=0) - minimum_filter1d(share, size, axis=0)
    return np.asarray(swing.max(axis=1) > _MOVES)


def _onset(moving: BoolArray, dt_s: float) -> BoolArray:
    """Samples soon after a move that came out of stillness; the window sees it half too early."""
    still, length = round(_STILL_S / dt_s), round((_ONSET_S + 0.5 * _WITHIN_S) / dt_s)
    seen = np.concatenate([[0], np.cumsum(moving)])
    rows = np.arange(len(moving))
    begins = moving & (seen[rows] == seen[np.maximum(rows - still, 0)])
    counted = np.concatenate([[0], np.cumsum(begins)])
    return np.asarray(counted[rows + 1] > counted[np.maximum(rows + 1 - length, 0)])
