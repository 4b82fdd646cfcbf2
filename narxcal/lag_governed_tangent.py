"""One inner step of lags behind a control with its slopes by their parameters, compiled.

The values are those of `narxcal.lag_governed_steps`, each beside its slopes (P,) by the P wanted
parameters: forward sensitivities, the chain rule line by line. Where a bound holds, slopes are
zero. `narxcal.lag_governed_sensitivity` takes them over whole logs.

`x` (n,) holds what is carried through a step and `d` (n, P) its slopes, rows as named below.
`value` (g,) and `given` (g, P) hold what the step is made with: the lines with the slopes of their
*logarithms*, then the mean slopes c with theirs, then valve, clearance and shares with theirs.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from narxcal.kernels import compiled
from narxcal.lag_governed_steps import (
    CASING_S,
    CLEARANCE,
    CORE_S,
    DOWN,
    GAIN,
    LEAD_S,
    METAL_BY_SPEED,
    MOST_LOG,
    MOST_OPEN,
    MOST_SPEED,
    RESET_S,
    UP,
    VALVE,
    line,
    metal_time,
    slope,
)
from narxcal.lag_steps import within

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
# The fan is its deviation; the core's deviation and its acceleration are means over the step.
V, FAN, F, R, RATE, MASS, COVER, DEMAND, POWER, CORE, BEFORE, OTHERS = range(12)
IN_LINES, IN_SLOPES, IN_HEAT, IN_EXTRA = range(4)  # the array that a wanted parameter is in
_SMALLEST, _LARGEST = math.exp(-MOST_LOG), math.exp(MOST_LOG)


@compiled
def free(value: float, most: float) -> float:
    """The slope of `within`: 1, or 0 where the bound holds."""
    return 1.0 if -most < value < most else 0.0


@compiled
def give(
    engine: tuple[FloatArray, FloatArray],
    wanted: IntArray,
    at: tuple[FloatArray, FloatArray, float],
    d: FloatArray,
    made: tuple[FloatArray, FloatArray],
) -> None:
    """Fill what a step is `made` with from lines and slopes; valve, clearance and shares stay.

    `at` are the regressors z, the air, and where the core will settle. `wanted` (P, 3) says of each
    parameter in which array it is, its row and its column.
    """
    lines, slopes = engine
    value, given = made
    z, air, w = at
    v, first = z[4], len(lines)
    for j in range(first):
        value[j] = line(lines[j], z)
        _follow_speeds(lines[j], z, (value[j], given[j]), d)
    basis = (1.0, air[0], air[2], v + w, air[2] * (v + w), v * v + v * w + w * w)
    for i in range(len(slopes)):
        row = slopes[i]
        value[first + i] = slope(row, air, v, w)
        by_v = row[3] + row[4] * air[2] + row[5] * (2.0 * v + w)
        by_v *= free(v, MOST_SPEED)
        for p in range(len(wanted)):
            given[first + i, p] = by_v * d[V, p]
    for p in range(len(wanted)):
        kind, row_of, column = wanted[p]
        if kind == IN_LINES and _SMALLEST < value[row_of] < _LARGEST:
            given[row_of, p] += z[column]
        elif kind == IN_SLOPES:
            given[first + row_of, p] += basis[column]


@compiled
def _follow_speeds(
    q: FloatArray, z: FloatArray, of: tuple[float, FloatArray], d: FloatArray
) -> None:
    """Slopes of the logarithm of a line `of` some value, as far as they come from both speeds."""
    value, given = of
    inside = 1.0 if _SMALLEST < value < _LARGEST else 0.0
    by_v = inside * free(z[4], MOST_SPEED) * (q[4] + 2.0 * q[6] * z[4] + q[7] * z[5])
    by_u = inside * free(z[5], MOST_SPEED) * (q[5] + q[7] * z[4] + 2.0 * q[8] * z[5])
    for p in range(len(given)):
        given[p] = by_v * d[V, p] - by_u * d[FAN, p]


@compiled
def demand(
    x: FloatArray, d: FloatArray, made: tuple[FloatArray, FloatArray], error: float, extra: int
) -> None:
    """What the schedules let the governor ask for; `error` is its own, less the fan's rate.

    `extra` is the row of `made` at which valve, clearance and shares begin.
    """
    value, given = made
    core_s, gain, lead = value[CORE_S], value[GAIN], value[LEAD_S]
    error -= lead * x[RATE]
    rate = (x[R] + gain * error - x[V]) / core_s
    clearance, behind = value[extra + CLEARANCE], max(x[MASS] - x[COVER], 0.0)
    cost = within(clearance * behind, MOST_OPEN)
    by_cost = free(clearance * behind, MOST_OPEN)
    by_metal = by_cost * clearance if behind > 0.0 else 0.0
    sign, bound = (1.0, UP) if rate > 0.0 else (-1.0, DOWN)
    most = sign * value[bound] * math.exp(-sign * cost)
    held = sign * rate > sign * most
    rate = most if held else rate
    x[DEMAND] = x[V] + core_s * rate
    for p in range(d.shape[1]):
        if held:
            opened = by_metal * (d[MASS, p] - d[COVER, p])
            opened += by_cost * behind * given[extra + CLEARANCE, p]
            ratio = given[bound, p] - sign * opened + given[CORE_S, p]
            d[DEMAND, p] = d[V, p] + core_s * rate * ratio
        else:
            less = d[FAN, p] - lead * (d[RATE, p] + x[RATE] * given[LEAD_S, p])
            d[DEMAND, p] = d[R, p] + gain * (less + error * given[GAIN, p])


@compiled
def core(
    x: FloatArray,
    d: FloatArray,
    made: tuple[FloatArray, FloatArray],
    clock: FloatArray,
    extra: int,
) -> None:
    """Reset, valve and core a step on; `clock` is its length, the valve's decay and its slope."""
    value, given = made
    h, valve, by_valve = clock[0], clock[1], clock[2]
    over_reset, over_core = h / value[RESET_S], h / value[CORE_S]
    reset, slow = math.exp(-over_reset), math.exp(-over_core)
    asked, fuel, v = x[DEMAND], x[F], x[V]
    left_reset = (x[R] - asked) * reset
    x[R] = asked + left_reset
    x[F] = asked + (fuel - asked) * valve
    held = 0.5 * (fuel + x[F])
    left = (v - held) * slow
    x[V] = held + left
    x[POWER] = (x[V] - v) / h
    for p in range(d.shape[1]):
        by_asked, by_fuel, by_v = d[DEMAND, p], d[F, p], d[V, p]
        moved = left_reset * over_reset * given[RESET_S, p]
        d[R, p] = by_asked + (d[R, p] - by_asked) * reset + moved
        moved = (fuel - asked) * by_valve * given[extra + VALVE, p]
        d[F, p] = by_asked + (by_fuel - by_asked) * valve + moved
        by_held = 0.5 * (by_fuel + d[F, p])
        d[V, p] = by_held + (by_v - by_held) * slow + left * over_core * given[CORE_S, p]
        d[POWER, p] = (d[V, p] - by_v) / h
        d[CORE, p] = -0.5 * (by_v + d[V, p])


@compiled
def soak(x: FloatArray, d: FloatArray, z: FloatArray, h: float, by_v: FloatArray) -> None:
    """Metal and casing a step of `h` s on; `by_v` (P,) are the slopes of v before it."""
    metal_s = metal_time(z)
    inside = 1.0 if _SMALLEST < metal_s < _LARGEST else 0.0
    metal, casing = math.exp(-h / metal_s), math.exp(-h / CASING_S)
    left = (x[MASS] - x[F]) * metal
    x[MASS] = x[F] + left
    x[COVER] = x[MASS] + (x[COVER] - x[MASS]) * casing
    longer = inside * left * h / metal_s * METAL_BY_SPEED * free(z[4], MOST_SPEED)
    for p in range(d.shape[1]):
        d[MASS, p] = d[F, p] + (d[MASS, p] - d[F, p]) * metal + longer * by_v[p]
        d[COVER, p] = d[MASS, p] + (d[COVER, p] - d[MASS, p]) * casing


@compiled
def follow(
    now: tuple[FloatArray, FloatArray],
    made: tuple[FloatArray, FloatArray],
    rows: tuple[int, int, int, int, int],
    drive: tuple[float, float],
    h: float,
) -> None:
    """The deviation of the fan or of a temperature a step of `h` s on.

    `rows` are its own in `x` and, in `made`, those of its time (with its push behind it), its slope
    c, its share and the fan's slope. `drive` are the step of its settled value, and scaled values
    per unit.
    """
    x, d = now
    value, given = made
    own, time, c, share, fan = rows
    over, push, unit = h / value[time], value[time + 1], 1.0 / drive[1]
    a, ramp, lag = math.exp(-over), drive[0] / over, x[BEFORE] - value[fan] * x[CORE]
    drawn = unit * (value[c] * x[CORE] - push * x[POWER] + value[share] * lag)
    slower = a * over * (x[own] - drawn - ramp) + (1.0 - a) * ramp
    x[own] = a * x[own] + (1.0 - a) * (drawn + ramp)
    for p in range(d.shape[1]):
        by_lag = d[BEFORE, p] - given[fan, p] * x[CORE] - value[fan] * d[CORE, p]
        by_drawn = given[c, p] * x[CORE] + value[c] * d[CORE, p]
        by_drawn -= push * (d[POWER, p] + x[POWER] * given[time + 1, p])
        by_drawn += value[share] * by_lag + given[share, p] * lag
        d[own, p] = a * d[own, p] + (1.0 - a) * unit * by_drawn + slower * given[time, p]
