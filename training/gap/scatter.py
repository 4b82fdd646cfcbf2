"""How far apart two builds of one engine are, by where the recorded one settles."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from narxcal.effects.running import Flights
from narxcal.support.arrays import FloatArray
from training.gap.quadratic import Misfit

_ZERO_K = 273.15


def levels(y: FloatArray, outputs: Sequence[str]) -> FloatArray:
    """Outputs (..., outputs) as percents are taken of them: temperatures in kelvin."""
    zeros = np.array([_ZERO_K if name.endswith("_C") else 0.0 for name in outputs])
    return np.asarray(y + zeros)


def build_scatter(flights: Flights, measure: Misfit) -> float:
    """Share of its level by which the second most shifted output is off, in the median.

    Components that differ shift several outputs at once. The most shifted one may be a wrong
    sensor's, so that it counts only where there is no other.
    """
    shifts, absolute = [], levels(flights.y, flights.signals.outputs)
    for c in range(absolute.shape[-1]):
        known = measure.weights[..., c] > 0.0
        if not known.any():
            continue
        level = absolute[..., c][known]
        shift = abs(float(np.median(measure.gap[..., c][known])))
        shifts.append(shift / max(float(np.sqrt(np.mean(level**2))), 1e-9))
    return sorted(shifts)[-2:][0] if shifts else 0.0
