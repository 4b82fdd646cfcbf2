"""Compiles the engine's functions by numba; to their callers they stay what they were.

First-order lags and table look-up as the engine's controls and probes use them.

A lag `tau dy/dt = u - y` is stepped by its closed form, so the step's length costs no accuracy;
`tau = 0` means no lag at all.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, TypeVar

from numba import njit

from narxcal.support.arrays import FloatArray

Function = TypeVar("Function", bound=Callable[..., Any])


def compiled(function: Function) -> Function:
    """Compile `function`, which may call other compiled ones and take named tuples of floats.

    Sums keep their order: the balances of the cycle are closed to rounding. Nobody calls from C,
    and leaving that wrapper out saves time of compiling. What Python calls returns no named tuple:
    a signal that arrives meanwhile would end the process (`narxcal.support.interrupt`).
    """
    build: Any = njit  # whose type does not name all its options
    same: Function = build(cache=True, nogil=True, error_model="numpy", no_cfunc_wrapper=True)(
        function
    )
    return same


@compiled
def lag_share(tau_s: float, dt_s: float) -> float:
    """Part of the way to a constant target that a lag covers in `dt_s`: `1 - exp(-dt / tau)`."""
    return -math.expm1(-dt_s / tau_s) if tau_s > 0.0 else 1.0


@compiled
def lagged(y: float, target: float, tau_s: float, dt_s: float) -> float:
    """Output of the lag after `dt_s` of a constant `target`, from `y`."""
    return target if tau_s <= 0.0 else y + lag_share(tau_s, dt_s) * (target - y)


@compiled
def ramp_lagged(y: float, ends: tuple[float, float], tau_s: float, dt_s: float) -> float:
    """Output of the lag after `dt_s` of a target that runs straight between the two `ends`."""
    start, end = ends
    if tau_s <= 0.0:
        return end
    behind = tau_s * (end - start) / dt_s
    return end - behind + math.exp(-dt_s / tau_s) * (y - start + behind)


@compiled
def slewed(y: float, target: float, limits: tuple[float, float], dt_s: float) -> float:
    """Output of a rate-limited lag, `dy/dt = clip((target - y) / tau, -slew, slew)`.

    `limits` are `(tau_s, slew)`, the latter in units of `y` per second, infinite for none. The
    output runs at the limit until it is `tau slew` away, and from there on like the lag.
    """
    tau_s, slew = limits
    gap = abs(target - y)
    if math.isinf(slew) or gap <= tau_s * slew:
        return lagged(y, target, tau_s, dt_s)
    sign = 1.0 if target > y else -1.0
    saturated_s = (gap - tau_s * slew) / slew
    if dt_s <= saturated_s:
        return y + sign * slew * dt_s
    return lagged(target - sign * tau_s * slew, target, tau_s, dt_s - saturated_s)


@compiled
def table_value(x: float, knots: FloatArray, values: FloatArray) -> float:
    """Straight lines between `values` at ascending `knots`, held beyond the ends; NaN stays NaN."""
    last = len(knots) - 1
    if math.isnan(x):
        return x
    if x <= knots[0]:
        return float(values[0])
    if x >= knots[last]:
        return float(values[last])
    low, high = 0, last
    while high - low > 1:
        middle = (low + high) // 2
        if knots[middle] <= x:
            low = middle
        else:
            high = middle
    share = (x - knots[low]) / (knots[high] - knots[low])
    return float(values[low] + share * (values[high] - values[low]))
