"""What a measurement does to a signal: lags, shifts in time, sampling, noise, steps, gaps.

Pure functions of arrays `(time,)`; `narxcal.flight_test.sensors` puts them in order. A signal is
taken as straight between its samples, and as constant before the first.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.signal import lfilter

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
# Below this share of its reference flow a turbine meter slows down no further: its bearings take
# over, and the law of the blades would end in a standstill.
_LEAST_FLOW = 0.05


def first_order(values: FloatArray, tau_s: float, dt_s: float) -> FloatArray:
    """Lag `tau dy/dt = x - y`, solved exactly for `x` straight between samples, settled at first.

    With `a = exp(-dt/tau)` and `g = (1 - a) tau / dt`:
    `y[k+1] = a y[k] + (1 - g) x[k+1] + (g - a) x[k]`.
    """
    if tau_s <= 0.0:
        return values.copy()
    a = math.exp(-dt_s / tau_s)
    g = -math.expm1(-dt_s / tau_s) * tau_s / dt_s
    # Measured from the first value, so that a resting signal comes back to the last bit.
    rest = values[0]
    lagged: FloatArray = lfilter([1.0 - g, g - a], [1.0, -a], values - rest)
    return np.asarray(lagged + rest)


def turbine_meter(values: FloatArray, tau_s: float, reference: float, dt_s: float) -> FloatArray:
    """Flow that a turbine meter shows: a lag whose time constant is `tau_s reference / flow`.

    The rotor is driven by the flow that it measures, so a slow flow moves it slowly (J. Grey,
    Transient response of the turbine flowmeter, Jet Propulsion 26, 1956). `reference` 0 means
    `tau_s` at every flow.
    """
    if reference <= 0.0 or tau_s <= 0.0:
        return first_order(values, tau_s, dt_s)
    shown: FloatArray = _turbine(np.ascontiguousarray(values), tau_s, reference, dt_s)
    return shown


@njit(cache=True)
def _turbine(values: Any, tau_s: float, reference: float, dt_s: float) -> Any:
    """Step the lag with the time constant of the mean flow of each interval."""
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
    """When a channel is sampled: `time_s` `(samples,)`, and which sample each row shows."""

    time_s: FloatArray
    shown: IntArray


def slots(rows: int, dt_s: float, rate_hz: float, slot_s: float) -> Slots:
    """Sampling times of a channel of `rate_hz`, `slot_s` into each frame, held until the next.

    A rate of 0, or one above that of the rows, means every row. The rows before the first slot
    show the sample of the frame before.
    """
    row = np.arange(rows)
    time_s = np.asarray(row * dt_s, dtype=np.float64)
    if rate_hz <= 0.0 or rate_hz * dt_s >= 1.0:
        return Slots(time_s, row)
    # A slot that falls on a row belongs to it, whatever the rounding of the division says.
    count = np.floor((time_s - slot_s) * rate_hz + 1e-9).astype(np.int64)
    first = int(count[0])
    samples = np.arange(first, int(count[-1]) + 1)
    sampled: FloatArray = slot_s + samples / rate_hz
    return Slots(sampled, count - first)


def at_times(values: FloatArray, dt_s: float, time_s: FloatArray, *, hold: bool) -> FloatArray:
    """Values of a signal at other times: interpolated, or with `hold` the latest sample's."""
    if hold:
        row = np.floor(time_s / dt_s + 1e-9).astype(np.int64)
        return np.asarray(values[np.clip(row, 0, len(values) - 1)])
    return np.interp(time_s, np.arange(len(values)) * dt_s, values)


def coloured(random: np.random.Generator, samples: int, decay: float) -> FloatArray:
    """Noise of unit variance `e[k+1] = decay e[k] + ...`: AR(1), stationary from the first."""
    white = random.standard_normal(samples)
    white[1:] *= math.sqrt(1.0 - decay**2)
    noise: FloatArray = lfilter([1.0], [1.0, -decay], white)
    return noise


def quantised(values: FloatArray, resolution: float) -> FloatArray:
    """Round to whole steps; 0 leaves the values alone."""
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


def within(time_s: FloatArray, spans: list[tuple[float, float]]) -> NDArray[np.bool_]:
    """Say which times lie inside a window, `start <= time < end`."""
    inside = np.zeros(len(time_s), dtype=np.bool_)
    for start, end in spans:
        inside |= (time_s >= start) & (time_s < end)
    return inside


def frozen(values: FloatArray, time_s: FloatArray, spans: list[tuple[float, float]]) -> FloatArray:
    """Repeat the last value before each window throughout it."""
    stuck = values.copy()
    for start, end in spans:
        rows = np.flatnonzero((time_s >= start) & (time_s < end))
        if len(rows):
            stuck[rows] = stuck[max(int(rows[0]) - 1, 0)]
    return stuck
