"""Where a log stands still: the samples a steady-state model may be fitted to."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from scipy.ndimage import maximum_filter1d, minimum_filter1d

from data_prep.log import FloatArray, Log
from data_prep.recorded import recorded
from narxcal.settings import Section


class QuasiSteadyConfig(Section):
    """A sample is quasi-steady if, in the window centred on it, nothing moves much.

    `speed_pct` bounds the range of every speed channel in % and `driver_fraction` that of the
    driver as a share of its own robust range in the log.
    """

    window_s: float = Field(default=6.0, gt=0)
    speed_pct: float = Field(default=2.0, gt=0)
    driver_fraction: float = Field(default=0.03, gt=0)


def quasi_steady(
    log: Log, driver: str, speeds: tuple[str, ...], config: QuasiSteadyConfig
) -> NDArray[np.bool_]:
    """Mark quasi-steady samples (time,); a sample with NaN in its window is not.

    A speed of which the log has no sample at all says nothing.
    """
    # A window that reaches beyond the log sees no more than the log.
    size = 2 * min(round(0.5 * config.window_s / log.dt_s), len(log)) + 1
    values = log[driver]
    low, high = np.nanpercentile(values, [1, 99]) if np.isfinite(values).any() else (0.0, 0.0)
    still = _range(values, size) <= config.driver_fraction * (high - low)
    for name in recorded(log, speeds):
        still &= _range(log[name], size) <= config.speed_pct
    return still


def _range(values: FloatArray, size: int) -> FloatArray:
    known = np.isfinite(values)
    filled = np.where(known, values, 0.0)
    width: FloatArray = maximum_filter1d(filled, size) - minimum_filter1d(filled, size)
    return np.where(minimum_filter1d(known.astype(np.int8), size) == 1, width, np.inf)
