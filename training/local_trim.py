"""Takes the static error out of what the network learns from, so that it learns dynamics only.

A steady-state model misses a real engine by a few tenths of a per cent here and there (build
scatter, fuel meters, bleed that nobody recorded). A network trained on the raw deviation bends
its dynamics to follow that. Before training, the steady-state values of each log are therefore
shifted to agree with the log wherever it stands still; between two such places A and B the
shift goes from the one to the other as the steady-state value itself does:

    shift(k) = shift_A + p(k) (shift_B - shift_A),   p = clip((ss - ss_A) / (ss_B - ss_A), 0, 1)
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]


def locally_trimmed(ss: FloatArray, measured: FloatArray, still: BoolArray) -> FloatArray:
    """Return `ss` (time, n_out) shifted to agree with `measured` where `still` (time,) holds.

    A masked measurement counts as not still. An output that never stands still is unchanged.
    """
    return np.stack(
        [
            column + _shift(column, column - truth, still & np.isfinite(truth))
            for column, truth in zip(ss.T, measured.T, strict=True)
        ],
        axis=1,
    )


def _shift(ss: FloatArray, error: FloatArray, still: BoolArray) -> FloatArray:
    known = np.flatnonzero(still)
    if not len(known):
        return np.zeros_like(ss)
    rows = np.arange(len(ss))
    after = np.searchsorted(known, rows)
    a = known[np.maximum(after - 1, 0)]
    b = known[np.minimum(after, len(known) - 1)]
    rise = ss[b] - ss[a]
    by_value = np.divide(ss - ss[a], rise, out=np.zeros_like(ss), where=rise != 0.0)
    by_time = np.divide(rows - a, b - a, out=np.zeros_like(ss), where=b != a)
    # Where the ends lie close together, the value says little about the way between them.
    close = np.abs(rise) < 0.02 * np.ptp(ss)
    part = np.clip(np.where(close, by_time, by_value), 0.0, 1.0)
    shift: FloatArray = -(error[a] + part * (error[b] - error[a]))
    return shift
