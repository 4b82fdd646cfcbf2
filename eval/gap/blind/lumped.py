"""A second engine of another structure: lumped parameters and corrected curves, no components.

It shares nothing with the virtual engine but the words of the effects. Three kinds: `lumped_n1`
governs N1 and limits the corrected acceleration of N2; `lumped_n2` governs N2 and limits the fuel
over N2, like an older hydromechanical control; `lumped_fuel` has no control at all, its fuel flow
is the input. Effects are where they are in such an engine: in the lever, the valve, the limits, the
inertias, the metal, the bleeds, the need for fuel.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from eval.gap.blind.lumped_run import FUEL, N1_RATE, N2_FUEL, Physics, run, speed_followed
from narxcal.atmosphere import air_state
from narxcal.support.arrays import FloatArray
from narxcal.support.compiled import compiled
from narxcal.turbofan import Unmodelled
from narxcal.turbofan.cycle import Health

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
        hidden = self.effects.get("unlogged_switch")
        time_s = np.arange(len(bleed)) * dt_s
        for start, stop in () if hidden is None else hidden.windows:
            on = (time_s >= start) & (time_s < stop)
            bleed[on] += self._value("unlogged_switch", "bleed")
            load[on] += self._value("unlogged_switch", "power_kW") / _FULL_KW
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
        heard = np.asarray(np.interp(late, index, moved), np.float64)
        return heard + self._value("throttle_bias", "bias_deg")


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
