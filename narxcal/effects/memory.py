"""What effects remember: lags, delays, play, limits of rate, and the time.

Each is called with one block of samples after another, `(batch, time)`, and carries on where it
was: a log cut into blocks anywhere gives what the whole log gives at once. Before its first sample
everything has been at rest at that sample's value. `(batch,)` parameters differ from run to run.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

FloatArray = NDArray[np.float64]


class Memory(Protocol):
    """Anything that turns a block of samples (batch, time) into another and remembers it."""

    def __call__(self, value: FloatArray) -> FloatArray:
        """The block's own output, (batch, time)."""


class _Recursion:
    """`y[k] = kept y[k-1] + now x[k] + before x[k-1]`, each coefficient (batch,)."""

    def __init__(self, kept: FloatArray, now: FloatArray, before: FloatArray) -> None:
        self._coefficients = np.stack([kept, now, before], axis=1)
        self._carried: FloatArray | None = None

    def __call__(self, value: FloatArray) -> FloatArray:
        """The recursion over a block, from where the last one ended."""
        if self._carried is None:
            kept, _, before = self._coefficients.T
            self._carried = ((kept + before) * value[:, 0])[:, None]
        out, carried = np.empty_like(value), self._carried
        alike, rows = np.unique(self._coefficients, axis=0, return_inverse=True)
        for j, (kept, now, before) in enumerate(alike):
            at = rows == j
            out[at], carried[at] = lfilter(
                [now, before], [1.0, -kept], value[at], axis=1, zi=carried[at]
            )
        return out


class Lag(_Recursion):
    """First-order lag `tau dy/dt = x - y`, exact for an input that runs straight between samples.

    With `r = tau / dt` and `e = exp(-dt / tau)`:
    `y[k] = e y[k-1] + (1 - r (1 - e)) x[k] + (r (1 - e) - e) x[k-1]`. No lag at `tau_s` = 0.
    """

    def __init__(self, tau_s: FloatArray, dt_s: float) -> None:
        tau_s = np.asarray(tau_s, dtype=np.float64)
        lag = np.maximum(tau_s, 1e-9)
        kept, behind = np.exp(-dt_s / lag), -lag / dt_s * np.expm1(-dt_s / lag)
        there = tau_s > 0.0
        super().__init__(
            np.where(there, kept, 0.0),
            np.where(there, 1.0 - behind, 1.0),
            np.where(there, behind - kept, 0.0),
        )


class Delay:
    """The input `delay_s` ago, on straight lines between samples."""

    def __init__(self, delay_s: FloatArray, dt_s: float) -> None:
        self._whole = np.floor(delay_s / dt_s).astype(int)
        self._part = (delay_s / dt_s - self._whole)[:, None]
        self._longest = int(self._whole.max()) + 1
        self._past: FloatArray | None = None

    def __call__(self, value: FloatArray) -> FloatArray:
        """The block as it was `delay_s` ago."""
        if self._past is None:
            self._past = np.repeat(value[:, :1], self._longest, axis=1)
        known = np.concatenate([self._past, value], axis=1)
        self._past = known[:, -self._longest :]
        at = self._longest + np.arange(value.shape[1]) - self._whole[:, None]
        later, earlier = np.take_along_axis(known, at, 1), np.take_along_axis(known, at - 1, 1)
        return np.asarray(later + self._part * (earlier - later))


class Play:
    """Backlash, the play operator: the output moves only where the input pushes it.

    `y[k] = clip(y[k-1], x[k] - width / 2, x[k] + width / 2)`; it starts in the middle.
    """

    def __init__(self, width: FloatArray) -> None:
        self._half = 0.5 * width
        self._at: FloatArray | None = None

    def __call__(self, value: FloatArray) -> FloatArray:
        """The block as it is pushed through the play."""
        out = np.empty_like(value)
        at = value[:, 0] if self._at is None else self._at
        low, high = value - self._half[:, None], value + self._half[:, None]
        for k in range(value.shape[1]):
            at = np.minimum(np.maximum(at, low[:, k]), high[:, k])
            out[:, k] = at
        self._at = at
        return out


class RateLimit:
    """The output follows the input no faster than `rate` (per s)."""

    def __init__(self, rate: FloatArray, dt_s: float) -> None:
        self._reach = rate * dt_s
        self._at: FloatArray | None = None

    def __call__(self, value: FloatArray) -> FloatArray:
        """The block as it is followed."""
        out = np.empty_like(value)
        at, reach = value[:, 0] if self._at is None else self._at, self._reach
        for k in range(value.shape[1]):
            step = value[:, k] - at
            at = np.where(np.abs(step) <= reach, value[:, k], at + np.copysign(reach, step))
            out[:, k] = at
        self._at = at
        return out


class Clock:
    """Time in s since the first sample, whatever the input."""

    def __init__(self, dt_s: float) -> None:
        self._dt_s, self._step = dt_s, 0

    def __call__(self, value: FloatArray) -> FloatArray:
        """Times of the block."""
        steps = self._step + np.arange(value.shape[1])
        self._step += value.shape[1]
        return np.broadcast_to(steps * self._dt_s, value.shape)
