"""The lumped engine in time: two rotors, metal, probe, fuel, and a control of one of two kinds.

Everything in the equations is corrected to sea level, `c = n / sqrt(theta)` for speeds and
`phi = Wf / (delta sqrt(theta))` for fuel, relative to full power. Rotor 2 answers to the fuel
beyond what it needs, rotor 1 to the gas that rotor 2 sends it:

    J2 dn2/dt = delta (phi - need(c2)),   J1 dn1/dt = delta (gas(c2) (phi / need)^0.35 - c1^2)

The exhaust temperature follows from fuel over air, gives heat to metal, and is read behind a probe.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from narxcal.support.arrays import FloatArray
from narxcal.support.compiled import compiled

N1_RATE, N2_FUEL, FUEL = 0, 1, 2  # what the lever asks for, and what limits an acceleration
STEP_S = 0.008
N1, N2, METAL, PROBE, SERVO, METERED, BURNED, INTEGRAL, RATE, BEFORE = range(10)
_STATES = 10
_SETTLE_S = 150.0
THETA, DELTA, BLEED, LOAD = range(4)


class Physics(NamedTuple):
    """Constants of one lumped engine; factors are 1, exponents and lags 0 as designed."""

    control: int
    inertia1: float = 0.7
    inertia2: float = 2.3
    need: float = 1.0  # fuel that rotor 2 needs, over the design's
    airflow: float = 1.0
    gas: float = 1.0  # what reaches rotor 1
    heat: float = 1.0  # temperature rise per fuel over air
    soak: float = 0.06
    metal_tau_s: float = 40.0
    probe_tau_s: float = 0.9
    valve_tau_s: float = 0.08
    servo_tau_s: float = 0.0
    slew_ps: float = 1e9
    burn_tau_s: float = 0.04
    asymmetry: float = 1.0
    thin_air: float = 0.0
    acceleration: float = 1.0


@compiled
def fuel_needed(c2: float) -> float:
    """Corrected fuel flow at which rotor 2 neither gains nor loses, without bleed or wear."""
    return 0.06 + 0.94 * math.pow(max(c2, 0.2), 4.5)


@compiled
def speed_followed(c2: float) -> float:
    """Corrected speed of rotor 1 that belongs to one of rotor 2."""
    x = c2 - 1.0
    return max(1.0 + 2.1 * x + 0.56 * x * x, 0.12)


@compiled
def _toward(value: float, target: float, tau_s: float, dt_s: float) -> float:
    return target if tau_s <= 0.0 else target + (value - target) * math.exp(-dt_s / tau_s)


@compiled
def _demand(p: Physics, state: FloatArray, command: float, root: float, dt_s: float) -> float:
    """Corrected fuel that the control asks for; `root` is that of theta."""
    c1, c2 = state[N1] / root, state[N2] / root
    floor = 0.62 * fuel_needed(c2) + 0.01
    ceiling = 1.08
    if p.control == FUEL:
        return command
    if p.control == N1_RATE:
        steep = 2.1 + 1.12 * (c2 - 1.0)
        most = p.acceleration * (0.045 + 0.16 * max(c2 - 0.55, 0.0))
        wanted = min(max(2.2 * (command - c1) / steep, -0.16), most)
        off = wanted - state[RATE]
        fuel = state[INTEGRAL] + 2.0 * off
        if floor < fuel < ceiling or (fuel - floor) * off > 0.0 > (fuel - ceiling) * off:
            state[INTEGRAL] += 9.0 * off * dt_s
    else:
        ceiling = min(fuel_needed(c2) + p.acceleration * (0.09 + 0.42 * max(c2 - 0.55, 0.0)), 1.1)
        off = command - c2
        fuel = fuel_needed(command) + state[INTEGRAL] + 3.0 * off
        if floor < fuel < ceiling:
            state[INTEGRAL] += 1.6 * off * dt_s
    return float(min(max(fuel, floor), ceiling))


@compiled
def _fuel(p: Physics, state: FloatArray, demand: float, dt_s: float) -> float:
    """Servo, valve and burner; returns the fuel that burns."""
    state[SERVO] = _toward(state[SERVO], demand, p.servo_tau_s, dt_s)
    wanted = _toward(state[METERED], state[SERVO], p.valve_tau_s, dt_s)
    most = p.slew_ps * dt_s
    state[METERED] += min(max(wanted - state[METERED], -most), most)
    state[BURNED] = _toward(state[BURNED], state[METERED], p.burn_tau_s, dt_s)
    return float(state[BURNED])


@compiled
def _spin(p: Physics, state: FloatArray, air: FloatArray, fuel: float, dt_s: float) -> float:
    """Turn both rotors; returns the exhaust temperature in K."""
    root, delta = math.sqrt(air[THETA]), air[DELTA]
    c1, c2 = state[N1] / root, state[N2] / root
    core = p.airflow * max(c2, 0.2) ** 2.4 * (1.0 - air[BLEED])
    hot = air[THETA] * 288.15 * (1.328 + 2.118 * p.heat * fuel / core)
    cold = p.soak * (hot - state[METAL])
    burnt = fuel * (1.0 - 0.35 * cold / hot)
    need = p.need * fuel_needed(c2) * (1.0 + 2.5 * air[BLEED]) + air[LOAD] / delta
    gas = p.gas * speed_followed(c2) ** 2 * (1.0 - 1.5 * air[BLEED])
    surplus2 = burnt - need
    surplus1 = gas * max(burnt / need, 0.1) ** 0.35 - c1 * c1
    weight = (root / delta) ** p.thin_air
    felt1 = p.inertia1 * weight * (p.asymmetry if surplus1 > 0.0 else 1.0)
    felt2 = p.inertia2 * weight * (p.asymmetry if surplus2 > 0.0 else 1.0)
    state[N1] += dt_s * delta * surplus1 / felt1
    state[N2] += dt_s * delta * surplus2 / felt2
    flow = max(delta * core, 0.02)
    state[METAL] = _toward(state[METAL], hot, p.metal_tau_s / flow**0.8, dt_s)
    shown = hot - cold
    state[PROBE] = _toward(state[PROBE], shown, p.probe_tau_s / flow**0.5, dt_s)
    return float(shown)


@compiled
def _advance(p: Physics, state: FloatArray, command: float, air: FloatArray, dt_s: float) -> float:
    root = math.sqrt(air[THETA])
    rate = (state[N2] - state[BEFORE]) / (dt_s * air[DELTA])
    state[BEFORE] = state[N2]
    state[RATE] = _toward(state[RATE], rate, 0.06, dt_s)
    demand = _demand(p, state, command, root, dt_s)
    return _spin(p, state, air, _fuel(p, state, demand, dt_s), dt_s)


@compiled
def _settled(p: Physics, command: float, air: FloatArray) -> FloatArray:
    """State after a long time at one command; the metal is as hot as the gas."""
    state = np.zeros(_STATES)
    root = math.sqrt(air[THETA])
    c2 = command
    if p.control != N2_FUEL:
        for _ in range(60):
            found = fuel_needed(c2) if p.control == FUEL else speed_followed(c2)
            c2 = min(max(c2 + 0.3 * (command - found), 0.3), 1.1)
    state[N1], state[N2] = speed_followed(c2) * root, c2 * root
    fuel = fuel_needed(c2)
    state[SERVO] = state[METERED] = state[BURNED] = fuel
    state[INTEGRAL] = fuel if p.control == N1_RATE else 0.0
    state[BEFORE] = state[N2]
    state[METAL] = state[PROBE] = 900.0
    for _ in range(int(_SETTLE_S / STEP_S)):
        shown = _advance(p, state, command, air, STEP_S)
        state[METAL] = state[PROBE] = shown
    return state


@compiled
def run(p: Physics, commands: FloatArray, air: FloatArray, dt_s: float) -> FloatArray:
    """N1 and N2 (relative), EGT (K) and corrected fuel (time, 4), from rest at the first sample.

    `commands` (time,) is what the control holds, or the corrected fuel flow without one; `air`
    (time, 4) is theta, delta, share of bleed, and load in corrected fuel. Each sample shows the
    engine before it moves on.
    """
    count = max(1, math.ceil(dt_s / STEP_S - 1e-9))
    state = _settled(p, commands[0], air[0])
    rows = np.empty((len(commands), 4))
    for k in range(len(commands)):
        rows[k, 0], rows[k, 1] = state[N1], state[N2]
        rows[k, 2], rows[k, 3] = state[PROBE], state[METERED]
        for _ in range(count):
            _advance(p, state, commands[k], air[k], dt_s / count)
    return rows
