"""Responses of first- and second-order systems to a step and a ramp; their scaling.

| symbol | meaning | unit |
|---|---|---|
| tau_0, T_d | time constant, delay | s |
| xi, w | damping ratio, natural frequency | -, rad/s |
| r, y | output over its static value, r scaled to 0 .. 1 | - |
| t10, t90 | times at which y first reaches 0.1 and 0.9 | s |

Sources: equations 21 to 27 of the Citation X paper (26 and 27 are lost; the forms are the standard
ones); the ramp follows from the step by linearity.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from narxcal.support.arrays import FloatArray
from narxcal.support.errors import DataError, ModelError

LN_RATIO = math.log(9.0)  # t90 - t10 of a first-order system over tau_0
LN_LATE, LN_EARLY = math.log(10.0), math.log(10.0 / 9.0)
_NOISES = 3.0  # a move below three standard deviations of the noise cannot be scaled


class System(Protocol):
    """A stable system of gain one that is in equilibrium before t = 0."""

    def step(self, t: FloatArray) -> FloatArray: ...  # noqa: D102
    def integral(self, t: FloatArray) -> FloatArray: ...  # noqa: D102


@dataclass(frozen=True)
class FirstOrder:
    """First-order lag with a delay: y = 1 - exp(-(t - T_d)/tau_0) (eqs 23, 25)."""

    tau_s: float
    delay_s: float = 0.0

    def step(self, t: FloatArray) -> FloatArray:
        """Unit step response at t (time,), zero before the delay."""
        late = np.maximum(t - self.delay_s, 0.0)
        return np.asarray(-np.expm1(-late / self.tau_s))

    def integral(self, t: FloatArray) -> FloatArray:
        """Response to the ramp of slope one."""
        late = np.maximum(t - self.delay_s, 0.0)
        return np.asarray(late + self.tau_s * np.expm1(-late / self.tau_s))

    @classmethod
    def through(cls, t10: float, t90: float) -> FirstOrder:
        """System with these two times: tau_0 = (t90 - t10)/ln 9, T_d = t10 - tau_0 ln(10/9)."""
        tau = (t90 - t10) / LN_RATIO
        return cls(tau, t10 - tau * LN_EARLY)


@dataclass(frozen=True)
class SecondOrder:
    """Second-order system (eqs 26, 27), over-damped and under-damped by one formula.

        y = 1 - exp(-xi w t) (cosh(a t) + (xi w / a) sinh(a t)),  a = w sqrt(xi^2 - 1)

    a is imaginary for xi < 1; at xi = 1 the limit 1 - (1 + w t) exp(-w t) is reached smoothly.
    """

    xi: float
    omega_radps: float

    def _terms(self, t: FloatArray) -> tuple[FloatArray, FloatArray]:
        """exp(-xi w t) times cosh(a t) and times sinh(a t)/a, without overflow."""
        a = self.omega_radps * np.sqrt(complex(self.xi**2 - 1.0)) or 1e-30
        slow = np.exp((a - self.xi * self.omega_radps) * t)
        fall = np.expm1(-2.0 * a * t)
        return np.real(slow * (1.0 + 0.5 * fall)), np.real(-slow * fall / (2.0 * a))

    def step(self, t: FloatArray) -> FloatArray:
        """Unit step response at t (time,), zero for t < 0."""
        even, odd = self._terms(np.maximum(t, 0.0))
        return np.asarray(1.0 - even - self.xi * self.omega_radps * odd)

    def integral(self, t: FloatArray) -> FloatArray:
        """Response to the ramp of slope one: t - 2 xi/w + its own decaying terms."""
        late, xi, w = np.maximum(t, 0.0), self.xi, self.omega_radps
        even, odd = self._terms(late)
        return np.asarray(late - 2.0 * xi / w * (1.0 - even) + (2.0 * xi**2 - 1.0) * odd)


def ramp(system: System, t: FloatArray, duration_s: float) -> FloatArray:
    """Response to a ramp from 0 to 1 within `duration_s`, then held."""
    return np.asarray((system.integral(t) - system.integral(t - duration_s)) / duration_s)


@dataclass(frozen=True)
class Scale:
    """Scaling of a ratio to 0 .. 1 (eq. 22): y = (r - start)/(end - start)."""

    start: float
    end: float

    @classmethod
    def of(cls, ratio: FloatArray, *, noise: float = 0.0, name: str = "the response") -> Scale:
        """Scaling of `ratio` (time,) by its first and last sample.

        Raises `DataError` if it moves by less than three times `noise`: nothing to identify.
        """
        start, end = float(ratio[0]), float(ratio[-1])
        if not abs(end - start) > max(_NOISES * noise, 1e-9 * max(abs(start), abs(end))):
            raise DataError(
                f"{name} moves from {start:.6g} to {end:.6g}, within its noise of {noise:.3g}: the "
                f"input never moves, or the output does not follow it",
                hint="Leave this record out",
            )
        return cls(start, end)

    def scaled(self, ratio: FloatArray) -> FloatArray:
        """Ratio to y."""
        return np.asarray((ratio - self.start) / (self.end - self.start))

    def ratio(self, y: FloatArray) -> FloatArray:
        """Inverse: y to the ratio."""
        return np.asarray(self.start + (self.end - self.start) * y)


def rise_times(t: FloatArray, y: FloatArray) -> tuple[float, float]:
    """Times (t10, t90) at which y (time,) first reaches 0.1 and 0.9, between samples linearly.

    Raises `ModelError` if it does not within the record.
    """
    return _reached(t, y, 0.1), _reached(t, y, 0.9)


def _reached(t: FloatArray, y: FloatArray, level: float) -> float:
    above = y >= level
    if not above.any():
        raise ModelError(
            f"the response does not reach {100.0 * level:.0f} % within {t[-1] - t[0]:.3g} s",
            hint="Record it for longer",
        )
    k = int(np.argmax(above))
    if k == 0:
        return float(t[0])
    return float(t[k - 1] + (t[k] - t[k - 1]) * (level - y[k - 1]) / (y[k] - y[k - 1]))
