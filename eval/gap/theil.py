"""Theil's split of a gap: what is offset, what is size, what is shape.

Theil, *Applied Economic Forecasting*, 1966: the mean squared difference of two series is

    (mean difference)^2 + (difference of deviations)^2 + 2 (1 - correlation) product of deviations
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from eval.gap.data import GapData
from narxcal.support.arrays import FloatArray


class Theil(NamedTuple):
    """Shares of the mean squared gap, which add up to 1, and Theil's inequality U.

    U is 0 for equal series and at most 1.
    """

    bias: float
    variance: float
    covariance: float
    inequality: float


def theil(real: FloatArray, sim: FloatArray) -> Theil:
    """Split the gap between two series (time,); samples where either is NaN are left out."""
    known = np.isfinite(real) & np.isfinite(sim)
    a, b = real[known], sim[known]
    mean_square = float(np.mean((a - b) ** 2)) if len(a) else 0.0
    if mean_square == 0.0:
        return Theil(0.0, 0.0, 0.0, 0.0)
    bias = float(a.mean() - b.mean()) ** 2 / mean_square
    variance = float(a.std() - b.std()) ** 2 / mean_square
    size = float(np.sqrt(np.mean(a**2)) + np.sqrt(np.mean(b**2)))
    return Theil(bias, variance, 1.0 - bias - variance, float(np.sqrt(mean_square)) / size)


def theil_of(data: GapData) -> dict[str, Theil]:
    """Theil's split of every output, over all flights as one series."""
    sim = np.where(np.isfinite(data.real), data.flights.y, np.nan)
    return {
        name: theil(data.real[..., k].ravel(), sim[..., k].ravel())
        for k, name in enumerate(data.flights.signals.outputs)
    }
