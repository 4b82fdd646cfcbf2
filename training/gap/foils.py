"""What looks like an effect of the library but is in none: a step is no drift, slow fuel no heat.

A loose connector or a patched amplifier shifts a channel at once and for good. A ramp follows such
a step well enough to gain as a drift would, so that a drift is only believed where steps, one in
each flight at any time, would not explain more. Steps that may lie anywhere also follow whatever
else is wrong: what they gain once the drift is taken out is no evidence for them.

Metal that takes up heat is seen in the temperature. A share for every output also follows what is
slow in one of the others, as a fuel flow that creeps where the control trims it; and whatever fades
faster or goes on longer than metal takes heat up ends on a bound of its time constant.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from narxcal.effects.base import Effect
from narxcal.effects.sensor_side import SensorDrift
from narxcal.effects.steady import HeatSoak
from narxcal.support.arrays import FloatArray
from training.gap.fitting import Fit
from training.gap.quadratic import Misfit

_SEEN = 0.5  # of what heat soak takes: so much at least of a temperature


def foil(tried: Fit, measure: Misfit, outputs: Sequence[str]) -> str:
    """What an effect of the fit is instead, in words; empty if it only is what it is."""
    if is_no_heat(tried, measure, outputs):
        return "but no temperature shows the heat"
    if is_no_metal(tried):
        return "but as heat that comes and goes faster or slower than any metal's"
    if is_a_step(tried, measure):
        return "but as a step in mid-flight, which is no drift"
    return ""


def is_a_step(tried: Fit, measure: Misfit) -> bool:
    """Whether a drift in the fit is rather a step in mid-flight.

    Of a ramp the best step explains at most three quarters, and of a step the ramp. The ramp's rate
    is that of all flights.
    """
    for own in _own(tried, SensorDrift):
        gap = measure.cleaned(measure.gap - tried.response + own)
        column = int(np.argmax(np.abs(own).sum(axis=(0, 1))))
        every = (gap[..., column], own[..., column], measure.weights[..., column])
        if sum(_step_beyond_ramp(*flight) for flight in zip(*every, strict=True)) > 0.0:
            return True
    return False


def is_no_heat(tried: Fit, measure: Misfit, outputs: Sequence[str]) -> bool:
    """Whether a heat soak in the fit takes most from other outputs than the temperature.

    Of logs without a temperature nothing can be said.
    """
    if "EGT_C" not in outputs:
        return False
    left = measure.weights * measure.cleaned(measure.gap - tried.response) ** 2
    for own in _own(tried, HeatSoak):
        with_it = measure.weights * measure.cleaned(measure.gap - tried.response + own) ** 2
        taken = (with_it - left).sum(axis=(0, 1))
        if taken[outputs.index("EGT_C")] < _SEEN * taken.sum():
            return True
    return False


def is_no_metal(tried: Fit) -> bool:
    """Whether a heat soak in the fit has a time constant at an end of what metal has.

    What it follows then is a probe or a cross-talk that fades in seconds, or no more than a drift.
    """
    at = 0
    for effect, count in zip(tried.effects, tried.sizes, strict=True):
        tau = tried.parameters[at]
        if isinstance(effect, HeatSoak) and float(tried.theta[at]) in (tau.low, tau.high):
            return True
        at += count
    return False


def _own(tried: Fit, kind: type[Effect]) -> Iterator[FloatArray]:
    """What each effect of a kind changes by itself, (flights, time, outputs).

    By its linear parameters: all of a drift's, the shares of heat soak.
    """
    at = 0
    for effect, count in zip(tried.effects, tried.sizes, strict=True):
        if isinstance(effect, kind):
            linear = [k for k in range(at, at + count) if tried.parameters[k].linear]
            yield np.tensordot(tried.theta[linear], tried.slopes[linear], axes=1)
        at += count


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
