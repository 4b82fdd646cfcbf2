"""Operators on whole signals `(rows, time)`: lags, delays, play and limits of rate.

Before its first sample a signal has been at rest at that sample's value. Parameters `(rows,)`
differ from row to row.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from scipy.signal import lfilter

from narxcal.support.arrays import FloatArray


def lag(value: FloatArray, tau_s: FloatArray, dt_s: float) -> FloatArray:
    """First-order lag `tau dy/dt = x - y`, exact for an input that runs straight between samples.

    With `r = tau / dt` and `e = exp(-dt / tau)`:
    `y[k] = e y[k-1] + (1 - r (1 - e)) x[k] + (r (1 - e) - e) x[k-1]`. No lag at `tau_s` = 0.
    """
    tau = np.maximum(tau_s, 1e-9)
    kept, behind = np.exp(-dt_s / tau), -tau / dt_s * np.expm1(-dt_s / tau)
    return _recursion(value, tau_s, kept, [1.0 - behind, behind - kept])


def smooth_lag(value: FloatArray, tau_s: FloatArray, dt_s: float) -> FloatArray:
    """First-order lag, exact for an input on a parabola through each sample and the two before.

    A lag much shorter than a sample and a delay differ in how a signal curves, which straight
    lines do not know. With `r` and `e` of `lag`, the first two moments of the weight over a sample
    are `m = 1 - r (1 - e)` and `1 - 2 r m`; the curvature adds half their difference.
    """
    r = np.maximum(tau_s, 1e-9) / dt_s
    kept, behind = np.exp(-1.0 / r), -r * np.expm1(-1.0 / r)
    curved = 0.5 * ((1.0 - 2.0 * r * (1.0 - behind)) - (1.0 - behind))
    taps = [1.0 - behind + curved, behind - kept - 2.0 * curved, curved]
    return _recursion(value, tau_s, kept, taps)


def _recursion(
    value: FloatArray, tau_s: FloatArray, kept: FloatArray, taps: list[FloatArray]
) -> FloatArray:
    """`y[k] = kept y[k-1] + taps[0] x[k] + taps[1] x[k-1] ...`; the input at `tau_s` = 0."""
    there, out = np.asarray(tau_s) > 0.0, value.copy()
    alike, number = np.unique(np.column_stack([kept, *taps]), axis=0, return_inverse=True)
    for j, (pole, *zeros) in enumerate(alike):
        at = (number == j) & there
        # What the filter holds once it has settled at one.
        held = np.cumsum(zeros[:0:-1])[::-1]
        held[0] += pole
        begun = held * value[at, :1]
        poles = [1.0, -pole, *[0.0] * (len(zeros) - 2)]
        out[at], _ = lfilter(zeros, poles, value[at], axis=1, zi=begun)
    return out


def delay(value: FloatArray, delay_s: FloatArray, dt_s: float) -> FloatArray:
    """The input `delay_s` ago, on straight lines between samples.

    A negative delay looks ahead; then the last sample goes on.
    """
    (now, before), part = _delayed(value, delay_s / dt_s, 2)
    return np.asarray(now + part * (before - now))


def smooth_delay(value: FloatArray, delay_s: FloatArray, dt_s: float) -> FloatArray:
    """The input `delay_s` ago, on the cubic through four samples (Newton, backward differences).

    Never beyond the two samples that it lies between, so that a step does not overshoot.
    """
    samples, part = _delayed(value, delay_s / dt_s, 4)
    now, before, *_ = samples
    first, older, oldest = (later - earlier for later, earlier in pairwise(samples))
    second = first - older
    third = second - (older - oldest)
    bend = second / 2.0 + (2.0 - part) * third / 6.0
    found = now - part * (first + (1.0 - part) * bend)
    return np.clip(found, np.minimum(now, before), np.maximum(now, before))


def _delayed(
    value: FloatArray, steps: FloatArray, count: int
) -> tuple[list[FloatArray], FloatArray]:
    """The last `count` samples at so many `steps` ago, newest first, and the part of a step."""
    whole = np.floor(steps).astype(int)
    at, last = np.arange(value.shape[1]) - whole[:, None], value.shape[1] - 1
    samples = [np.take_along_axis(value, np.clip(at - k, 0, last), 1) for k in range(count)]
    return samples, (steps - whole)[:, None]


def play(value: FloatArray, width: FloatArray) -> FloatArray:
    """Backlash, the play operator: the output moves only where the input pushes it.

    `y[k] = clip(y[k-1], x[k] - width / 2, x[k] + width / 2)`; it starts in the middle.
    """
    out, at, half = np.empty_like(value), value[:, 0], 0.5 * width[:, None]
    low, high = value - half, value + half
    for k in range(value.shape[1]):
        out[:, k] = at = np.minimum(np.maximum(at, low[:, k]), high[:, k])
    return out


def rate_limit(value: FloatArray, rate: FloatArray, dt_s: float) -> FloatArray:
    """The output follows the input no faster than `rate` (per s)."""
    out, at, reach = np.empty_like(value), value[:, 0], rate * dt_s
    for k in range(value.shape[1]):
        step = value[:, k] - at
        at = np.where(np.abs(step) <= reach, value[:, k], at + np.copysign(reach, step))
        out[:, k] = at
    return out
