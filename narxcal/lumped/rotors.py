"""Equations of the lumped two-spool engine, and its free run.

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
| f, r | fuel and governor's reset, as the core speed that they sustain | - |
| e | opening of the clearances (`narxcal.lumped.heat`) | - |

Times, gains and limits are exponentials of polynomials in speeds and air (NACA TR-1011: dynamic
coefficients are corrected for altitude like steady-state data). An engine has one of two forms;
`theta` has its parameters in the order of the names below.

**Limited** (`LIMITED` per output). Each spool returns to its equilibrium by itself, no faster than
the rates r of acceleration and of deceleration that the control's schedules allow:

    tau  = tau0 sqrt(1 + (x / r)^2),   x = (w - v) / tau0
    ln tau0 = p . z(v, w),   ln r = q . z(v, u),   u the other spool
    pull = -lead D / h - heat tau (change of soak) / h
           + (core + core_speed (v + w)) d_c + rate exp(rate_air thin + rate_speed v) dN2/dt
    d    = fast + soak + casing

The schedules limit fuel over pressure, to which both spools contribute; without limits ln r = 20.
The second line couples fan and temperatures to the core: equilibria lie on a parabola over its
speed, and its acceleration takes fuel. `lead` is the lag of the meter from which ss is computed.
Soak is multiplied by s(k) / s(k-1) and its share by s(k), s = exp(heat_speed w).

**Governed** (`LINES`, `OTHER_LINES`, `SLOPES`, `HEAT`, `EXTRA`). A control governs N1, and N2 does
not relax to its equilibrium by itself: fuel accelerates the slow fan until N1 meets its demand, and
N2 overshoots meanwhile.

    f_d   = r + gain (s - u - lead du/dt)       demand, limited so that
            -down exp(clearance e) <= (f_d - v) / core <= up exp(-clearance e)
    df/dt = (f_d - f) / valve,   dv/dt = (f - v) / core,   dr/dt = (f_d - r) / reset
    du/dt = (s - u - c_f (w - v) + push dv/dt) / fan
    pull  = c d_c - push dv/dt + share (d_f - c_f d_c)       of other outputs, tau = probe
    lead  = valve + lead_s,      reset = fan core / (fan + core) + reset_s
    ln (core, gain, reset_s, lead_s, ...) = q . [z(v, u), Mach],   c_f >= 0.05

The reset follows the limited demand, so that it does not wind up. The chord c of an output is the
mean slope of its equilibria over the core's speed between v and w. Core and other outputs also have
heat: soak, and casing, which is share e plus what a run began with. Sources: governor and schedules
in Jaw and Mattingly, *Aircraft Engine Controls*, ch. 5 and 6; external reset in Shinskey, *Process
Control Systems*; state-dependent parameters in Young, McKenna and Bruun, Int. J. Control 74 (2001).

**Every equilibrium is stable, whatever the parameters.** There each coefficient multiplies a
deviation that is zero, so the linearised loop has the coefficients of that place, and

    L(p) = gain (1 + reset p) (1 + lead p) (c_f + push p)
           / (reset p (1 + fan p) (1 + core p) (1 + valve p))

Its phase at p = j omega is -90 deg + [atan(reset omega) - atan(fan omega) - atan(core omega)]
+ [atan(lead omega) - atan(valve omega)] + atan(push omega / c_f). The second bracket is not
negative since lead >= valve, the first is above -90 deg since reset >= fan core / (fan + core)
(addition theorem of the tangent), the last term is not negative. So the phase stays within
+-180 deg, L never meets the negative real axis, and by Nyquist's criterion the loop is stable at
every gain. A step is backward Euler's, which maps a pole p to 1 / (1 - h p): inside the unit circle
for any h. Other outputs and heat follow the loop and are lags of their own.

All functions are for floats and for dual numbers (`narxcal.support.dual`).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from narxcal import atmosphere
from narxcal.lumped.heat import opening, soaked, warmed
from narxcal.support.arrays import FloatArray, IntArray
from narxcal.support.compiled import compiled
from narxcal.support.dual import clip, get, put

# Rows of the states. The first three add up to the deviation; the others are the core's under a
# governor: fuel, reset, metal and casing as deviations from w, and du/dt.
FAST, SOAK, CASING, FUEL, RESET, METAL, COVER, FAN_RATE, ROWS = range(9)

LIMITED = (
    "log_tau", "air", "speed", "target", "speed_speed", "speed_target", "target_target",
    "lead_s", "core", "slow_share", "log_slow_tau",
    "log_up", "up_air", "up_speed", "up_speed_speed",
    "up_other", "up_speed_other", "up_other_other", "up_hot",
    "log_down", "down_air", "down_speed", "down_speed_speed",
    "down_other", "down_speed_other", "down_other_other", "down_hot",
    "core_speed", "rate", "rate_air", "rate_speed", "casing_share", "log_casing_tau", "hot",
    "heat", "heat_speed", "heat_rate", "heat_air",
)  # fmt: skip
UNLIMITED = 20.0  # ln r of a spool without limits
_SIZE = len(LIMITED)
_LEAD, _CORE, _SOAK, _PULL, _CASING, _HEAT = (
    LIMITED.index(name)
    for name in ("lead_s", "core", "slow_share", "core_speed", "casing_share", "heat")
)
_TAU_OF_Z = (
    "log_tau", "air", "hot", "speed", "target", "speed_speed", "speed_target", "target_target",
)  # fmt: skip
_RATE_OF_Z = (
    "log_{}", "{}_air", "{}_hot", "{}_speed", "{}_other",
    "{}_speed_speed", "{}_speed_other", "{}_other_other",
)  # fmt: skip
# Where the coefficients of z are.
_TAU = tuple(LIMITED.index(name) for name in _TAU_OF_Z)
_UP, _DOWN = (
    tuple(LIMITED.index(name.format(way)) for name in _RATE_OF_Z) for way in ("up", "down")
)

REGRESSORS = ("one", "thin", "hot", "Mach", "v", "u", "vv", "vu", "uu")
LINES = ("core_s", "gain", "reset_s", "lead_s", "up", "down", "fan_s", "push")
OTHER_LINES = ("probe_s", "push")  # of each other output, behind those of core and fan
SLOPES = ("const", "thin", "Mach", "tilt", "tilt_Mach", "bend")  # of fan and others
HEAT = ("soak_share", "log_soak_tau", "soak_speed", "soak_air", "open_share", "log_begun_tau")
EXTRA = ("valve_s", "clearance")  # shares of the fan's deviation behind them, one per other output
_TERMS = len(REGRESSORS)
_CORE_S, _GAIN, _RESET_S, _LEAD_S, _UP_RATE, _DOWN_RATE, _FAN_S, _PUSH = (
    _TERMS * k for k in range(len(LINES))
)
_MACH = REGRESSORS.index("Mach")
_LINE = tuple(k for k in range(_TERMS) if k != _MACH)
_STEP_S = 0.04  # longest inner step under a governor

# Bounds of scaled speeds, of logarithms, of what is carried from sample to sample.
_SPEED, _LOG, _CARRIED, _RATE = 1.5, 5.0, 5.0, 20.0
_LEAST_CHORD = 0.05  # of the fan: with the core it always rises


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


class Spools(NamedTuple):
    """State of core, fan and control: v, u, f, r, du/dt, m, n."""

    core: float
    fan: float
    fuel: float
    reset: float
    fan_rate: float
    metal: float
    casing: float


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
def _bounded(speed: float) -> float:
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
def _finish(x: FloatArray, o: int, soak: float, casing: float, most: float) -> None:
    """Store the slow parts, and the fast one so that the sum stays within +-`most`."""
    slow = soak + casing
    put(x, (FAST, o), clip(get(x, (FAST, o)) + slow, -most, most) - slow)
    put(x, (SOAK, o), soak)
    put(x, (CASING, o), casing)


# ---- limited


@compiled(exact=False)
def _speed(x: FloatArray, drive: Drive, k: int, o: int) -> float:
    """Scaled speed at the end of sample k - 1."""
    v = drive.target[k - 1, o] - get(x, (FAST, o)) * drive.per_unit[k, o]
    return _bounded(v)


@compiled(exact=False)
def free_tau(p: FloatArray, o: int, air: FloatArray, v: float, w: float) -> float:
    """Time constant tau0 [s] of an output without limits."""
    return math.exp(clip(quadratic(p, (_SIZE * o, _TAU), air, v, w), -2.5, 3.0))


@compiled(exact=False)
def limited_tau(
    p: FloatArray, o: int, air: FloatArray, speeds: tuple[float, float, float]
) -> float:
    """Time constant tau [s] of a spool at v that approaches w, so that |dv/dt| < r.

    `speeds` are v, w and the other spool's u.
    """
    v, w, u = speeds
    tau0 = free_tau(p, o, air, v, w)
    columns = _UP if w > v else _DOWN
    r = math.exp(clip(quadratic(p, (_SIZE * o, columns), air, v, u), -5.0, UNLIMITED))
    x = (w - v) / (tau0 * r)
    return tau0 * math.sqrt(1.0 + x * x)


@compiled(exact=False)
def _core_pull(
    p: FloatArray, at: int, thin: float, core: tuple[float, float, float, float]
) -> float:
    """Pull of the core on another output; `core` are its deviation, dN/dt, v and w."""
    d, rate, v, w = core
    strength = math.exp(clip(get(p, at + _PULL + 2) * thin + get(p, at + _PULL + 3) * v, -3.0, 3.0))
    coupling = get(p, at + _CORE) + get(p, at + _PULL) * (v + w)
    return coupling * d + get(p, at + _PULL + 1) * strength * rate


@compiled(exact=False)
def _advance_limited(
    engine: Engine,
    drive: Drive,
    x: FloatArray,
    where: tuple[int, int],
    motion: tuple[float, float, float],
) -> None:
    """Advance column o to row k; `motion` are tau, the core's pull and h."""
    (k, o), (tau, pull, h), p = where, motion, engine.theta
    own, at = engine.own[o], _SIZE * o
    step, thin = drive.ss[k, o] - drive.ss[k - 1, o], drive.air[k, 0]
    was = _bounded(drive.target[k - 1, own])
    w = _bounded(drive.target[k, own])
    log_tau = get(p, at + _SOAK + 1) - get(p, at + _HEAT + 2) * w + get(p, at + _HEAT + 3) * thin
    left = math.exp(get(p, at + _HEAT + 1) * (w - was)) * get(x, (SOAK, o))
    taken = math.exp(get(p, at + _HEAT + 1) * w) * get(p, at + _SOAK) * step
    soak = soaked(left, taken, clip(log_tau, 0.0, 4.0), h)
    log_tau = clip(get(p, at + _CASING + 1), 2.0, 5.0)
    casing = soaked(get(x, (CASING, o)), get(p, at + _CASING) * step, log_tau, h)
    released = get(p, at + _HEAT) * tau * (soak - get(x, (SOAK, o)))
    pull = pull - (get(p, at + _LEAD) * step + released) / h
    put(x, (FAST, o), follow(get(x, (FAST, o)), pull, step, (tau, h)))
    _finish(x, o, soak, casing, engine.limit[o])


@compiled(exact=False)
def _limited(engine: Engine, drive: Drive, x: FloatArray, k: int, h: float) -> None:
    """Advance all outputs to row k of a limited engine."""
    p, outputs, own, air = engine.theta, engine.outputs, engine.own, drive.air[k]
    core = outputs[0]
    fan = outputs[1] if len(outputs) > 1 and own[outputs[1]] == outputs[1] else core
    v, u = _speed(x, drive, k, core), _speed(x, drive, k, fan)
    w = _bounded(drive.target[k, core])
    before = deviation(x, core)
    tau = limited_tau(p, core, air, (v, w, u))
    _advance_limited(engine, drive, x, (k, core), (tau, 0.0, h))
    d = deviation(x, core)
    rate = (drive.ss[k, core] - drive.ss[k - 1, core] - d + before) / h
    for j in range(1, len(outputs)):
        o = outputs[j]
        if own[o] == o:
            settled = _bounded(drive.target[k, o])
            tau = limited_tau(p, o, air, (_speed(x, drive, k, o), settled, v))
        else:
            tau = free_tau(p, o, air, v, w)
        pull = _core_pull(p, _SIZE * o, air[0], (d, rate, v, w))
        _advance_limited(engine, drive, x, (k, o), (tau, pull, h))


# ---- governed


@compiled(exact=False)
def line(p: FloatArray, at: int, air: FloatArray, v: float, u: float) -> float:
    """A time, gain or limit exp(q . [z(v, u), Mach]); beyond e^5 it is bounded."""
    log = quadratic(p, (at, _LINE), air, v, u) + get(p, at + _MACH) * air[2]
    return math.exp(clip(log, -_LOG, _LOG))


@compiled(exact=False)
def chord(p: FloatArray, at: int, air: FloatArray, v: float, w: float) -> float:
    """Mean slope of an output over the core's speed between v and w."""
    flat: float = get(p, at) + get(p, at + 1) * air[0] + get(p, at + 2) * air[2]
    tilt: float = get(p, at + 3) + get(p, at + 4) * air[2]
    return flat + tilt * (v + w) + get(p, at + 5) * (v * v + v * w + w * w)


@compiled(exact=False)
def _limits(
    p: FloatArray, air: FloatArray, x: Spools, speeds: tuple[float, float], clearance: float
) -> tuple[float, float]:
    """Rates of deceleration and acceleration that the schedules allow; `speeds` bounded v, u."""
    v, u = speeds
    cost = math.exp(clip(clearance * opening(x.metal, x.casing), -1.0, 1.0))
    return line(p, _DOWN_RATE, air, v, u) * cost, line(p, _UP_RATE, air, v, u) / cost


@compiled(exact=False)
def _spools(
    p: FloatArray,
    air: FloatArray,
    x: Spools,
    targets: tuple[float, float, float],
    fixed: tuple[float, float, float],
) -> Spools:
    """Advance control, valve, spools and metal by backward Euler.

    `targets` are w, s and the chord of the fan at the end of the step, `fixed` clearance, valve, h.
    With a = dv/dt, v' = v + h a, f' = v' + core a, f_d = f' + valve (f' - f) / h and u' = u_0 +
    u_1 a are linear in a, and so is the governor's equation. It gives a, which is then limited.
    """
    (w, s, c), (clearance, valve, h), (v, u) = targets, fixed, (_bounded(x.core), _bounded(x.fan))
    core, fan = line(p, _CORE_S, air, v, u), line(p, _FAN_S, air, v, u)
    gain, lead = line(p, _GAIN, air, v, u), valve + line(p, _LEAD_S, air, v, u)
    reset = h / (fan * core / (fan + core) + line(p, _RESET_S, air, v, u))
    k = h / fan
    u_0 = (x.fan + k * (s - c * (w - x.core))) / (1.0 + k)
    u_1 = k * (c * h + line(p, _PUSH, air, v, u)) / (1.0 + k)
    # (f_d - v') / core = m a + q
    m, q = 1.0 + valve * (h + core) / (h * core), valve * (x.core - x.fuel) / (h * core)
    error = s - u_0 - lead * (u_0 - x.fan) / h
    gained = gain * (1.0 + reset)
    a = (gained * error - x.core - core * q + x.reset) / (
        h + core * m + gained * u_1 * (1.0 + lead / h)
    )
    down, up = _limits(p, air, x, (v, u), clearance)
    if a > (up - q) / m:
        a = (up - q) / m
    elif a < (-down - q) / m:
        a = (-down - q) / m
    after = x.core + h * a
    fuel, demand = after + core * a, after + core * (m * a + q)
    metal, casing = warmed(x.metal, x.casing, fuel, (v, air[0], h))
    turned = u_0 + u_1 * a
    kept = (x.reset + reset * demand) / (1.0 + reset)
    return Spools(after, turned, fuel, kept, (turned - x.fan) / h, metal, casing)


@compiled(exact=False)
def _opened(x: FloatArray, drive: Drive, k: int, columns: tuple[int, int]) -> Spools:
    """State of the spools at the end of sample k - 1; `columns` are core and fan."""
    core, fan = columns
    w, s, unit = drive.target[k - 1, core], drive.target[k - 1, fan], drive.per_unit[k]
    return Spools(
        w - get(x, (FAST, core)) * unit[core],
        s - get(x, (FAST, fan)) * unit[fan],
        w - get(x, (FUEL, core)),
        w - get(x, (RESET, core)),
        get(x, (FAN_RATE, core)),
        w - get(x, (METAL, core)),
        w - get(x, (COVER, core)),
    )


@compiled(exact=False)
def _closed(x: FloatArray, r: Spools, core: int, w: float) -> None:
    """Store what only the next sample needs."""
    put(x, (FUEL, core), clip(w - r.fuel, -_CARRIED, _CARRIED))
    put(x, (RESET, core), clip(w - r.reset, -_CARRIED, _CARRIED))
    put(x, (METAL, core), clip(w - r.metal, -_CARRIED, _CARRIED))
    put(x, (COVER, core), clip(w - r.casing, -_CARRIED, _CARRIED))
    put(x, (FAN_RATE, core), clip(r.fan_rate, -_RATE, _RATE))


@compiled(exact=False)
def _places(count: int) -> tuple[int, int, int]:
    """Where `SLOPES`, `HEAT` and `EXTRA` begin in the parameters of `count` outputs."""
    slopes = _TERMS * (len(LINES) + len(OTHER_LINES) * (count - 2))
    heat = slopes + len(SLOPES) * (count - 1)
    return slopes, heat, heat + len(HEAT) * count


@compiled(exact=False)
def _governed(engine: Engine, drive: Drive, x: FloatArray, k: int, dt_s: float) -> None:
    """Advance all outputs to row k of a governed engine, in equal inner steps."""
    p, outputs, target, unit, air = (
        engine.theta, engine.outputs, drive.target, drive.per_unit[k], drive.air[k]
    )  # fmt: skip
    core, fan, count = outputs[0], outputs[1], inner_steps(dt_s)
    slopes, _, extra = _places(len(engine.rank))
    h, start, end = dt_s / count, target[k - 1], target[k]
    fixed = (get(p, extra + 1), clip(get(p, extra), 0.01, 1.0), h)
    r = _opened(x, drive, k, (core, fan))
    for i in range(count):
        w_was = start[core] + i / count * (end[core] - start[core])
        w = start[core] + (i + 1.0) / count * (end[core] - start[core])
        s_was = start[fan] + i / count * (end[fan] - start[fan])
        s = start[fan] + (i + 1.0) / count * (end[fan] - start[fan])
        v, u, settled, was = _bounded(r.core), _bounded(r.fan), _bounded(w), r
        c = clip(chord(p, slopes, air, v, settled), _LEAST_CHORD, math.inf)
        r = _spools(p, air, r, (w, s, c), fixed)
        power, d_core = (r.core - was.core) / h, 0.5 * (w_was - was.core + w - r.core)
        beside = s_was - was.fan - c * d_core
        core_now = (v, u, settled, d_core, power, beside)
        for j in range(2, len(outputs)):
            step = (drive.ss[k, outputs[j]] - drive.ss[k - 1, outputs[j]]) / count
            _governed_output(engine, drive, x, (k, outputs[j]), (core_now, step, h))
    put(x, (FAST, core), (end[core] - r.core) / unit[core])
    put(x, (FAST, fan), (end[fan] - r.fan) / unit[fan])
    was_open = opening(get(x, (COVER, core)), get(x, (METAL, core)))
    _closed(x, r, core, end[core])
    _governed_heat(engine, drive, x, k, (dt_s, was_open))


@compiled(exact=False)
def _governed_output(
    engine: Engine,
    drive: Drive,
    x: FloatArray,
    where: tuple[int, int],
    motion: tuple[tuple[float, float, float, float, float, float], float, float],
) -> None:
    """Advance a column behind core and fan over an inner step; `where` are row and column.

    `motion` are v, u, w, d_c, dv/dt and d_f - c_f d_c; the step of ss; and h.
    """
    (k, o), ((v, u, w, d_core, power, beside), step, h), p = where, motion, engine.theta
    slopes, _, extra = _places(len(engine.rank))
    rank, air = engine.rank[o], drive.air[k]
    at = _TERMS * (len(LINES) + len(OTHER_LINES) * (rank - 2))
    c = chord(p, slopes + len(SLOPES) * (rank - 1), air, v, w)
    pull = c * d_core - line(p, at + _TERMS, air, v, u) * power
    pull = (pull + get(p, extra + rank) * beside) / drive.per_unit[k, o]
    times = (line(p, at, air, v, u), h)
    put(x, (FAST, o), follow(get(x, (FAST, o)), pull, step, times))


@compiled(exact=False)
def _governed_heat(
    engine: Engine, drive: Drive, x: FloatArray, k: int, at: tuple[float, float]
) -> None:
    """Advance soak and casing of all outputs; `at` are h and how far clearances were open."""
    (h, was_open), p, core = at, engine.theta, engine.outputs[0]
    w, thin = _bounded(drive.target[k, core]), drive.air[k, 0]
    is_open = opening(get(x, (COVER, core)), get(x, (METAL, core)))  # deviations: signs turn
    for j in range(len(engine.outputs)):
        o = engine.outputs[j]
        heat = _places(len(engine.rank))[1] + len(HEAT) * engine.rank[o]
        step = drive.ss[k, o] - drive.ss[k - 1, o]
        log_tau = get(p, heat + 1) + get(p, heat + 2) * w + get(p, heat + 3) * thin
        soak = soaked(get(x, (SOAK, o)), get(p, heat) * step, clip(log_tau, -0.5, 4.5), h)
        share = get(p, heat + 4) / drive.per_unit[k, o]
        left = soaked(get(x, (CASING, o)), -share * was_open, clip(get(p, heat + 5), 2.0, 5.0), h)
        _finish(x, o, soak, left + share * is_open, engine.limit[o])


@compiled(exact=False)
def inner_steps(dt_s: float) -> int:
    return max(1, math.ceil(dt_s / _STEP_S - 1e-9))


# ---- both


@compiled(exact=False)
def run(
    engine: Engine,
    drive: Drive,
    starts: tuple[IntArray, FloatArray],
    measured: FloatArray,
    dt_s: float,
) -> tuple[FloatArray, FloatArray]:
    """Deviations (T, o) and the states (`ROWS`, o) at the end; of dual numbers with slopes behind.

    `starts` are positions (n,) at which a window begins, and the states there (n, `ROWS`, o).
    `measured` (T, o), if it has rows, replaces the deviation before each step where it is finite
    (one-step prediction). Columns that are not in `engine.outputs` stay zero.
    """
    count = drive.ss.shape[1]
    found = np.zeros(drive.ss.shape + engine.theta.shape[1:])
    x = np.zeros((ROWS, count) + engine.theta.shape[1:])  # noqa: RUF005 (numba unpacks no tuples)
    window = 0
    for k in range(len(found)):
        if window < len(starts[0]) and starts[0][window] == k:
            for row in range(ROWS):
                for o in range(count):
                    put(x, (row, o), starts[1][window, row, o])
            window += 1
        else:
            for o in range(count if len(measured) > 0 else 0):
                if math.isfinite(measured[k - 1, o]):
                    slow = get(x, (SOAK, o)) + get(x, (CASING, o))
                    put(x, (FAST, o), measured[k - 1, o] - slow)
            if engine.governed:
                _governed(engine, drive, x, k, dt_s)
            else:
                _limited(engine, drive, x, k, dt_s)
        for j in range(len(engine.outputs)):
            o = engine.outputs[j]
            put(found, (k, o), deviation(x, o))
    return found, x
