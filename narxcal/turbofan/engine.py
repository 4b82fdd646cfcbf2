"""The virtual engine: lever and flight condition in; speeds, temperature, fuel and thrust out.

`VirtualEngine.simulate` runs a whole log. `VirtualEngine.outputs` is its steady-state model, and
`maker_model` that of the nominal business-jet engine as its maker would deliver it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from narxcal.atmosphere import P0_PA, T0_K, isa
from narxcal.channels import channel
from narxcal.steady.model import BoxModel, Envelope, checked_inputs
from narxcal.support.arrays import FloatArray
from narxcal.support.errors import ModelError
from narxcal.turbofan.cycle import POSITIONS, Health, Stations
from narxcal.turbofan.design import Closed, Preset, close, control, preset
from narxcal.turbofan.fadec import FuelValveParameters, Sensed, steady_control, steady_valve
from narxcal.turbofan.gas import fan_face
from narxcal.turbofan.lever import LeverParameters, n1_command, resolver
from narxcal.turbofan.solve import (
    BLEED,
    CONDITIONS,
    MACH,
    N1,
    OFFTAKE_W,
    STATIC_K,
    STATIC_PA,
    Line,
    Machine,
    face_pressures,
    running_line,
    steady_points,
)
from narxcal.turbofan.transient import COLUMNS, Body, Plant, State, run, steps_per_sample
from narxcal.turbofan.unmodelled import EngineSettings, Unmodelled, with_effects

INPUT_NAMES = ("TRA_deg", "ALT_ft", "Mach", "dT_C", "WOW", "Approach", "ECS", "NAI", "WAI")
OUTPUT_NAMES = ("N1_pct", "N2_pct", "EGT_C", "FF_kgph", "FN_kN", "FPR", "EPR")
LOW = np.array([0.0, -1000.0, 0.0, -30.0, 0.0, 0.0, 0.0, 0.0, 0.0])
HIGH = np.array([85.0, 40000.0, 0.85, 20.0, 1.0, 1.0, 1.0, 1.0, 1.0])
COMPRESSORS = ("fan", "lpc", "hpc")  # in the order of the map positions
_LINE = np.linspace(0.175, 1.10, 75)  # relative N1 of the running line


@dataclass(frozen=True)
class _Core:
    """Computed from a preset alone."""

    closed: Closed
    machine: Machine
    line: Line
    body: Body


@lru_cache(maxsize=8)
def _core(name: str) -> _Core:
    chosen = preset(name)
    closed = close(chosen.point, chosen.shape)
    machine = Machine(closed.path, Health(), chosen.point.recovery, closed.fuel_kgps)
    line = running_line(machine, _LINE, np.array([*closed.positions, 1.0, 1.0]))
    at_design = np.zeros((1, CONDITIONS))
    at_design[0, :4] = T0_K, P0_PA, 0.0, 1.0
    stations = Stations(*steady_points(machine, line, at_design)[1][0])
    return _Core(closed, machine, line, _body(chosen, stations))


def _body(chosen: Preset, design: Stations) -> Body:
    inertia = [i * w * w for i, w in zip(chosen.inertia, chosen.speed_radps, strict=True)]
    heat_flow = design.W45 * 1180.0  # W/K of the gas, cp about 1180 J/(kg K) behind the burner
    return Body(
        inertia1_J=inertia[0],
        inertia2_J=inertia[1],
        N1_design_pct=chosen.speed_pct[0],
        N2_design_pct=chosen.speed_pct[1],
        metal_WpK=chosen.metal_share * heat_flow,
        metal_tau_s=chosen.metal_tau_s,
        casing_tau_s=chosen.casing_tau_s,
        clearance_pK=chosen.clearance_pK,
        flow_kgps=design.W45,
        probe_tau_s=chosen.probe_tau_s,
    )


class VirtualEngine(BoxModel):
    """One engine of a preset, with its own build and unmodelled effects.

    `build` are multipliers of component efficiencies and flows (see `build_scatter`). It is a
    simulator (`simulate`) and a steady-state model, whose `outputs` raise `ModelError` naming the
    condition that does not converge.

    Raises `ConfigError` for an unknown preset.
    """

    input_names = INPUT_NAMES
    output_names = OUTPUT_NAMES

    def __init__(
        self,
        name: str = "business_jet",
        build: Health | None = None,
        unmodelled: Sequence[Unmodelled] = (),
    ) -> None:
        self.preset = preset(name)
        core = _core(name)
        slew = core.closed.fuel_kgps
        nominal = EngineSettings(
            lever=LeverParameters(),
            valve=FuelValveParameters(slew_kgps2=slew),
            ratings=self.preset.ratings,
            body=core.body,
            health=build or Health(),
        )
        self.settings = with_effects(nominal, unmodelled)
        self._line = core.line
        self._machine = core.machine._replace(health=self.settings.health)
        # The control is designed for the nominal engine, without the scatter of its build.
        self._fadec = control(
            self.preset, core.machine, core.line, core.body, self.settings.accel_margin
        )
        self.envelope = Envelope(LOW, HIGH)

    def gas_path(self, inputs: ArrayLike) -> dict[str, FloatArray]:
        """Steady stations, each (n,), at `inputs` (n, 9), by the names of `Stations`.

        Also `fuel_kgps`, relative `n1` and `n2`, and the map angles of the compressors
        (`fan_angle`, `lpc_angle`, `hpc_angle`; surge is at pi/2). Raises as `outputs` does.
        """
        conditions, unknowns, rows = self._steady_points(checked_inputs(inputs, self.input_names))
        fuel = self._machine.fuel_unit_kgps * unknowns[:, -1]
        found = dict(zip(Stations._fields, rows.T, strict=True))
        found |= {"fuel_kgps": fuel, "n1": conditions[:, N1], "n2": unknowns[:, POSITIONS]}
        return found | {f"{part}_angle": unknowns[:, j] for j, part in enumerate(COMPRESSORS)}

    def simulate(self, inputs: Mapping[str, FloatArray], dt_s: float) -> dict[str, FloatArray]:
        """Simulate a log sampled every `dt_s` seconds, from the steady state of its first sample.

        `inputs` maps `INPUT_NAMES` to (time,); the result maps `transient.COLUMNS` to (time,).
        The outputs are true values; only EGT is that of its probe, whose lag depends on the flow.
        """
        u = _stacked(inputs)
        self._check(u, dt_s)
        u[:, 0] = resolver(u[:, 0], dt_s, self.settings.lever)
        commands = n1_command(self.settings.ratings, u)
        conditions = self._conditions(u, commands)
        self._add_switches(conditions, dt_s)
        plant = Plant(self._machine, self.settings.body, self._fadec, self.settings.valve)
        state = self._steady_state(conditions[0], u[0], dt_s)
        rows, solved = run(plant, state, commands, conditions, dt_s)
        if solved < len(u):
            raise ModelError(
                f"the engine's gas path has no solution {_where(u[solved])}", row=solved
            )
        return {name: rows[:, j].copy() for j, name in enumerate(COLUMNS)}

    def _check(self, u: FloatArray, dt_s: float) -> None:
        if not (np.isfinite(dt_s) and 0.0 < dt_s <= 0.2):
            raise ModelError(f"the virtual engine runs at steps of up to 0.2 s, got {dt_s} s")
        outside = ~self.envelope.inside(u)
        if len(u) == 0 or outside.any():
            raise ModelError(_outside(u, outside))

    def _conditions(self, u: FloatArray, commands: FloatArray) -> FloatArray:
        """Conditions (n, 6) of the gas path; bleeds follow the switches."""
        rows = np.zeros((len(u), CONDITIONS))
        temperature, rows[:, STATIC_PA] = isa(u[:, 1])
        rows[:, STATIC_K] = temperature + u[:, 3]
        rows[:, MACH] = u[:, 2]
        rows[:, N1] = commands / self.preset.speed_pct[0]
        preset = self.preset
        bleeds = np.array([preset.ecs_bleed, preset.nai_bleed, preset.wai_bleed])
        rows[:, BLEED] = u[:, 6:9] @ bleeds
        rows[:, BLEED] += self.settings.bleed * (u[:, 6:9] > 0.5).any(axis=1)
        rows[:, OFFTAKE_W] = preset.offtake_W
        return rows

    def _add_switches(self, conditions: FloatArray, dt_s: float) -> None:
        time_s = np.arange(len(conditions)) * dt_s
        for effect in self.settings.switches:
            for start, stop in effect.windows:
                on = (time_s >= start) & (time_s < stop)
                conditions[on, BLEED] += effect.value("bleed")
                conditions[on, OFFTAKE_W] += 1e3 * effect.value("power_kW")

    def _steady_points(self, u: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Conditions, unknowns and stations of the steady states at `u` (n, 9)."""
        commands = n1_command(
            self.settings.ratings, u + self.settings.lever.bias_deg * (np.arange(9) == 0)
        )
        conditions = self._conditions(u, commands)
        unknowns, rows, good = steady_points(self._machine, self._line, conditions)
        if not good.all():
            raise ModelError(f"the engine has no steady state {_where(u[np.argmin(good)])}")
        return conditions, unknowns, rows

    def _evaluate(self, inputs: FloatArray) -> FloatArray:
        conditions, unknowns, rows = self._steady_points(inputs)
        at = dict(zip(Stations._fields, rows.T, strict=True))
        P2 = face_pressures(self._machine, conditions)
        return np.column_stack(
            [
                self.preset.speed_pct[0] * conditions[:, N1],
                self.preset.speed_pct[1] * unknowns[:, POSITIONS],
                at["T45"] - 273.15,
                3600.0 * self._machine.fuel_unit_kgps * unknowns[:, -1],
                1e-3 * at["net_N"],
                at["P13"] / P2,
                at["P5"] / P2,
            ]
        )

    def _steady_state(self, condition: FloatArray, u: FloatArray, dt_s: float) -> State:
        """State of an engine in equilibrium at `condition`, which follows from the inputs `u`."""
        unknowns, rows, good = steady_points(self._machine, self._line, condition[np.newaxis])
        if not good[0]:
            raise ModelError(f"the engine has no steady state to start from {_where(u)}", row=0)
        command = float(condition[N1]) * self.preset.speed_pct[0]
        x, s = unknowns[0], Stations(*rows[0])
        fuel = float(self._machine.fuel_unit_kgps * x[-1])
        air = (condition[STATIC_K], condition[STATIC_PA], condition[MACH])
        T2, P2 = fan_face(*air, self._machine.recovery)
        N2 = float(self.preset.speed_pct[1] * x[POSITIONS])
        sensed = Sensed(command, command, N2, s.T45, s.P3, P2, T2)
        return State(
            rotors=np.array([condition[N1], x[POSITIONS], 0.0, 0.0]),
            metal=np.array([s.T41, s.T41, 0.0, 0.0]),
            sensed=np.array([command, N2, s.P3, s.T45]),
            measured=np.array([command, N2, s.P3, s.T45]),
            positions=x[:POSITIONS].copy(),
            inverse=np.zeros((POSITIONS, POSITIONS)),
            fadec=steady_control(sensed, fuel),
            valve=steady_valve(self.settings.valve, fuel, dt_s / steps_per_sample(dt_s)),
        )


def build_scatter(random: np.random.Generator, sigma_pct: float = 0.5) -> Health:
    """Draw a build: each efficiency and flow has a normal error of `sigma_pct` percent."""
    drawn = 1.0 + 0.01 * sigma_pct * random.standard_normal(len(Health._fields))
    return Health(*drawn.tolist())


def _stacked(inputs: Mapping[str, FloatArray]) -> FloatArray:
    found = [np.asarray(inputs[name], np.float64) for name in INPUT_NAMES if name in inputs]
    if len(found) < len(INPUT_NAMES) or len({each.shape for each in found}) > 1:
        raise ModelError(f"expected inputs of one length: {', '.join(INPUT_NAMES)}")
    return np.column_stack(found)


def _where(u: FloatArray) -> str:
    values = (f"{name} {value:g}" for name, value in zip(INPUT_NAMES, u.tolist(), strict=True))
    return f"at {', '.join(values)}"


def _outside(u: FloatArray, outside: NDArray[np.bool_]) -> str:
    if len(u) == 0:
        return "the virtual engine needs at least one sample, got none"
    row = int(np.argmax(outside))
    j = int(np.argmax(~((u[row] >= LOW) & (u[row] <= HIGH))))
    name, unit = INPUT_NAMES[j], channel(INPUT_NAMES[j]).unit
    return (
        f"sample {row}: {name} is {u[row, j]:g} {unit}, outside the virtual engine's envelope "
        f"{LOW[j]:g} .. {HIGH[j]:g}"
    )


def maker_model(inputs: ArrayLike) -> NDArray[np.float64]:
    """Steady N1, N2 and EGT (..., 3) at `inputs` (..., 9) of the business-jet engine."""
    return _business_jet().outputs(inputs)[..., :3]


@lru_cache(maxsize=1)
def _business_jet() -> VirtualEngine:
    """Build it once: a replay calls `maker_model` for each row."""
    return VirtualEngine("business_jet")
