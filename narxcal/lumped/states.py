"""What both forms of the lumped engine share: states, drive, and the lag of an output.

The deviation d = ss - y of an output y from its steady-state value ss follows a lag tau, in closed
form over a step h in which ss changes by D and the pull is constant (`follow`):

    dd/dt = dss/dt - (d - pull) / tau

| symbol | meaning | unit |
|---|---|---|
| v, u | corrected speeds of core and fan, scaled to [-1, 1] over the training logs | - |
| w, s | their steady-state values | - |
| d_c, d_f | deviations w - v of the core and s - u of the fan | - |
| thin, hot | ln(sqrt(theta2) / delta2), ln sqrt(theta2) of the air | - |
| z(x, y) | [1, thin, hot, x, y, x^2, x y, y^2] | - |

Times, gains and limits are exponentials of polynomials in speeds and air (NACA TR-1011: dynamic
coefficients are corrected for altitude like steady-state data). An engine is `limited` or
`governed`; `theta` has its parameters in the order of the names there. All functions are for floats
and for dual numbers (`narxcal.support.dual`).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from narxcal import atmosphere
from narxcal.support.arrays import FloatArray, IntArray
from narxcal.support.compiled import compiled
from narxcal.support.dual import clip, get, put

# Rows of the states. The first three add up to the deviation; the others are the core's under a
# governor: fuel, reset, metal and casing as deviations from w, and du/dt.
FAST, SOAK, CASING, FUEL, RESET, METAL, COVER, FAN_RATE, ROWS = range(9)

_SPEED = 1.5  # bound of a scaled speed in polynomials


class Engine(NamedTuple):
    """Numbers of an engine as compiled functions take them.

    `theta` (P,) are floats or dual numbers, `limit` (o,) bounds each deviation. `outputs` are the
    columns to be run: the core, then the fan, then others. `own` (o,) is the speed on which an
    output depends: itself or the core. `rank` (o,) is its place in the order core, fan, others.
    """

    theta: FloatArray
    limit: FloatArray
    outputs: IntArray
    own: IntArray
    rank: IntArray
    governed: bool


class Drive(NamedTuple):
    """What an engine follows, row by row; row 0 is the sample before the first step.

    Steady-state values `ss` (T, o), the same corrected and scaled, `target` (T, o), the scaled
    value per unit of the output, `per_unit` (T, o), and `air` (T, 3): thin, hot, Mach.
    """

    ss: FloatArray
    target: FloatArray
    per_unit: FloatArray
    air: FloatArray

    def rows(self, part: slice | IntArray) -> Drive:
        return Drive(*(np.ascontiguousarray(column[part]) for column in self))

    def after(self, before: Drive) -> Drive:
        """These rows behind those of `before`."""
        pairs = zip(before, self, strict=True)
        return Drive(*(np.concatenate(pair) for pair in pairs))


_total_ratios = compiled(atmosphere.total_ratios)


@compiled(exact=False)
def conditions(
    inputs: FloatArray, ss: FloatArray, centre: FloatArray, half: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """What `Drive` adds to ss, from altitude, Mach and dT (T, 3), ss (T, o) and scales (o,)."""
    target, per_unit, air = np.empty(ss.shape), np.empty(ss.shape), np.empty((len(ss), 3))
    for k in range(len(ss)):
        theta2, delta2 = _total_ratios(inputs[k, 0], inputs[k, 1], inputs[k, 2])
        root = math.sqrt(theta2)
        air[k, 0], air[k, 1], air[k, 2] = math.log(root / delta2), math.log(root), inputs[k, 1]
        target[k] = (ss[k] / root - centre) / half
        per_unit[k] = 1.0 / (root * half)
    return target, per_unit, air


@compiled(exact=False)
def quadratic(
    p: FloatArray, at: tuple[int, tuple[int, ...]], air: FloatArray, x: float, y: float
) -> float:
    """Polynomial `a . z(x, y)` of the parameters a at base + columns, which `at` gives."""
    base, c = at[0], at[1]
    level: float = get(p, base + c[0]) + get(p, base + c[1]) * air[0] + get(p, base + c[2]) * air[1]
    by_x = get(p, base + c[3]) + get(p, base + c[5]) * x + get(p, base + c[6]) * y
    return level + by_x * x + (get(p, base + c[4]) + get(p, base + c[7]) * y) * y


@compiled(exact=False)
def bounded(speed: float) -> float:
    """A scaled speed as polynomials take it."""
    return clip(speed, -_SPEED, _SPEED)


@compiled(exact=False)
def follow(d: float, pull: float, step: float, times: tuple[float, float]) -> float:
    """Deviation d after a step in which ss moves by `step`; `times` are tau and h."""
    tau, h = times
    a = math.exp(-h / tau)
    return a * d + (1.0 - a) * (pull + step * tau / h)


@compiled(exact=False)
def deviation(x: FloatArray, o: int) -> float:
    """Whole deviation of an output in the states `x`."""
    return get(x, (FAST, o)) + get(x, (SOAK, o)) + get(x, (CASING, o))


@compiled(exact=False)
def finish(x: FloatArray, o: int, soak: float, casing: float, most: float) -> None:
    """Store the slow parts, and the fast one so that the sum stays within +-`most`."""
    slow = soak + casing
    put(x, (FAST, o), clip(get(x, (FAST, o)) + slow, -most, most) - slow)
    put(x, (SOAK, o), soak)
    put(x, (CASING, o), casing)
