"""Which side of the engine the gap is on, by its shape alone.

A sensor's fault shows on one channel; what happens to the input shows on all of them as one shift
in time (or of the lever); the rest is the engine itself.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from eval.gap.data import GapData
from narxcal.support.arrays import FloatArray
from training.gap.quadratic import TOLERANCE

_ALONE = 0.6  # share of one channel from which on the others may just not have been hit


class Sides(NamedTuple):
    """Shares of input, process and sensor side; they add up to 1, or to 0 where there is no gap."""

    input: float
    process: float
    sensor: float


NOWHERE = Sides(0.0, 0.0, 0.0)


def side_of(data: GapData, gap: FloatArray, channels: FloatArray) -> Sides:
    """Judge by evidence: `gap` (flights, time, outputs), `channels` (outputs,) shares of energy."""
    if channels.sum() <= 0.0:
        return NOWHERE
    alone = float(channels.max() / channels.sum())
    sensor = float(np.clip((alone - _ALONE) / (1.0 - _ALONE), 0.0, 1.0)) if len(channels) > 1 else 0
    shifted = (1.0 - sensor) * _common_shift(data, gap)
    return Sides(shifted, max(0.0, 1.0 - sensor - shifted), sensor)


def _common_shift(data: GapData, gap: FloatArray) -> float:
    """Part of the gap's energy that one shift in time of all channels explains."""
    scale = np.sqrt(data.noise**2 + (TOLERANCE * data.span) ** 2)
    slope = -np.gradient(data.flights.y, data.flights.signals.dt_s, axis=1) / scale
    known = np.isfinite(gap)
    seen = np.where(known, gap, 0.0) / scale
    slope = np.where(known, slope, 0.0)
    energy, both = float((seen**2).sum()), float((seen * slope).sum())
    moving = float((slope**2).sum())
    floor = float((known * (data.noise / scale) ** 2).sum())
    if moving <= 0.0 or energy <= floor:
        return 0.0
    return float(np.clip(both**2 / moving / (energy - floor), 0.0, 1.0))
