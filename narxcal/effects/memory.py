"""What effects remember: lags, delays, play, limits of rate, and the time.

Each is called with one block of samples after another, `(batch, time)`, and carries on where it
was: a log cut into blocks anywhere gives what the whole log gives at once. Before its first sample
everything has been at rest at that sample's value. `(batch,)` parameters differ from run to run.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import ClassVar, Protocol

import numpy as np
from scipy.signal import lfilter

from narxcal.support.arrays import FloatArray


class Memory(Protocol):
    """Anything that turns a block of samples (batch, time) into another and remembers it."""

    def __call__(self, value: FloatArray) -> FloatArray:
        """The block's own output, (batch, time)."""


class _Recursion:
    """`y[k] = kept y[k-1] + taps[0] x[k] + taps[1] x[k-1] ...`.

    `kept` is (batch,), `taps` (batch, two or more).
    """

    def __init__(self, kept: FloatArray, taps: FloatArray) -> None:
        self._coefficients = np.column_stack([kept, taps])
        self._carried: FloatArray | None = None

    def __call__(self, value: FloatArray) -> FloatArray:
        """The recursion over a block, from where the last one ended."""
        if self._carried is None:
            self._carried = self._at_rest() * value[:, :1]
        out, carried = np.empty_like(value), self._carried
        alike, rows = np.unique(self._coefficients, axis=0, return_inverse=True)
        for j, (kept, *taps) in enumerate(alike):
            at, poles = rows == j, [1.0, -kept, *[0.0] * (len(taps) - 2)]
            out[at], carried[at] = lfilter(taps, poles, value[at], axis=1, zi=carried[at])
        return out

    def _at_rest(self) -> FloatArray:
        """What the filter holds (batch, taps - 1) once it has settled at one."""
        later = np.cumsum(self._coefficients[:, :0:-1], axis=1)[:, -2::-1]
        later[:, 0] += self._coefficients[:, 0]
        return later


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
        taps = [np.where(there, 1.0 - behind, 1.0), np.where(there, behind - kept, 0.0)]
        super().__init__(np.where(there, kept, 0.0), np.column_stack(taps))


class SmoothLag(_Recursion):
    """First-order lag, exact for an input on a parabola through each sample and the two before.

    A lag much shorter than a sample and a delay differ in how a signal curves, which straight
    lines do not know. With `r` and `e` of `Lag`, the first two moments of the weight over a sample
    are `m = 1 - r (1 - e)` and `1 - 2 r m`; the curvature adds half their difference.
    """

    def __init__(self, tau_s: FloatArray, dt_s: float) -> None:
        tau_s = np.asarray(tau_s, dtype=np.float64)
        lag = np.maximum(tau_s, 1e-9) / dt_s
        kept, behind = np.exp(-1.0 / lag), -lag * np.expm1(-1.0 / lag)
        curved = 0.5 * ((1.0 - 2.0 * lag * (1.0 - behind)) - (1.0 - behind))
        there = tau_s > 0.0
        taps = [1.0 - behind + curved, behind - kept - 2.0 * curved, curved]
        none = np.array([1.0, 0.0, 0.0])
        super().__init__(
            np.where(there, kept, 0.0), np.where(there[:, None], np.column_stack(taps), none)
        )


class Delay:
    """The input `delay_s` ago, on straight lines between samples.

    A negative delay looks ahead: in one block for the whole log, its last sample goes on.
    """

    reach: ClassVar[int] = 1  # samples before the delayed one that are looked at

    def __init__(self, delay_s: FloatArray, dt_s: float) -> None:
        self._whole = np.floor(delay_s / dt_s).astype(int)
        self._part = (delay_s / dt_s - self._whole)[:, None]
        self._longest = max(int(self._whole.max()), 0) + self.reach
        self._past: FloatArray | None = None

    def __call__(self, value: FloatArray) -> FloatArray:
        """The block as it was `delay_s` ago."""
        if self._past is None:
            self._past = np.repeat(value[:, :1], self._longest, axis=1)
        known = np.concatenate([self._past, value], axis=1)
        self._past = known[:, -self._longest :]
        at = self._longest + np.arange(value.shape[1]) - self._whole[:, None]
        last = known.shape[1] - 1
        samples = [
            np.take_along_axis(known, np.minimum(at - k, last), 1) for k in range(self.reach + 1)
        ]
        return self._between(samples, self._part)

    def _between(self, samples: Sequence[FloatArray], part: FloatArray) -> FloatArray:
        """Value at `part` of a sample before the first of `samples`, newest first."""
        return np.asarray(samples[0] + part * (samples[1] - samples[0]))


class SmoothDelay(Delay):
    """The input `delay_s` ago, on the cubic through four samples (Newton, backward differences).

    Never beyond the two samples that it lies between, so that a step does not overshoot.
    """

    reach: ClassVar[int] = 3

    def _between(self, samples: Sequence[FloatArray], part: FloatArray) -> FloatArray:
        now, *_ = samples
        first, second, third = (_difference(samples, k) for k in (1, 2, 3))
        bend = second / 2.0 + (2.0 - part) * third / 6.0
        found = now - part * (first + (1.0 - part) * bend)
        return np.clip(found, np.minimum(now, samples[1]), np.maximum(now, samples[1]))


def _difference(samples: Sequence[FloatArray], order: int) -> FloatArray:
    """Backward difference at the first of `samples`, newest first."""
    rows = list(samples)
    for _ in range(order):
        rows = [later - earlier for later, earlier in pairwise(rows)]
    return rows[0]


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
