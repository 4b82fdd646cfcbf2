"""How runs of lags behind a control change with their parameters: forward sensitivities, compiled.

`lag_governed_sensitivity` has one inner step; here it is taken over whole logs, with the heat
of `narxcal.lumped.lag_governed_steps`. Differences of runs are the slow twin, and the test.

One inner step of lags behind a control with its slopes by their parameters, compiled.

The values are those of `lumped.lag_governed_steps`, each beside its slopes (P,) by the P wanted
parameters: forward sensitivities, the chain rule line by line. Where a bound holds, slopes are
zero. `narxcal.lumped.lag_governed_sensitivity` takes them over whole logs.

`x` (n,) holds what is carried through a step and `d` (n, P) its slopes, rows as named below.
`value` (g,) and `given` (g, P) hold what the step is made with: the lines with the slopes of their
*logarithms*, then the mean slopes c with theirs, then valve, clearance and shares with theirs.
"""

from __future__ import annotations

import math

import numpy as np

from narxcal.lumped.lag import CASING, FAST, SOAK, within
from narxcal.lumped.lag_governed_steps import (
    CASING_S,
    CLEARANCE,
    CORE_S,
    DOWN,
    FAN_S,
    GAIN,
    LEAD_S,
    LOG_BEGUN_TAU,
    LOG_SOAK_TAU,
    METAL,
    METAL_BY_SPEED,
    MOST_LEFT,
    MOST_LOG,
    MOST_OPEN,
    MOST_RATE,
    MOST_SPEED,
    OPEN_SHARE,
    REGRESSORS,
    REMEMBERED,
    RESET,
    RESET_S,
    SHARES,
    UP,
    VALVE,
    VALVE_S,
    bounded,
    inner_steps,
    line,
    metal_time,
    openness,
    regressors,
    slope,
)
from narxcal.support.arrays import FloatArray, IntArray
from narxcal.support.compiled import compiled

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


@compiled
def _made(
    engine: tuple[FloatArray, FloatArray, FloatArray], wanted: IntArray
) -> tuple[FloatArray, FloatArray]:
    """What steps are made with, see `lag_governed_sensitivity`; a last row stays zero."""
    lines, slopes, extra = engine
    first = len(lines) + len(slopes)
    value = np.zeros(first + len(extra) + 1)
    given = np.zeros((len(value), len(wanted)))
    for j in range(len(extra)):
        value[first + j] = extra[j]
    for p in range(len(wanted)):
        if wanted[p, 0] == IN_EXTRA:
            given[first + wanted[p, 1], p] = 1.0
    return value, given


@compiled
def _clock(dt_s: float, valve_s: float) -> FloatArray:
    """Length of an inner step, the valve's decay over it and its slope, and how many there are."""
    count = inner_steps(dt_s)
    h, tau = dt_s / count, bounded(valve_s, VALVE_S)
    keep = math.exp(-h / tau)
    by_valve = keep * h / (tau * tau) if tau == valve_s else 0.0
    return np.array([h, keep, by_valve, float(count)])


@compiled
def _opened(
    past: FloatArray,
    fast: FloatArray,
    at: tuple[FloatArray, FloatArray],
    x: FloatArray,
    d: FloatArray,
) -> None:
    """Take up the run where the sample before ended: its states `past`, slopes of the fast ones.

    `at` are the settled values then, and scaled values per unit now.
    """
    target, per_unit = at
    x[V], x[FAN] = target[0] - past[FAST, 0] * per_unit[0], past[FAST, 1] * per_unit[1]
    x[F], x[R] = target[0] - past[REMEMBERED, 0], target[0] - past[RESET, 0]
    x[MASS], x[COVER] = target[0] - past[METAL, 0], target[0] - past[METAL, 1]
    x[RATE] = past[REMEMBERED, 1]
    for o in range(2, len(fast)):
        x[OTHERS + o - 2] = past[FAST, o]
    for p in range(d.shape[1]):
        d[V, p], d[FAN, p] = -per_unit[0] * fast[0, p], per_unit[1] * fast[1, p]
        for o in range(2, len(fast)):
            d[OTHERS + o - 2, p] = fast[o, p]


@compiled
def _sample(
    drive: tuple[FloatArray, FloatArray, FloatArray, FloatArray],
    engine: tuple[FloatArray, FloatArray, IntArray],
    now: tuple[FloatArray, FloatArray],
    made: tuple[FloatArray, FloatArray],
    clock: tuple[int, FloatArray],
) -> None:
    """The inner steps of a sample; `engine` are lines, slopes and what is wanted of them."""
    ss, target, per_unit, air = drive
    lines, slopes, wanted = engine
    x, d = now
    k, times = clock
    h, count, z = times[0], int(times[3]), np.empty(len(REGRESSORS))
    fan_c, extra, nothing = len(lines), len(lines) + len(slopes), len(made[0]) - 1
    move, fan_move = target[k, 0] - target[k - 1, 0], target[k, 1] - target[k - 1, 1]
    by_v = np.empty(len(wanted))
    for s in range(count):
        w = target[k - 1, 0] + (s + 1.0) / count * move
        v, u = x[V], target[k - 1, 1] + s / count * fan_move - x[FAN]
        regressors(z, air[k], v, u)
        give((lines, slopes), wanted, (z, air[k], within(w, MOST_SPEED)), d, made)
        for p in range(len(by_v)):
            by_v[p] = d[V, p]
        demand(x, d, made, fan_move / count + x[FAN], extra)
        core(x, d, made, times, extra)
        x[CORE] = w - 0.5 * (move / count + v + x[V])
        soak(x, d, z, h, by_v)
        x[BEFORE] = x[FAN]
        for p in range(len(by_v)):
            d[BEFORE, p] = d[FAN, p]
        rows = (FAN, FAN_S, fan_c, nothing, fan_c)
        follow(now, made, rows, (fan_move / count, 1.0), h)
        x[RATE] = (fan_move / count - x[FAN] + x[BEFORE]) / h
        for p in range(len(by_v)):
            d[RATE, p] = (d[BEFORE, p] - d[FAN, p]) / h
        for o in range(2, ss.shape[1]):
            rows = (OTHERS + o - 2, 2 * o + 4, fan_c + o - 1, extra + SHARES + o - 2, fan_c)
            step = (ss[k, o] - ss[k - 1, o]) / count
            follow(now, made, rows, (step, per_unit[k, o]), h)


@compiled
def _closed(
    now: tuple[FloatArray, FloatArray], fast: FloatArray, per_unit: FloatArray, w: float
) -> FloatArray:
    """Fast deviations (o,) at the end of a sample, with their slopes in `fast`."""
    x, d = now
    found = np.empty(len(fast))
    found[0], found[1] = (w - x[V]) / per_unit[0], x[FAN] / per_unit[1]
    for o in range(2, len(fast)):
        found[o] = x[OTHERS + o - 2]
    kept = (free(w - x[F], MOST_LEFT), free(w - x[R], MOST_LEFT), free(x[RATE], MOST_RATE))
    metal, cover = free(w - x[MASS], MOST_LEFT), free(w - x[COVER], MOST_LEFT)
    for p in range(d.shape[1]):
        fast[0, p], fast[1, p] = -d[V, p] / per_unit[0], d[FAN, p] / per_unit[1]
        for o in range(2, len(fast)):
            fast[o, p] = d[OTHERS + o - 2, p]
        d[F, p], d[R, p], d[RATE, p] = kept[0] * d[F, p], kept[1] * d[R, p], kept[2] * d[RATE, p]
        d[MASS, p], d[COVER, p] = metal * d[MASS, p], cover * d[COVER, p]
    return found


@compiled
def _heat(
    p: FloatArray,
    states: tuple[FloatArray, FloatArray],
    wanted: tuple[IntArray, int],
    slopes: tuple[FloatArray, FloatArray, FloatArray, FloatArray],
    at: tuple[float, float, float, float, float],
) -> None:
    """Slopes of soak and casing of one output, whose heat is `p`, from one of `states` to the next.

    `wanted` has the output's number beside it. `slopes` are those of soak and casing, and of what
    opened the clearances then and now; `at` is as of `narxcal.lumped.lag_governed_steps`.
    """
    past, state = states
    soaked, casing, by_was, by_now = slopes
    step, w, thin, dt_s, half = at
    o, log_tau = wanted[1], p[1] + p[2] * w + p[3] * thin
    tau, begun_s = bounded(log_tau, LOG_SOAK_TAU), bounded(p[5], LOG_BEGUN_TAU)
    longer = state[SOAK, o] * dt_s * math.exp(-tau) if tau == log_tau else 0.0
    left, kept = math.exp(-dt_s / math.exp(tau)), math.exp(-dt_s / math.exp(begun_s))
    was, now = half * openness(past), half * openness(state)
    later = kept * (past[CASING, o] - p[4] * was) * dt_s * math.exp(-begun_s)
    later = later if begun_s == p[5] else 0.0
    direct = (left * step, longer, longer * w, longer * thin, now - kept * was, later)
    for q in range(len(soaked)):
        soaked[q] *= left
        casing[q] = kept * (casing[q] - p[4] * half * by_was[q]) + p[4] * half * by_now[q]
        kind, row, column = wanted[0][q]
        if kind == IN_HEAT and row == o:
            changed = soaked if column < OPEN_SHARE else casing
            changed[q] += direct[column]


@compiled
def _slow(
    k: int,
    drive: tuple[FloatArray, FloatArray, FloatArray, FloatArray],
    engine: tuple[FloatArray, IntArray, float],
    states: FloatArray,
    slopes: tuple[FloatArray, FloatArray],
) -> None:
    """Slopes of soak and casing of all outputs a sample on; `engine` ends with the raster in s."""
    ss, target, per_unit, air = drive
    heat, wanted, dt_s = engine
    carried, opened = slopes
    w = within(target[k, 0], MOST_SPEED)
    for o in range(len(heat)):
        at = (ss[k, o] - ss[k - 1, o], w, air[k, 0], dt_s, 1.0 / per_unit[k, o])
        own = (carried[SOAK, o], carried[CASING, o], opened[0], opened[1])
        _heat(heat[o], (states[k - 1], states[k]), (wanted, o), own, at)


@compiled
def _limited(quick: FloatArray, state: FloatArray, limit: FloatArray, carried: FloatArray) -> None:
    """Where a deviation is held at its limit its slopes are zero; `quick` are the fast ones."""
    for o in range(len(limit)):
        if abs(quick[o] + state[SOAK, o] + state[CASING, o]) >= limit[o]:
            for p in range(carried.shape[2]):
                carried[FAST, o, p] = -carried[SOAK, o, p] - carried[CASING, o, p]


@compiled
def run_sensitivities(
    drive: tuple[FloatArray, FloatArray, FloatArray, FloatArray],
    engine: tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray],
    run: tuple[FloatArray, float],
    wanted: IntArray,
    scored: tuple[IntArray, int],
) -> FloatArray:
    """Slopes (n, c, P) of deviations by the P `wanted` parameters along a free run from row 0 on.

    `drive` and `engine` are as of `run_governed`, `run` are the states
    (T, 6, o) that it gave and the raster in s. Rows of `wanted` (P, 3) say in which array a
    parameter is, its row and its column. `scored` are c outputs, core first, and of how many
    samples one is scored: n = ceil(T / every).
    """
    states, dt_s = run
    outputs, every = scored
    lines, slopes, extra, heat, limit = engine
    count, size = states.shape[2], len(wanted)
    made, clock = _made((lines, slopes, extra), wanted), _clock(dt_s, extra[VALVE])
    x, d = np.zeros(OTHERS + count - 2), np.zeros((OTHERS + count - 2, size))
    carried, opened = np.zeros((CASING + 1, count, size)), np.zeros((2, size))
    found = np.zeros(((len(states) + every - 1) // every, len(outputs), size))
    for k in range(1, len(states)):
        _opened(states[k - 1], carried[FAST], (drive[1][k - 1], drive[2][k]), x, d)
        _sample(drive, (lines, slopes, wanted), (x, d), made, (k, clock))
        quick = _closed((x, d), carried[FAST], drive[2][k], drive[1][k, 0])
        is_open = 1.0 if openness(states[k]) > 0.0 else 0.0
        for p in range(size):
            opened[0, p], opened[1, p] = opened[1, p], is_open * (d[MASS, p] - d[COVER, p])
        _slow(k, drive, (heat, wanted, dt_s), states, (carried, opened))
        _limited(quick, states[k], limit, carried)
        if k % every == 0:
            for i in range(len(outputs)):
                o = outputs[i]
                for p in range(size):
                    slow = carried[SOAK, o, p] + carried[CASING, o, p]
                    found[k // every, i, p] = carried[FAST, o, p] + slow
    return found
