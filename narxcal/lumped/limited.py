"""The lumped engine without a governor: each spool returns to its equilibrium by itself.

It is no faster than the rates r of acceleration and of deceleration that the control's schedules
allow (symbols of `narxcal.lumped.states`; `LIMITED` per output):

    tau  = tau0 sqrt(1 + (x / r)^2),   x = (w - v) / tau0
    ln tau0 = p . z(v, w),   ln r = q . z(v, u),   u the other spool
    pull = -lead D / h - heat tau (change of soak) / h
           + (core + core_speed (v + w)) d_c + rate exp(rate_air thin + rate_speed v) dN2/dt
    d    = fast + soak + casing

The schedules limit fuel over pressure, to which both spools contribute; without limits ln r = 20.
The second line couples fan and temperatures to the core: equilibria lie on a parabola over its
speed, and its acceleration takes fuel. `lead` is the lag of the meter from which ss is computed.
Soak is multiplied by s(k) / s(k-1) and its share by s(k), s = exp(heat_speed w).
"""

from __future__ import annotations

import math

from narxcal.lumped.heat import soaked
from narxcal.lumped.states import (
    CASING,
    FAST,
    SOAK,
    Drive,
    Engine,
    bounded,
    deviation,
    finish,
    follow,
    quadratic,
)
from narxcal.support.arrays import FloatArray
from narxcal.support.compiled import compiled
from narxcal.support.dual import clip, get, put

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


@compiled(exact=False)
def _speed(x: FloatArray, drive: Drive, k: int, o: int) -> float:
    """Scaled speed at the end of sample k - 1."""
    v = drive.target[k - 1, o] - get(x, (FAST, o)) * drive.per_unit[k, o]
    return bounded(v)


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
    was = bounded(drive.target[k - 1, own])
    w = bounded(drive.target[k, own])
    log_tau = get(p, at + _SOAK + 1) - get(p, at + _HEAT + 2) * w + get(p, at + _HEAT + 3) * thin
    left = math.exp(get(p, at + _HEAT + 1) * (w - was)) * get(x, (SOAK, o))
    taken = math.exp(get(p, at + _HEAT + 1) * w) * get(p, at + _SOAK) * step
    soak = soaked(left, taken, clip(log_tau, 0.0, 4.0), h)
    log_tau = clip(get(p, at + _CASING + 1), 2.0, 5.0)
    casing = soaked(get(x, (CASING, o)), get(p, at + _CASING) * step, log_tau, h)
    released = get(p, at + _HEAT) * tau * (soak - get(x, (SOAK, o)))
    pull = pull - (get(p, at + _LEAD) * step + released) / h
    put(x, (FAST, o), follow(get(x, (FAST, o)), pull, step, (tau, h)))
    finish(x, o, soak, casing, engine.limit[o])


@compiled(exact=False)
def limited(engine: Engine, drive: Drive, x: FloatArray, k: int, h: float) -> None:
    """Advance all outputs to row k of a limited engine."""
    p, outputs, own, air = engine.theta, engine.outputs, engine.own, drive.air[k]
    core = outputs[0]
    fan = outputs[1] if len(outputs) > 1 and own[outputs[1]] == outputs[1] else core
    v, u = _speed(x, drive, k, core), _speed(x, drive, k, fan)
    w = bounded(drive.target[k, core])
    before = deviation(x, core)
    tau = limited_tau(p, core, air, (v, w, u))
    _advance_limited(engine, drive, x, (k, core), (tau, 0.0, h))
    d = deviation(x, core)
    rate = (drive.ss[k, core] - drive.ss[k - 1, core] - d + before) / h
    for j in range(1, len(outputs)):
        o = outputs[j]
        if own[o] == o:
            settled = bounded(drive.target[k, o])
            tau = limited_tau(p, o, air, (_speed(x, drive, k, o), settled, v))
        else:
            tau = free_tau(p, o, air, v, w)
        pull = _core_pull(p, _SIZE * o, air[0], (d, rate, v, w))
        _advance_limited(engine, drive, x, (k, o), (tau, pull, h))
