"""Step responses of first- and second-order systems, and their fit (section 4.2).

| symbol | meaning | unit |
|---|---|---|
| tau_0, T_d | time constant, delay | s |
| xi, w | damping ratio, natural frequency | -, rad/s |
| r, y | output over its static value, r scaled to 0 .. 1 | - |
| t10, t90 | times at which y first reaches 0.1 and 0.9 | s |

| kind | parameters found | by |
|---|---|---|
| first | tau_0 | least squares |
| first t90 | tau_0 = t90 / ln 10 | eq. 24 |
| delayed | T_d by the paper's search over multiples of T_s, tau_0 = (t90 - T_d)/ln 10 | eq. 25 |
| second | xi, w | least squares |

Sources: equations 21 to 27 of the Citation X paper (26 and 27 are lost; the forms are the standard
ones).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from narxcal.support.arrays import FloatArray
from narxcal.support.errors import DataError, ModelError
from training.steady.static_fit import Boxed

LN_LATE, LN_EARLY = math.log(10.0), math.log(10.0 / 9.0)
ResponseKind = Literal["first", "first t90", "delayed", "second"]
KINDS: tuple[ResponseKind, ...] = ("first", "first t90", "delayed", "second")
TOLERANCE = 0.10  # of t10 and of t90 (FAA AC 120-40B)
_SINGLE_POLE = 3.0  # damping ratio above which the second time constant has no effect


@dataclass(frozen=True)
class FirstOrder:
    """First-order lag with a delay: y = 1 - exp(-(t - T_d)/tau_0) (eqs 23, 25)."""

    tau_s: float
    delay_s: float = 0.0

    def step(self, t: FloatArray) -> FloatArray:
        """Unit step response at t (time,), zero before the delay."""
        late = np.maximum(t - self.delay_s, 0.0)
        return np.asarray(-np.expm1(-late / self.tau_s))


@dataclass(frozen=True)
class SecondOrder:
    """Second-order system (eqs 26, 27), over-damped and under-damped by one formula.

        y = 1 - exp(-xi w t) (cosh(a t) + (xi w / a) sinh(a t)),  a = w sqrt(xi^2 - 1)

    a is imaginary for xi < 1; at xi = 1 the limit 1 - (1 + w t) exp(-w t) is reached smoothly.
    """

    xi: float
    omega_radps: float

    def step(self, t: FloatArray) -> FloatArray:
        """Unit step response at t (time,), zero for t < 0; without overflow."""
        late, decay = np.maximum(t, 0.0), self.xi * self.omega_radps
        a = self.omega_radps * np.sqrt(complex(self.xi**2 - 1.0)) or 1e-30
        slow, fall = np.exp((a - decay) * late), np.expm1(-2.0 * a * late)
        even, odd = np.real(slow * (1.0 + 0.5 * fall)), np.real(-slow * fall / (2.0 * a))
        return np.asarray(1.0 - even - decay * odd)


System = FirstOrder | SecondOrder


@dataclass(frozen=True)
class Scale:
    """Scaling of a ratio to 0 .. 1 (eq. 22): y = (r - start)/(end - start)."""

    start: float
    end: float

    @classmethod
    def of(cls, ratio: FloatArray, *, name: str = "the response") -> Scale:
        """Scaling of `ratio` (time,) by its first and last sample.

        Raises `DataError` if it does not move: nothing to identify.
        """
        start, end = float(ratio[0]), float(ratio[-1])
        if not abs(end - start) > 1e-9 * max(abs(start), abs(end)):
            raise DataError(
                f"{name} moves from {start:.6g} to {end:.6g}: the input never moves, or the output "
                "does not follow it",
                hint="Leave this record out",
            )
        return cls(start, end)

    def scaled(self, ratio: FloatArray) -> FloatArray:
        return np.asarray((ratio - self.start) / (self.end - self.start))

    def ratio(self, y: FloatArray) -> FloatArray:
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


@dataclass(frozen=True, eq=False)
class ResponseFit:
    """Fitted system, its parameters as (name, value, unit), RMS error of y, status."""

    kind: ResponseKind
    system: System
    parameters: tuple[tuple[str, float, str], ...]
    rmse: float
    status: str

    @property
    def values(self) -> FloatArray:
        """Parameters (P,)."""
        return np.array([value for _, value, _ in self.parameters])


def fit_response(t: FloatArray, y: FloatArray, kind: ResponseKind) -> ResponseFit:
    """Fit a step response to y (time,), scaled to 0 .. 1, at t (time,), 0 at the disturbance.

    Raises `DataError` for NaN, `ModelError` where y does not reach 90 % within the record.
    """
    if not (np.isfinite(y).all() and len(y) == len(t) and len(y) > 2):
        raise DataError(
            f"expected a finite response of more than two samples, found {len(y)} of which "
            f"{int(np.isfinite(y).sum())} are finite"
        )
    t10, t90 = rise_times(t, y)
    status = "closed form"
    match kind:
        case "first":
            start = np.array([max(t90, t[1] - t[0]) / LN_LATE])
            found, status = _least_squares(kind, t, y, (start, start / 100.0, start * 100.0))
        case "first t90":
            found = np.array([t90 / LN_LATE])
        case "delayed":
            found = search_delay(t10, t90, float(t[1] - t[0]))
        case "second":
            w = 3.9 / max(t90, t[1] - t[0])
            bounds = np.array([0.1, 0.05]), np.array([5.0, max(50.0, 2.0 * w)])
            found, status = _least_squares(kind, t, y, (np.array([1.2, w]), *bounds))
            if found[0] > _SINGLE_POLE:
                status += "; xi > 3: the second time constant is not identifiable"
    system = system_of(kind, found)
    rmse = float(np.sqrt(np.mean(np.square(system.step(t) - y))))
    return ResponseFit(kind, system, _named(kind, found), rmse, status)


def system_of(kind: ResponseKind, values: FloatArray) -> System:
    """System with the parameters of `ResponseFit.values`."""
    numbers = [float(value) for value in values]
    return SecondOrder(*numbers) if kind == "second" else FirstOrder(*numbers)


def search_delay(t10: float, t90: float, T_s: float) -> FloatArray:
    """T_d = 0, T_s, 2 T_s .. while the error of t10 falls; tau_0 by eq. 25: (tau_0, T_d).

    The closed form tau_0 = (t90 - t10)/ln 9, T_d = t10 - tau_0 ln(10/9) is within T_s of it.
    """

    def early(T_d: float) -> float:
        tau = (t90 - T_d) / LN_LATE
        return abs(T_d + tau * LN_EARLY - t10)

    steps = 0
    while (steps + 1) * T_s < t90 and early((steps + 1) * T_s) < early(steps * T_s):
        steps += 1
    return np.array([(t90 - steps * T_s) / LN_LATE, steps * T_s])


def rise_times_agree(
    t: FloatArray, model: FloatArray, data: FloatArray, tolerance: float = TOLERANCE
) -> bool:
    """Whether t10 and t90 of `model` each lie within `tolerance` of those of `data` (section 2.7).

    A response that does not reach 90 % fails.
    """
    if not ((model >= 0.9).any() and np.isfinite(model).all()):
        return False
    pairs = zip(rise_times(t, model), rise_times(t, data), strict=True)
    return all(abs(ours - theirs) <= tolerance * abs(theirs) for ours, theirs in pairs)


def _least_squares(
    kind: ResponseKind, t: FloatArray, y: FloatArray, box: tuple[FloatArray, FloatArray, FloatArray]
) -> tuple[FloatArray, str]:
    """Start, low and high in `box`; fitted in logarithms, so that fast and slow are alike."""

    def residuals(logs: FloatArray) -> FloatArray:
        rows = np.atleast_2d(np.exp(logs))
        found = np.array([system_of(kind, row).step(t) - y for row in rows])
        return found.reshape(*logs.shape[:-1], len(t))

    start, low, high = map(np.log, box)
    theta, status = Boxed(residuals, low, high).minimum(start)
    return np.exp(theta), status


def _named(kind: ResponseKind, values: FloatArray) -> tuple[tuple[str, float, str], ...]:
    names = (("xi", "-"), ("w", "rad/s")) if kind == "second" else (("tau_0", "s"), ("T_d", "s"))
    pairs = zip(names, values.tolist(), strict=False)
    return tuple((name, value, unit) for (name, unit), value in pairs)
