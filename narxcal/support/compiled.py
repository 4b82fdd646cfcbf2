"""The one decorator for functions compiled by numba, and the scalar lags of controls and probes.

A first-order lag `tau dy/dt = u - y` is advanced by its closed form, so its accuracy does not
depend on the time step; `tau = 0` means no lag.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, TypeVar, overload

from numba import njit

from narxcal.support.arrays import FloatArray

Function = TypeVar("Function", bound=Callable[..., Any])
# A product and the sum it goes into may be rounded once.
_FUSED = {"contract"}
# Sums may be reordered as well, but NaN and infinity keep their meaning.
_REORDERED = _FUSED | {"reassoc", "nsz", "arcp"}


@overload
def compiled(function: Function) -> Function: ...


@overload
def compiled(
    *, exact: bool = True, fused: bool = False, inline: bool = False
) -> Callable[[Function], Function]: ...


def compiled(
    function: Function | None = None,
    *,
    exact: bool = True,
    fused: bool = False,
    inline: bool = False,
) -> Any:
    """Compile `function` by numba; its Python signature and type stay what they were.

    With `exact` sums keep their order, so that balances close to rounding; without, they may be
    reordered, which is faster where results of the last digit do not matter. With `fused` the
    order stays, but a product is not rounded before it is added. `inline` makes the function a
    part of each compiled caller: for short loops that a call would slow down. No C caller needs a
    wrapper, and leaving it out saves compile time. A function that Python calls must not return
    a named tuple: a signal that arrives meanwhile would end the process
    (`narxcal.support.interrupt`).
    """

    def compile_(function: Function) -> Function:
        build: Any = njit  # its type does not list all its options
        same: Function = build(
            cache=True,
            inline="always" if inline else "never",
            nogil=True,
            error_model="numpy",
            no_cfunc_wrapper=True,
            fastmath=(_FUSED if fused else False) if exact else _REORDERED,
        )(function)
        return same

    return compile_ if function is None else compile_(function)


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
