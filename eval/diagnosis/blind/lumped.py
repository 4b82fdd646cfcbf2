"""A second engine of another structure: lumped parameters and corrected curves, no components.

It shares nothing with the virtual engine but the words of the effects. Three kinds: `lumped_n1`
governs N1 and limits the corrected acceleration of N2; `lumped_n2` governs N2 and limits the fuel
over N2, like an older hydromechanical control; `lumped_fuel` has no control at all, its fuel flow
is the input. Effects are where they are in such an engine: in the lever, the valve, the limits, the
inertias, the metal, the bleeds, the need for fuel.

Everything in the equations is corrected to sea level, `c = n / sqrt(theta)` for speeds and
`phi = Wf / (delta sqrt(theta))` for fuel, relative to full power. Rotor 2 answers to the fuel
beyond what it needs, rotor 1 to the gas that rotor 2 sends it:

    J2 dn2/dt = delta (phi - need(c2)),   J1 dn1/dt = delta (gas(c2) (phi / need)^0.35 - c1^2)

The exhaust temperature follows from fuel over air, gives heat to metal, and is read behind a probe.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Final, NamedTuple

import numpy as np

from narxcal.atmosphere import air_state
from narxcal.flight_test.signals import within
from narxcal.support.arrays import FloatArray
from narxcal.support.compiled import compiled
from narxcal.turbofan import Unmodelled
from narxcal.turbofan.cycle import Health

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


KINDS: Final = {"lumped_n1": N1_RATE, "lumped_n2": N2_FUEL, "lumped_fuel": FUEL}
_AIR = ("ALT_ft", "Mach", "dT_C", "WOW", "Approach", "ECS", "NAI", "WAI")
_FULL_DEG, _FULL_KGPH, _FULL_KW = 85.0, 1100.0, 2500.0
_N2_PCT = 98.0
_BLEEDS = (0.015, 0.02, 0.03)  # of ECS, NAI and WAI, of the air of the core
_IDLE, _HIGH_IDLE, _APPROACH_IDLE = 0.60, 0.12, 0.07  # corrected N2; per loss of pressure; more
_FACTORS = {
    "spool_lag": ("inertia1", "inertia2"),
    "spool_coupling": ("inertia1",),
    "heat_soak": ("soak",),
    "accel_limit": ("acceleration",),
    "accel_decel_asymmetry": ("asymmetry",),
}


class LumpedEngine:
    """One engine of a kind, with a build and with effects; `probe` multiplies its probe's lag."""

    def __init__(
        self,
        kind: str = "lumped_n1",
        build: Health | None = None,
        unmodelled: Sequence[Unmodelled] = (),
        probe: float = 1.0,
    ) -> None:
        self.kind = kind
        self.effects = {effect.id: effect for effect in unmodelled}
        lever = "FF_kgph" if KINDS[kind] == FUEL else "TRA_deg"
        self.input_names = (lever, *_AIR)
        self.physics = self._fitted(build or Health())
        self.physics = self.physics._replace(probe_tau_s=probe * self.physics.probe_tau_s)

    def simulate(self, inputs: Mapping[str, FloatArray], dt_s: float) -> dict[str, FloatArray]:
        """Outputs (time,) for inputs (time,) sampled every `dt_s`, settled at the first sample."""
        u = {name: np.asarray(inputs[name], np.float64) for name in self.input_names}
        air = air_state(u["ALT_ft"], u["Mach"], u["dT_C"])
        theta, delta = np.asarray(air.theta2), np.asarray(air.delta2)
        unit = _FULL_KGPH * delta * np.sqrt(theta)
        bleed, load = self._taken(u, dt_s)
        columns = np.column_stack([theta, delta, bleed, load])
        if self.physics.control == FUEL:
            commands = u["FF_kgph"] / unit
        else:
            commands = self._commands(u, theta, delta, dt_s)
        rows = run(self.physics, np.ascontiguousarray(commands), columns, dt_s)
        return {
            "N1_pct": 100.0 * rows[:, 0],
            "N2_pct": _N2_PCT * rows[:, 1],
            "EGT_C": rows[:, 2] - 273.15,
            "FF_kgph": rows[:, 3] * unit,
        }

    def _value(self, effect: str, parameter: str) -> float:
        return self.effects.get(effect, Unmodelled(effect)).value(parameter)

    def _fitted(self, build: Health) -> Physics:
        """The design with the build's scatter, worn, and with every effect on a constant."""
        worn = 1.0 + 0.01 * self._value("deterioration", "hpt_efficiency_pct")
        worn *= 1.0 + 0.01 * self._value("deterioration", "hpc_efficiency_pct")
        p = Physics(
            KINDS[self.kind],
            need=(worn / (build.hpt_efficiency * build.hpc_efficiency)) ** 1.2,
            airflow=build.hpc_flow,
            gas=build.fan_efficiency**0.7 * build.lpt_efficiency,
            heat=math.sqrt(build.hpt_area),
            servo_tau_s=self._value("actuator_lag", "tau_s"),
            thin_air=self._value("altitude_lag", "exponent"),
        )
        for effect, names in _FACTORS.items():
            if effect in self.effects:
                factor = next(iter(self.effects[effect].parameters.values()))
                p = p._replace(**{name: getattr(p, name) * factor for name in names})
        return p

    def _taken(self, u: Mapping[str, FloatArray], dt_s: float) -> tuple[FloatArray, FloatArray]:
        """Bleed (time,) and load (time,), with what no simulator knows of."""
        switches = np.column_stack([u["ECS"], u["NAI"], u["WAI"]])
        bleed = switches @ np.array(_BLEEDS)
        bleed += self._value("bleed_extraction", "share") * (switches > 0.5).any(axis=1)
        load = np.full(len(bleed), 0.004)
        windows = self.effects.get("unlogged_switch", Unmodelled("unlogged_switch")).windows
        on = within(np.arange(len(bleed), dtype=np.float64) * dt_s, windows)
        bleed += self._value("unlogged_switch", "bleed") * on
        load += self._value("unlogged_switch", "power_kW") / _FULL_KW * on
        return bleed, load

    def _commands(
        self, u: Mapping[str, FloatArray], theta: FloatArray, delta: FloatArray, dt_s: float
    ) -> FloatArray:
        """Corrected N1 or N2 (time,) that the lever asks for, never below idle."""
        lever = self._heard(u["TRA_deg"], dt_s) / _FULL_DEG
        share = np.clip(lever, 0.0, 1.0) ** 0.85
        more = _APPROACH_IDLE + 0.01 * self._value("idle_schedule", "shift_pct")
        idle = _IDLE + _HIGH_IDLE * (1.0 - np.minimum(delta, 1.0)) + more * u["Approach"]
        warm = 0.01 * self._value("temperature_effect", "N1_pct_per_C") * u["dT_C"]
        if self.physics.control == N2_FUEL:
            wanted = 0.60 + 0.40 * share + 0.5 * warm
            return np.asarray(np.maximum(np.minimum(wanted, 1.03 / np.sqrt(theta)), idle))
        wanted = np.minimum(0.25 + 0.75 * share + warm, 1.03 / np.sqrt(theta))
        least = np.array([speed_followed(each) for each in idle.tolist()])
        return np.asarray(np.maximum(wanted, least))

    def _heard(self, lever: FloatArray, dt_s: float) -> FloatArray:
        """The lever as the control hears it: late, slow, through play, and off."""
        width = self._value("throttle_backlash", "width_deg")
        rate = self._value("throttle_rate_limit", "rate_degps")
        moved = _linkage(np.ascontiguousarray(lever), 0.5 * width, rate * dt_s)
        index = np.arange(len(lever), dtype=np.float64)
        late = index - self._value("throttle_delay", "delay_s") / dt_s
        arrived = np.asarray(np.interp(late, index, moved), np.float64)
        return arrived + self._value("throttle_bias", "bias_deg")


@compiled
def _linkage(lever: FloatArray, play: float, most: float) -> FloatArray:
    """Behind a linkage with `play` to either side that moves by at most `most` a sample."""
    moved = np.empty_like(lever)
    end = lever[0]
    held = lever[0]
    for k in range(len(lever)):
        end = min(max(end, lever[k] - play), lever[k] + play)
        held += min(max(end - held, -most), most)
        moved[k] = held
    return moved


def applies(effect: str, kind: str) -> bool:
    """Whether a kind of lumped engine has a place for an effect of the library."""
    lever = ("throttle_", "accel_limit", "idle_schedule", "temperature_effect", "flowmeter")
    return KINDS.get(kind) != FUEL or not effect.startswith(lever)
