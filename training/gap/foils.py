"""What is in no library but looks like an effect of it: a step of one channel is no drift.

A loose connector or a patched amplifier shifts a channel at once and for good. A ramp follows such
a step well enough to gain as a drift would, so that a drift is only believed where steps, one in
each flight at any time, would not explain more. Steps that may lie anywhere also follow whatever
else is wrong: what they gain once the drift is taken out is no evidence for them.
"""

from __future__ import annotations

import numpy as np

from narxcal.effects.base import FloatArray
from narxcal.effects.sensor_side import SensorDrift
from training.gap.fitting import Fit
from training.gap.quadratic import Misfit


def is_a_step(tried: Fit, measure: Misfit) -> bool:
    """Whether a drift in the fit is rather a step in mid-flight.

    Of a ramp the best step explains at most three quarters, and of a step the ramp. The ramp's rate
    is that of all flights.
    """
    at = 0
    for effect, count in zip(tried.effects, tried.sizes, strict=True):
        if isinstance(effect, SensorDrift):
            own = np.tensordot(tried.theta[at : at + count], tried.slopes[at : at + count], axes=1)
            gap = measure.cleaned(measure.gap - tried.response + own)
            column = int(np.argmax(np.abs(own).sum(axis=(0, 1))))
            flights = zip(
                gap[..., column], own[..., column], measure.weights[..., column], strict=True
            )
            if sum(_step_beyond_ramp(*flight) for flight in flights) > 0.0:
                return True
        at += count
    return False


def _step_beyond_ramp(gap: FloatArray, ramp: FloatArray, weights: FloatArray) -> float:
    """Squares that the best step takes off a flight's gap (time,) more than its ramp explains."""
    anyway = _of_step(gap - ramp, weights)
    return _of_step(gap, weights) - anyway - _of_shape(gap, ramp, weights)


def _of_shape(gap: FloatArray, shape: FloatArray, weights: FloatArray) -> float:
    """Squares (weighted) that a shape of any size takes off the gap (time,), beside an offset."""
    whole = max(float(weights.sum()), 1e-12)
    free = shape - float(weights @ shape) / whole
    return float(weights @ (gap * free)) ** 2 / max(float(weights @ free**2), 1e-12)


def _of_step(gap: FloatArray, weights: FloatArray) -> float:
    """Squares that the best step takes off the gap, beside an offset."""
    whole = max(float(weights.sum()), 1e-12)
    free = gap - float(weights @ gap) / whole
    toward, before = np.cumsum(weights * free)[:-1], np.cumsum(weights)[:-1]
    size = before * (whole - before) / whole
    inner = size > 1e-9 * whole
    return float((toward[inner] ** 2 / size[inner]).max(initial=0.0))
