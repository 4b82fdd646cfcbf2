"""What a measurement chain does to a signal: lags, samples, noise, steps, lost intervals.

Signals are arrays `(time,)`, linear between samples and constant before the first.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from scipy.signal import lfilter

from narxcal.support.arrays import BoolArray, FloatArray, IntArray
from narxcal.support.compiled import compiled

# Share of the reference flow below which the time constant of a turbine meter grows no further:
# friction of its bearings then dominates.
_LEAST_FLOW = 0.05


def first_order(values: FloatArray, tau_s: float, dt_s: float) -> FloatArray:
    """Lag `tau dy/dt = x - y`, exact for `x` linear between samples, steady at the first one.

    With `a = exp(-dt/tau)` and `g = (1 - a) tau / dt`:
    `y[k+1] = a y[k] + (1 - g) x[k+1] + (g - a) x[k]`.
    """
    if tau_s <= 0.0:
        return values.copy()
    a = math.exp(-dt_s / tau_s)
    g = -math.expm1(-dt_s / tau_s) * tau_s / dt_s
    # Relative to the first value, so that a constant signal is returned to the last bit.
    first = values[0]
    lagged: FloatArray = lfilter([1.0 - g, g - a], [1.0, -a], values - first)
    return np.asarray(lagged + first)


def turbine_meter(values: FloatArray, tau_s: float, reference: float, dt_s: float) -> FloatArray:
    """Reading of a turbine meter: a lag whose time constant is `tau_s reference / flow`.

    The rotor is driven by the flow that it measures (J. Grey, Transient response of the turbine
    flowmeter, Jet Propulsion 26, 1956). `reference` 0 means `tau_s` at every flow.
    """
    if reference <= 0.0 or tau_s <= 0.0:
        return first_order(values, tau_s, dt_s)
    return _turbine(np.ascontiguousarray(values), tau_s, reference, dt_s)


@compiled
def _turbine(values: FloatArray, tau_s: float, reference: float, dt_s: float) -> FloatArray:
    """Advance the lag with the time constant at the mean flow of each interval."""
    shown = np.empty_like(values)
    shown[0] = values[0]
    for k in range(len(values) - 1):
        flow = max(0.5 * (values[k] + values[k + 1]), _LEAST_FLOW * reference)
        rate = dt_s * flow / (tau_s * reference)
        a = math.exp(-rate)
        g = -math.expm1(-rate) / rate
        shown[k + 1] = a * shown[k] + (1.0 - g) * values[k + 1] + (g - a) * values[k]
    return shown


class Slots(NamedTuple):
    """Sampling times `time_s` `(samples,)` of a channel, and the sample that each row contains."""

    time_s: FloatArray
    shown: IntArray


def slots(rows: int, dt_s: float, rate_hz: float, slot_s: float) -> Slots:
    """Sampling times of a channel of `rate_hz`, `slot_s` into each frame, constant in between.

    A rate of 0, or one above that of the rows, means every row. The rows before the first slot
    contain the sample of the frame before.
    """
    row = np.arange(rows)
    time_s = np.asarray(row * dt_s, dtype=np.float64)
    if rate_hz <= 0.0 or rate_hz * dt_s >= 1.0:
        return Slots(time_s, row)
    # 1e-9: a slot that falls on a row belongs to it, whatever the rounding of the division.
    count = np.floor((time_s - slot_s) * rate_hz + 1e-9).astype(np.int64)
    first = int(count[0])
    samples = np.arange(first, int(count[-1]) + 1)
    sampled: FloatArray = slot_s + samples / rate_hz
    return Slots(sampled, count - first)


def at_times(values: FloatArray, dt_s: float, time_s: FloatArray, *, stepwise: bool) -> FloatArray:
    """Values of a signal at other times: interpolated, or with `stepwise` of the last sample."""
    if stepwise:
        row = np.floor(time_s / dt_s + 1e-9).astype(np.int64)
        return np.asarray(values[np.clip(row, 0, len(values) - 1)])
    return np.interp(time_s, np.arange(len(values)) * dt_s, values)


def coloured(random: np.random.Generator, samples: int, decay: float) -> FloatArray:
    """Draw AR(1) noise of unit variance, `e[k+1] = decay e[k] + w[k]`, stationary at once."""
    white = random.standard_normal(samples)
    white[1:] *= math.sqrt(1.0 - decay**2)
    noise: FloatArray = lfilter([1.0], [1.0, -decay], white)
    return noise


def quantised(values: FloatArray, resolution: float) -> FloatArray:
    """Round to multiples of `resolution`; 0 means no rounding."""
    if resolution <= 0.0:
        return values.copy()
    return np.round(values / resolution) * resolution


def windows(
    random: np.random.Generator, time_s: FloatArray, per_h: float, mean_s: float
) -> list[tuple[float, float]]:
    """Draw (start, end) times in order: a Poisson process, lengths exponential about `mean_s`."""
    begin, end = float(time_s[0]), float(time_s[-1])
    count = int(random.poisson(per_h * (end - begin) / 3600.0))
    starts = np.sort(random.uniform(begin, end, count))
    lengths = random.exponential(mean_s, count)
    return [(float(s), float(s + d)) for s, d in zip(starts, lengths, strict=True)]


def within(time_s: FloatArray, spans: Iterable[tuple[float, float]]) -> BoolArray:
    """Mark the times inside a window, `start <= time < end`."""
    inside = np.zeros(len(time_s), dtype=np.bool_)
    for start, end in spans:
        inside |= (time_s >= start) & (time_s < end)
    return inside


def frozen(values: FloatArray, time_s: FloatArray, spans: list[tuple[float, float]]) -> FloatArray:
    """Replace the values in each window by the last one before it."""
    stuck = values.copy()
    for start, end in spans:
        rows = np.flatnonzero((time_s >= start) & (time_s < end))
        if len(rows):
            stuck[rows] = stuck[max(int(rows[0]) - 1, 0)]
    return stuck
