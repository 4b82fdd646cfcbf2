"""The lumped engine whose control governs N1 (`LINES`, `OTHER_LINES`, `SLOPES`, `HEAT`, `EXTRA`).

N2 does not relax to its equilibrium by itself: fuel accelerates the slow fan until N1 meets its
demand, and N2 overshoots meanwhile. Symbols are those of `narxcal.lumped.states`, and

| symbol | meaning | unit |
|---|---|---|
| f, r | fuel and governor's reset, as the core speed that they sustain | - |
| e | opening of the clearances (`narxcal.lumped.heat`) | - |

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
"""

from __future__ import annotations

import math
from typing import NamedTuple

from narxcal.lumped.heat import opening, soaked, warmed
from narxcal.lumped.states import (
    CASING,
    COVER,
    FAN_RATE,
    FAST,
    FUEL,
    METAL,
    RESET,
    SOAK,
    Drive,
    Engine,
    bounded,
    finish,
    follow,
    quadratic,
)
from narxcal.support.arrays import FloatArray
from narxcal.support.compiled import compiled
from narxcal.support.dual import clip, get, put

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
_LOG, _CARRIED, _RATE = 5.0, 5.0, 20.0  # bounds of logarithms, of what is carried between samples
_LEAST_CHORD = 0.05  # of the fan: with the core it always rises


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
    (w, s, c), (clearance, valve, h), (v, u) = targets, fixed, (bounded(x.core), bounded(x.fan))
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
def places(count: int) -> tuple[int, int, int]:
    """Where `SLOPES`, `HEAT` and `EXTRA` begin in the parameters of `count` outputs."""
    slopes = _TERMS * (len(LINES) + len(OTHER_LINES) * (count - 2))
    heat = slopes + len(SLOPES) * (count - 1)
    return slopes, heat, heat + len(HEAT) * count


@compiled(exact=False)
def governed(engine: Engine, drive: Drive, x: FloatArray, k: int, dt_s: float) -> None:
    """Advance all outputs to row k of a governed engine, in equal inner steps."""
    p, outputs, target, unit, air = (
        engine.theta, engine.outputs, drive.target, drive.per_unit[k], drive.air[k]
    )  # fmt: skip
    core, fan, count = outputs[0], outputs[1], inner_steps(dt_s)
    slopes, _, extra = places(len(engine.rank))
    h, start, end = dt_s / count, target[k - 1], target[k]
    fixed = (get(p, extra + 1), clip(get(p, extra), 0.01, 1.0), h)
    r = _opened(x, drive, k, (core, fan))
    for i in range(count):
        w_was = start[core] + i / count * (end[core] - start[core])
        w = start[core] + (i + 1.0) / count * (end[core] - start[core])
        s_was = start[fan] + i / count * (end[fan] - start[fan])
        s = start[fan] + (i + 1.0) / count * (end[fan] - start[fan])
        v, u, settled, was = bounded(r.core), bounded(r.fan), bounded(w), r
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
    slopes, _, extra = places(len(engine.rank))
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
    w, thin = bounded(drive.target[k, core]), drive.air[k, 0]
    is_open = opening(get(x, (COVER, core)), get(x, (METAL, core)))  # deviations: signs turn
    for j in range(len(engine.outputs)):
        o = engine.outputs[j]
        heat = places(len(engine.rank))[1] + len(HEAT) * engine.rank[o]
        step = drive.ss[k, o] - drive.ss[k - 1, o]
        log_tau = get(p, heat + 1) + get(p, heat + 2) * w + get(p, heat + 3) * thin
        soak = soaked(get(x, (SOAK, o)), get(p, heat) * step, clip(log_tau, -0.5, 4.5), h)
        share = get(p, heat + 4) / drive.per_unit[k, o]
        left = soaked(get(x, (CASING, o)), -share * was_open, clip(get(p, heat + 5), 2.0, 5.0), h)
        finish(x, o, soak, left + share * is_open, engine.limit[o])


@compiled(exact=False)
def inner_steps(dt_s: float) -> int:
    return max(1, math.ceil(dt_s / _STEP_S - 1e-9))
