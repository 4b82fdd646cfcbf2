"""The lags of an engine whose control holds N1, step by step, compiled, with their equations.

All speeds are corrected and scaled to [-1, 1]; v is the core's, u the fan's, w and s where they
would settle. The control asks for a fuel flow, which counts as the core speed that it would hold:

    f_asked  = r + gain (s - u - lead du/dt)                  a governor of N1, with its reset r
    df/dt    = (f_asked - f) / valve                          behind the fuel valve
    dv/dt    = p = (f - v) / core_s                           and the core has f - v to spare,
    dr/dt    = (f_asked - r) / reset_s

where f_asked is kept within v + core_s up and v - core_s down: schedules of acceleration and
deceleration hold the ratio of fuel to the pressure behind the compressor, and that goes by both
spools. The reset follows the fuel that is really asked for, so that it cannot wind up (Shinskey,
*Process Control Systems*). With d the deviations s - u and w - v, and those of temperatures,

    dd_fan/dt = ds/dt   - (d_fan - c d_core + push p) / fan_s
    dd_T/dt   = dT_ss/dt - (d_T - c d_core - share (d_fan - c_fan d_core) + push p) / probe_s

for a fan and a temperature follow the core, and the fuel that it has to spare drives both. Times,
gains and limits are exp(q . z) with z the `REGRESSORS`; c says by how much a settled engine's
output changes with its core's speed, the mean slope of a cubic between v and w that goes by the
air. What holds N1 makes N2 and the temperature fall below where they settle after a pull, and stay
there until the heavy fan has come down.

To the core's deviation and those of temperatures is added what open clearances move where the
control holds N1, share max(m - n, 0) in half ranges, with what a run began with, which dies down
(casing); and the heat that the metal gives up or takes (soak): d(k) = exp(-dt / tau) (d(k-1) +
share D), D the increment of ss, log tau a line over w and the thin air.
"""

from __future__ import annotations

import math

import numpy as np

from narxcal.lumped.lag import CASING, FAST, SOAK, within
from narxcal.support.arrays import FloatArray, IntArray
from narxcal.support.compiled import compiled

REGRESSORS = ("one", "thin", "hot", "Mach", "v", "u", "vv", "vu", "uu")
# The lines of `core` and fan, and those of every other output behind them.
LINES = ("core_s", "gain", "reset_s", "lead_s", "up", "down", "fan_s", "push")
CORE_S, GAIN, RESET_S, LEAD_S, UP, DOWN, FAN_S, PUSH = range(8)
OTHER_LINES = ("probe_s", "push")
SLOPES = ("const", "thin", "Mach", "tilt", "tilt_Mach", "bend")
HEAT = ("soak_share", "log_soak_tau", "soak_speed", "soak_air", "open_share", "log_begun_tau")
OPEN_SHARE = HEAT.index("open_share")
VALVE, CLEARANCE, SHARES = range(3)  # in `extra`; shares from there on
# Rows of the states: what is added up to the deviation, and what is only remembered. The latter
# are fuel, reset, metal and (where the fan is) casing as deviations from w, and the fan's rate.
REMEMBERED, RESET, METAL, ROWS = 3, 4, 5, 6
_STEP_S = 0.04  # at most, of the inner step
_MIDDLE, METAL_BY_SPEED, _BY_AIR, CASING_S = 2.85, -0.5, 0.8, 80.0  # FACTS A4: 30 to 300 s
# Bounds: of any logarithm, of speeds and of what open clearances cost where they count, of what is
# remembered, of the valve's lag, of log tau of soak and casing. A bound that holds has slope zero.
MOST_LOG, MOST_SPEED, MOST_OPEN, MOST_LEFT, MOST_RATE = 5.0, 1.5, 1.0, 5.0, 20.0
VALVE_S, LOG_SOAK_TAU, LOG_BEGUN_TAU = (0.01, 1.0), (-0.5, 4.5), (2.0, 5.0)
_V, _U, _F, _R, _RATE, _POWER, _METAL, _COVER = range(8)


@compiled
def inner_steps(dt_s: float) -> int:
    """How many steps a sample takes."""
    return max(1, math.ceil(dt_s / _STEP_S - 1e-9))


@compiled
def bounded(value: float, bounds: tuple[float, float]) -> float:
    """`value` within `bounds`."""
    return min(max(value, bounds[0]), bounds[1])


@compiled
def line(q: FloatArray, z: FloatArray) -> float:
    """exp(q . z), no further than e to the fifth power."""
    found = 0.0
    for j in range(len(z)):
        found += q[j] * z[j]
    return math.exp(within(found, MOST_LOG))


@compiled
def slope(row: FloatArray, air: FloatArray, v: float, w: float) -> float:
    """Mean slope of an output over the core's speed between `v` and `w`."""
    tilt: float = row[3] + row[4] * air[2]
    bend: float = row[5] * (v * v + v * w + w * w)
    found: float = row[0] + row[1] * air[0] + row[2] * air[2] + tilt * (v + w) + bend
    return found


@compiled
def regressors(z: FloatArray, air: FloatArray, v: float, u: float) -> None:
    """Fill `z` with the `REGRESSORS`."""
    v, u = within(v, MOST_SPEED), within(u, MOST_SPEED)
    z[0], z[1], z[2], z[3], z[4], z[5] = 1.0, air[0], air[1], air[2], v, u
    z[6], z[7], z[8] = v * v, v * u, u * u


@compiled
def metal_time(z: FloatArray) -> float:
    """How long the metal takes to heat up, in s."""
    return math.exp(within(_MIDDLE + METAL_BY_SPEED * z[4] + _BY_AIR * z[1], MOST_LOG))


@compiled
def _soak(x: FloatArray, z: FloatArray, h: float) -> None:
    """Metal and casing a step of `h` s on."""
    x[_METAL] = x[_F] + (x[_METAL] - x[_F]) * math.exp(-h / metal_time(z))
    x[_COVER] = x[_METAL] + (x[_COVER] - x[_METAL]) * math.exp(-h / CASING_S)


@compiled
def _core(
    engine: tuple[FloatArray, float],
    z: FloatArray,
    x: FloatArray,
    asked: float,
    clock: FloatArray,
) -> None:
    """Control, valve and core over a step; `clock` is its length and what the valve's lag keeps.

    `engine` are the lines and what open clearances cost.
    """
    lines, clearance = engine
    h, core_s = clock[0], line(lines[CORE_S], z)
    cost = math.exp(within(clearance * max(x[_METAL] - x[_COVER], 0.0), MOST_OPEN))
    error = asked - x[_U] - line(lines[LEAD_S], z) * x[_RATE]
    rate = (x[_R] + line(lines[GAIN], z) * error - x[_V]) / core_s
    if rate > 0.0:
        rate = min(rate, line(lines[UP], z) / cost)
    else:
        rate = max(rate, -line(lines[DOWN], z) * cost)
    demand = x[_V] + core_s * rate
    x[_R] = demand + (x[_R] - demand) * math.exp(-h / line(lines[RESET_S], z))
    before, v = x[_F], x[_V]
    x[_F] = demand + (before - demand) * clock[1]
    held = 0.5 * (before + x[_F])
    x[_V] = held + (v - held) * math.exp(-h / core_s)
    x[_POWER] = (x[_V] - v) / h


@compiled
def _follow(deviation: float, drawn: float, step: float, times: tuple[float, float]) -> float:
    """Deviation behind a lag, drawn to `drawn` while the settled value moves by `step`."""
    h, tau = times
    a = math.exp(-h / tau)
    found: float = a * deviation + (1.0 - a) * (drawn + step * tau / h)
    return found


@compiled
def _opened(
    states: FloatArray,
    x: FloatArray,
    k: int,
    targets: tuple[FloatArray, FloatArray],
    measured: FloatArray,
) -> None:
    """Begin row `k` of `states` with the row before; `x` becomes what it is there."""
    target, per_unit = targets
    past, state = states[k - 1], states[k]
    for o in range(past.shape[1]):
        state[FAST, o] = past[FAST, o]
        if len(measured) > 0 and math.isfinite(measured[k - 1, o]):
            state[FAST, o] = measured[k - 1, o] - past[SOAK, o] - past[CASING, o]
    x[_V] = target[k - 1, 0] - state[FAST, 0] * per_unit[k, 0]
    x[_U] = target[k - 1, 1] - state[FAST, 1] * per_unit[k, 1]
    x[_F] = target[k - 1, 0] - past[REMEMBERED, 0]
    x[_R] = target[k - 1, 0] - past[RESET, 0]
    x[_RATE], x[_POWER] = past[REMEMBERED, 1], 0.0
    x[_METAL] = target[k - 1, 0] - past[METAL, 0]
    x[_COVER] = target[k - 1, 0] - past[METAL, 1]


@compiled
def _remember(x: FloatArray, state: FloatArray, w: float) -> None:
    """Keep in `state` what is only remembered, where the core would settle at `w`."""
    state[REMEMBERED, 0] = within(w - x[_F], MOST_LEFT)
    state[RESET, 0] = within(w - x[_R], MOST_LEFT)
    state[METAL, 0] = within(w - x[_METAL], MOST_LEFT)
    state[METAL, 1] = within(w - x[_COVER], MOST_LEFT)
    state[REMEMBERED, 1] = within(x[_RATE], MOST_RATE)


@compiled
def openness(state: FloatArray) -> float:
    """How far the casing is behind the metal, which opens the clearances."""
    found: float = max(state[METAL, 1] - state[METAL, 0], 0.0)
    return found


@compiled
def _heat(
    p: FloatArray,
    state: FloatArray,
    past: FloatArray,
    o: int,
    at: tuple[float, float, float, float, float],
) -> None:
    """Soak and casing of output `o`; `at`: increment of ss, w, thin, step in s, half range."""
    step, w, thin, dt_s, half = at
    log_tau = p[1] + p[2] * w + p[3] * thin
    left = math.exp(-dt_s / math.exp(bounded(log_tau, LOG_SOAK_TAU)))
    state[SOAK, o] = left * (past[SOAK, o] + p[0] * step)
    left = math.exp(-dt_s / math.exp(bounded(p[5], LOG_BEGUN_TAU)))
    begun = past[CASING, o] - p[4] * half * openness(past)
    state[CASING, o] = left * begun + p[4] * half * openness(state)


@compiled
def _sample(
    drive: tuple[FloatArray, FloatArray, FloatArray, FloatArray],
    engine: tuple[FloatArray, FloatArray, FloatArray],
    states: FloatArray,
    work: tuple[FloatArray, FloatArray, FloatArray],
    k: int,
) -> None:
    """Move the fast deviations in row `k` of `states` on by one sample; `work` is x, z, clock."""
    ss, target, per_unit, air = drive
    lines, slopes, extra = engine
    x, z, clock = work
    count, state, here = int(clock[2]), states[k], air[k]
    fan = state[FAST, 1] * per_unit[k, 1]
    for s in range(count):
        now, was = (s + 1.0) / count, s / count
        w = target[k - 1, 0] + now * (target[k, 0] - target[k - 1, 0])
        w_before = target[k - 1, 0] + was * (target[k, 0] - target[k - 1, 0])
        asked = target[k - 1, 1] + now * (target[k, 1] - target[k - 1, 1])
        v, u = x[_V], x[_U]
        regressors(z, here, v, u)
        _core((lines, extra[CLEARANCE]), z, x, asked, clock)
        _soak(x, z, clock[0])
        v_in, w_in = within(v, MOST_SPEED), within(w, MOST_SPEED)
        core = 0.5 * (w_before - v + w - x[_V])
        c = slope(slopes[0], here, v_in, w_in)
        fan_before = fan
        drawn = c * core - line(lines[PUSH], z) * x[_POWER]
        step = (target[k, 1] - target[k - 1, 1]) / count
        fan = _follow(fan, drawn, step, (clock[0], line(lines[FAN_S], z)))
        x[_U] = asked - fan
        x[_RATE] = (x[_U] - u) / clock[0]
        for o in range(2, ss.shape[1]):
            q = 2 * o + 4
            drawn = slope(slopes[o - 1], here, v_in, w_in) * core
            drawn -= line(lines[q + 1], z) * x[_POWER]
            drawn += extra[SHARES + o - 2] * (fan_before - c * core)
            step = (ss[k, o] - ss[k - 1, o]) / count
            times = (clock[0], line(lines[q], z))
            state[FAST, o] = _follow(state[FAST, o], drawn / per_unit[k, o], step, times)
    state[FAST, 0] = (target[k, 0] - x[_V]) / per_unit[k, 0]
    state[FAST, 1] = fan / per_unit[k, 1]


@compiled
def run_governed(
    drive: tuple[FloatArray, FloatArray, FloatArray, FloatArray],
    engine: tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray],
    starts: tuple[IntArray, FloatArray],
    measured: FloatArray,
    dt_s: float,
) -> FloatArray:
    """States (T, 6, o), see the module; the first three rows add up to the deviation.

    `drive` are ss (T, o), the same corrected and scaled, the scaled value per unit of the output,
    and the air (T, 3): thin, hot, Mach. Columns have the core first, then the fan. `engine` are
    lines (8 + 2 (o - 2), 9), slopes (o - 1, 6), the valve's lag, what clearances cost and the
    shares of the fan's deviation (o,), heat (o, 6) and the limit (o,) of deviations. `starts` and
    `measured` are as of `narxcal.lumped.lag.run_lags`.
    """
    ss, target, per_unit, air = drive
    lines, slopes, extra, heat, limit = engine
    states = np.zeros((len(ss), ROWS, ss.shape[1]))
    count, window = inner_steps(dt_s), 0
    h = dt_s / count
    clock = np.array([h, math.exp(-h / bounded(extra[VALVE], VALVE_S)), float(count)])
    x, z = np.zeros(8), np.empty(len(REGRESSORS))
    for k in range(len(ss)):
        if window < len(starts[0]) and starts[0][window] == k:
            states[k] = starts[1][window]
            window += 1
            continue
        _opened(states, x, k, (target, per_unit), measured)
        _sample((ss, target, per_unit, air), (lines, slopes, extra), states, (x, z, clock), k)
        state, w = states[k], target[k, 0]
        _remember(x, state, w)
        for o in range(ss.shape[1]):
            step, half = ss[k, o] - ss[k - 1, o], 1.0 / per_unit[k, o]
            at = (step, within(w, MOST_SPEED), air[k, 0], dt_s, half)
            _heat(heat[o], state, states[k - 1], o, at)
            slow = state[SOAK, o] + state[CASING, o]
            state[FAST, o] = within(state[FAST, o] + slow, limit[o]) - slow
    return states
