"""How runs of lags behind a control change with their parameters: forward sensitivities, compiled.

`narxcal.lag_governed_tangent` has one inner step; here it is taken over whole logs, with the heat
of `narxcal.lag_governed_steps`. Differences of runs are the slow twin, and the test.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from narxcal.kernels import compiled
from narxcal.lag_governed_steps import (
    FAN_S,
    LOG_BEGUN_TAU,
    LOG_SOAK_TAU,
    METAL,
    MOST_LEFT,
    MOST_RATE,
    MOST_SPEED,
    OPEN_SHARE,
    REGRESSORS,
    REMEMBERED,
    RESET,
    SHARES,
    VALVE,
    VALVE_S,
    bounded,
    inner_steps,
    openness,
    regressors,
)
from narxcal.lag_governed_tangent import (
    BEFORE,
    CORE,
    COVER,
    FAN,
    IN_EXTRA,
    IN_HEAT,
    MASS,
    OTHERS,
    RATE,
    F,
    R,
    V,
    core,
    demand,
    follow,
    free,
    give,
    soak,
)
from narxcal.lag_steps import CASING, FAST, SOAK, within

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


@compiled
def _made(
    engine: tuple[FloatArray, FloatArray, FloatArray], wanted: IntArray
) -> tuple[FloatArray, FloatArray]:
    """What steps are made with, see `narxcal.lag_governed_tangent`; a last row stays zero."""
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
    opened the clearances then and now; `at` is as of `narxcal.lag_governed_steps`.
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

    `drive` and `engine` are as of `narxcal.lag_governed_steps.run_governed`, `run` are the states
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
