"""Manoeuvres that show what the virtual engine is like: slams, and points of equal thrust."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from narxcal.atmosphere import air_state
from narxcal.turbofan import VirtualEngine
from narxcal.turbofan.maps import SURGE
from narxcal.turbofan.virtual_engine import INPUT_NAMES

FloatArray = NDArray[np.float64]
HZ = 32
CONDITIONS = {
    "ground": {"WOW": 1.0},
    "sea level": {},
    "10 kft": {"ALT_ft": 10000.0, "Mach": 0.4},
    "35 kft": {"ALT_ft": 35000.0, "Mach": 0.8},
}
_UP_S, _DOWN_S, _END_S = 2.0, 42.0, 82.0
_N1, _EGT, _FN = 0, 2, 4


class Slam(NamedTuple):
    """Idle to take-off at once, and back 40 s later; seconds from the lever's move."""

    idle_share: float  # net thrust of idle over that of take-off
    rise_s: float  # to 95 % of take-off thrust
    fall_s: float  # back to idle N1 + 5 %
    overshoot_pct: float  # of N1, over its command
    bloom_C: float  # EGT 15 s after the push, above its settled value
    surge_share: float  # largest HPC angle over that of surge


def log(angle: FloatArray, condition: str) -> dict[str, FloatArray]:
    """Inputs (time,) with the lever at `angle` (time,) in one of the `CONDITIONS`."""
    fixed = CONDITIONS[condition]
    found = {name: np.full(len(angle), fixed.get(name, 0.0)) for name in INPUT_NAMES}
    return found | {"TRA_deg": angle}


def weaving(duration_s: float) -> FloatArray:
    """A lever that never rests, at 32 Hz: (time,)."""
    t = np.arange(int(duration_s * HZ)) / HZ
    return np.asarray(42.5 - 42.5 * np.cos(0.25 * t) * np.cos(0.031 * t))


def at(engine: VirtualEngine, **inputs: float) -> FloatArray:
    """Settled outputs (7,) at take-off lever, sea level static, but for `inputs`."""
    return engine.outputs(np.array([inputs.get(n, 85.0 * (n == "TRA_deg")) for n in INPUT_NAMES]))


def slam(engine: VirtualEngine, condition: str) -> Slam:
    """Fly the slam in one of the `CONDITIONS`."""
    t = np.arange(int(_END_S * HZ)) / HZ
    angle = np.where((t >= _UP_S) & (t < _DOWN_S), 85.0, 0.0)
    run = engine.simulate(log(angle, condition), 1.0 / HZ)
    idle, top = (at(engine, TRA_deg=a, **CONDITIONS[condition]) for a in (0.0, 85.0))
    pushed = (t >= _UP_S) & (t < _DOWN_S)
    return Slam(
        idle_share=idle[_FN] / top[_FN],
        rise_s=float(t[np.argmax(pushed & (run["FN_kN"] >= 0.95 * top[_FN]))]) - _UP_S,
        fall_s=float(t[np.argmax((t >= _DOWN_S) & (run["N1_pct"] <= idle[_N1] + 5.0))]) - _DOWN_S,
        overshoot_pct=float(run["N1_pct"][pushed].max()) - top[_N1],
        bloom_C=float(np.interp(_UP_S + 15.0, t, run["EGT_C"])) - top[_EGT],
        surge_share=float(run["hpc_angle"].max()) / SURGE,
    )


def at_thrust(
    engine: VirtualEngine, place: tuple[float, float], shares: tuple[float, ...]
) -> FloatArray:
    """Inputs (n, 9) that give these shares of full thrust at `place` (altitude in ft, Mach).

    The ground idle reaches furthest down; a share that the lever cannot reach is taken at idle.
    """
    u = np.zeros((300, 9))
    u[:, 0], u[:, 1], u[:, 2], u[:, 4] = np.linspace(0.0, 85.0, len(u)), *place, 1.0
    thrust = engine.outputs(u)[:, _FN]
    found = u[: len(shares)].copy()
    found[:, 0] = np.interp(np.array(shares) * thrust[-1], thrust, u[:, 0])
    return found


def likeness(engine: VirtualEngine, altitude_ft: float) -> float:
    """Slow lag at altitude over that at sea level, both static, over `sqrt(theta) / delta`.

    At equal corrected N1 the law of NACA TR-1011 makes this one.
    """
    air = air_state(altitude_ft)
    up = np.zeros((1, 9))
    up[0, :2] = 40.0, altitude_ft
    wanted = float(engine.outputs(up)[0, _N1] / np.sqrt(air.theta2))
    u = np.zeros((300, 9))
    u[:, 0] = np.linspace(0.0, 85.0, len(u))
    low = u[:1].copy()
    low[0, 0] = np.interp(wanted, engine.outputs(u)[:, _N1], u[:, 0])
    ratio = engine.linearised(up)[0].lags_s[0] / engine.linearised(low)[0].lags_s[0]
    return float(ratio * air.delta2 / np.sqrt(air.theta2))
