"""The virtual engine: lever and flight condition in, speeds, temperature, fuel and thrust out.

As a simulator it runs a whole log; as a steady-state model it is what a maker would hand over.

The business-jet engine as its maker would hand it over: where it settles, and no more.

What can be wrong with a virtual engine that its steady-state model and its logs do not tell.

Each effect of the library that has a physical place in the engine sits there: in the lever, the
fuel valve, the control's schedules, the rotors, the gas path or the metal. Ids are those of the
effect library; sizes are the engine's own, not those of the forms that the diagnosis fits.
"""

from __future__ import annotations

import difflib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from narxcal.atmosphere import isa
from narxcal.channels import channel
from narxcal.steady.model import Envelope, checked_inputs
from narxcal.support.arrays import FloatArray
from narxcal.support.errors import ConfigError, ModelError
from narxcal.turbofan import fadec, fuel_valve
from narxcal.turbofan.control_design import Linear, control, linearised
from narxcal.turbofan.cycle import POSITIONS, Health, Stations
from narxcal.turbofan.design import Closed, Preset, close, preset
from narxcal.turbofan.fadec import Sensed
from narxcal.turbofan.fuel_valve import FuelValveParameters
from narxcal.turbofan.gas import fan_face
from narxcal.turbofan.lever import LeverParameters, resolver
from narxcal.turbofan.ratings import Ratings, n1_command
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
    rest_points,
    running_line,
)
from narxcal.turbofan.transient import COLUMNS, Body, Plant, State, run, steps_per_sample


class Size(NamedTuple):
    """Range of a parameter, and the value at which the effect is not there."""

    unit: str
    low: float
    high: float
    neutral: float


PARAMETERS: dict[str, dict[str, Size]] = {
    "throttle_backlash": {"width_deg": Size("deg", 0.0, 10.0, 0.0)},
    "throttle_delay": {"delay_s": Size("s", 0.0, 3.0, 0.0)},
    "throttle_rate_limit": {"rate_degps": Size("deg/s", 1.0, 400.0, 400.0)},
    "throttle_bias": {"bias_deg": Size("deg", -10.0, 10.0, 0.0)},
    "actuator_lag": {"tau_s": Size("s", 0.0, 5.0, 0.0), "slew": Size("-", 0.02, 1.0, 1.0)},
    "spool_lag": {"factor": Size("-", 0.3, 4.0, 1.0)},
    "spool_coupling": {"factor": Size("-", 0.3, 4.0, 1.0)},
    "accel_decel_asymmetry": {"ratio": Size("-", 0.3, 4.0, 1.0)},
    "accel_limit": {"factor": Size("-", 0.1, 2.0, 1.0)},
    "altitude_lag": {"exponent": Size("-", -1.0, 2.0, 0.0)},
    "heat_soak": {"factor": Size("-", 0.0, 6.0, 1.0)},
    "bleed_extraction": {"share": Size("-", 0.0, 0.15, 0.0)},
    "unlogged_switch": {
        "bleed": Size("-", 0.0, 0.15, 0.0),
        "power_kW": Size("kW", 0.0, 500.0, 0.0),
    },
    "deterioration": {
        "hpc_efficiency_pct": Size("%", -6.0, 6.0, 0.0),
        "hpt_efficiency_pct": Size("%", -6.0, 6.0, 0.0),
        "hpc_flow_pct": Size("%", -6.0, 6.0, 0.0),
    },
    "temperature_effect": {"N1_pct_per_C": Size("%/degC", -0.3, 0.3, 0.0)},
    "idle_schedule": {"shift_pct": Size("%", -10.0, 15.0, 0.0)},
}


@dataclass(frozen=True)
class Unmodelled:
    """One effect with its parameters; one left out is neutral.

    `windows` are (start, stop) in s of the log, for `unlogged_switch` alone.

    Raises `ConfigError` for an unknown effect or parameter, and for a size out of range.
    """

    id: str
    parameters: Mapping[str, float] = field(default_factory=dict)
    windows: tuple[tuple[float, float], ...] = ()

    def __post_init__(self) -> None:
        known = PARAMETERS.get(self.id)
        if known is None:
            raise ConfigError(f"unknown effect '{self.id}'", hint=_nearest(self.id, PARAMETERS))
        for name, value in self.parameters.items():
            if name not in known:
                raise ConfigError(
                    f"effect '{self.id}' has no parameter '{name}'", hint=_nearest(name, known)
                )
            size = known[name]
            if not size.low <= value <= size.high:
                raise ConfigError(
                    f"effect '{self.id}': {name} has to be within {size.low:g} .. {size.high:g} "
                    f"{size.unit}, found {value:g}"
                )
        if self.windows and self.id != "unlogged_switch":
            raise ConfigError(f"effect '{self.id}' has no windows; unlogged_switch has")
        if any(not start < stop for start, stop in self.windows):
            raise ConfigError(f"effect '{self.id}': a window has to start before it stops")

    def value(self, name: str) -> float:
        """Value of the parameter, neutral where it was left out."""
        return float(self.parameters.get(name, PARAMETERS[self.id][name].neutral))


def _nearest(name: str, known: Mapping[str, object]) -> str:
    near = difflib.get_close_matches(name, known, n=1, cutoff=0.4)
    return f"Did you mean '{near[0]}'?" if near else f"Known: {', '.join(known)}"


@dataclass(frozen=True)
class Fit:
    """Everything of an engine that an effect can change; `margins` multiply those of the control.

    `bleed` is added to the customer bleed wherever ECS, NAI or WAI is on.
    """

    lever: LeverParameters
    valve: FuelValveParameters
    ratings: Ratings
    body: Body
    health: Health
    accel_margin: float = 1.0
    bleed: float = 0.0
    switches: tuple[Unmodelled, ...] = ()


def fitted_with(fit: Fit, effects: Sequence[Unmodelled]) -> Fit:
    """`fit` with every one of `effects` in its place."""
    for effect in effects:
        fit = _PLACES[effect.id](fit, effect)
    return fit


def _lever(fit: Fit, effect: Unmodelled) -> Fit:
    key = {
        "throttle_backlash": ("backlash_deg", "width_deg"),
        "throttle_delay": ("delay_s", "delay_s"),
        "throttle_rate_limit": ("rate_limit_degps", "rate_degps"),
        "throttle_bias": ("bias_deg", "bias_deg"),
    }
    to, source = key[effect.id]
    return replace(fit, lever=fit.lever._replace(**{to: effect.value(source)}))


def _actuator(fit: Fit, effect: Unmodelled) -> Fit:
    valve = fit.valve._replace(
        servo_tau_s=fit.valve.servo_tau_s + effect.value("tau_s"),
        slew_kgps2=fit.valve.slew_kgps2 * effect.value("slew"),
    )
    return replace(fit, valve=valve)


def _inertia(fit: Fit, effect: Unmodelled) -> Fit:
    """Both spools heavier, or the low-pressure spool alone, which then trails the other."""
    body, factor = fit.body, effect.value("factor")
    second = body.inertia2_J * (factor if effect.id == "spool_lag" else 1.0)
    body = body._replace(inertia1_J=body.inertia1_J * factor, inertia2_J=second)
    return replace(fit, body=body)


def _asymmetry(fit: Fit, effect: Unmodelled) -> Fit:
    ratio = fit.body.asymmetry * effect.value("ratio")
    return replace(fit, body=fit.body._replace(asymmetry=ratio))


def _accel_limit(fit: Fit, effect: Unmodelled) -> Fit:
    return replace(fit, accel_margin=fit.accel_margin * effect.value("factor"))


def _thin_air(fit: Fit, effect: Unmodelled) -> Fit:
    exponent = fit.body.thin_air + effect.value("exponent")
    return replace(fit, body=fit.body._replace(thin_air=exponent))


def _soak(fit: Fit, effect: Unmodelled) -> Fit:
    factor, body = effect.value("factor"), fit.body
    body = body._replace(metal_WpK=body.metal_WpK * factor, clearance_pK=body.clearance_pK * factor)
    return replace(fit, body=body)


def _bleed(fit: Fit, effect: Unmodelled) -> Fit:
    return replace(fit, bleed=fit.bleed + effect.value("share"))


def _switch(fit: Fit, effect: Unmodelled) -> Fit:
    return replace(fit, switches=(*fit.switches, effect))


def _deterioration(fit: Fit, effect: Unmodelled) -> Fit:
    """A loss is positive, in percent of the part's efficiency or flow."""
    h = fit.health
    h = h._replace(
        hpc_efficiency=h.hpc_efficiency * (1.0 - 0.01 * effect.value("hpc_efficiency_pct")),
        hpt_efficiency=h.hpt_efficiency * (1.0 - 0.01 * effect.value("hpt_efficiency_pct")),
        hpc_flow=h.hpc_flow * (1.0 - 0.01 * effect.value("hpc_flow_pct")),
    )
    return replace(fit, health=h)


def _temperature(fit: Fit, effect: Unmodelled) -> Fit:
    bias = fit.ratings.temperature_bias_pct_per_C + effect.value("N1_pct_per_C")
    return replace(fit, ratings=replace(fit.ratings, temperature_bias_pct_per_C=bias))


def _idle(fit: Fit, effect: Unmodelled) -> Fit:
    idle = fit.ratings.approach_idle_pct + effect.value("shift_pct")
    return replace(fit, ratings=replace(fit.ratings, approach_idle_pct=idle))


_PLACES = {
    "throttle_backlash": _lever,
    "throttle_delay": _lever,
    "throttle_rate_limit": _lever,
    "throttle_bias": _lever,
    "actuator_lag": _actuator,
    "spool_lag": _inertia,
    "spool_coupling": _inertia,
    "accel_decel_asymmetry": _asymmetry,
    "accel_limit": _accel_limit,
    "altitude_lag": _thin_air,
    "heat_soak": _soak,
    "bleed_extraction": _bleed,
    "unlogged_switch": _switch,
    "deterioration": _deterioration,
    "temperature_effect": _temperature,
    "idle_schedule": _idle,
}


INPUT_NAMES = ("TRA_deg", "ALT_ft", "Mach", "dT_C", "WOW", "Approach", "ECS", "NAI", "WAI")
OUTPUT_NAMES = ("N1_pct", "N2_pct", "EGT_C", "FF_kgph", "FN_kN", "FPR", "EPR")
LOW = np.array([0.0, -1000.0, 0.0, -30.0, 0.0, 0.0, 0.0, 0.0, 0.0])
HIGH = np.array([85.0, 40000.0, 0.85, 20.0, 1.0, 1.0, 1.0, 1.0, 1.0])
COMPRESSORS = ("fan", "lpc", "hpc")  # in the order of the map positions
_LINE = np.linspace(0.175, 1.10, 75)  # relative N1 of the running line


@dataclass(frozen=True)
class _Core:
    """What follows from a preset alone."""

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
    at_design[0, :4] = 288.15, 101325.0, 0.0, 1.0
    stations = Stations(*rest_points(machine, line, at_design)[1][0])
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


class VirtualEngine:
    """One engine of a preset, with its own build and with what nobody modelled.

    `build` are multipliers of component efficiencies and flows (see `build_scatter`),
    `unmodelled` the effects switched on. It is a steady-state model by itself (`outputs`,
    `inside`), and a simulator by `simulate`.

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
        nominal = Fit(
            lever=LeverParameters(),
            valve=FuelValveParameters(slew_kgps2=slew),
            ratings=self.preset.ratings,
            body=core.body,
            health=build or Health(),
        )
        self.fit = fitted_with(nominal, unmodelled)
        self._line = core.line
        self._machine = core.machine._replace(health=self.fit.health)
        # The control is designed for the engine as it should be, not as it is.
        self._fadec = control(
            self.preset, core.machine, core.line, core.body, self.fit.accel_margin
        )
        self._box = Envelope(LOW, HIGH)

    def inside(self, inputs: ArrayLike) -> NDArray[np.bool_]:
        """Whether each sample of `inputs` (..., 9) lies in the envelope: (...,)."""
        return self._box.inside(checked_inputs(inputs, self.input_names))

    def outputs(self, inputs: ArrayLike) -> FloatArray:
        """Settled outputs (..., 7) at `inputs` (..., 9) moved into the envelope; NaN for NaN.

        Raises `ModelError` naming the condition that does not converge.
        """
        array = checked_inputs(inputs, self.input_names)
        flat = self._box.clamp(array.reshape(-1, len(INPUT_NAMES)))
        known = np.isfinite(flat).all(axis=1)
        found = np.full((len(flat), len(OUTPUT_NAMES)), np.nan)
        if known.any():
            found[known] = self._settled(flat[known])
        return found.reshape(*array.shape[:-1], len(OUTPUT_NAMES))

    steady_state = outputs

    def gas_path(self, inputs: ArrayLike) -> dict[str, FloatArray]:
        """Settled stations, each (n,), at `inputs` (n, 9), by the names of `Stations`.

        Beside them: `fuel_kgps`, relative `n1` and `n2`, and the map angles of the compressors
        (`fan_angle`, `lpc_angle`, `hpc_angle`; surge is at pi/2). Raises as `outputs` does.
        """
        conditions, unknowns, rows = self._solved(checked_inputs(inputs, self.input_names))
        fuel = self._machine.fuel_unit_kgps * unknowns[:, -1]
        found = dict(zip(Stations._fields, rows.T, strict=True))
        found |= {"fuel_kgps": fuel, "n1": conditions[:, N1], "n2": unknowns[:, POSITIONS]}
        return found | {f"{part}_angle": unknowns[:, j] for j, part in enumerate(COMPRESSORS)}

    def linearised(self, inputs: ArrayLike) -> list[Linear]:
        """The rotors' time constants and the overshoot of EGT at each row of `inputs` (n, 9)."""
        conditions, unknowns, _ = self._solved(checked_inputs(inputs, self.input_names))
        pairs = zip(conditions, unknowns, strict=True)
        return [linearised(self._machine, self.fit.body, c, x) for c, x in pairs]

    def simulate(self, inputs: Mapping[str, FloatArray], dt_s: float) -> dict[str, FloatArray]:
        """Run a log sampled every `dt_s` seconds, from its settled first sample.

        `inputs` maps `INPUT_NAMES` to (time,); the result maps the columns of
        `narxcal.turbofan.transient` likewise. No sensor is between: EGT alone is behind its
        probe, whose lag depends on the engine.

        Raises `ModelError` if an input is missing or of another length, or if a sample lies
        outside the envelope or does not converge.
        """
        u = _stacked(inputs)
        self._check(u, dt_s)
        u[:, 0] = resolver(u[:, 0], dt_s, self.fit.lever)
        commands = n1_command(self.fit.ratings, u)
        conditions = self._conditions(u, commands)
        self._add_switches(conditions, dt_s)
        plant = Plant(self._machine, self.fit.body, self._fadec, self.fit.valve)
        state = self._at_rest(conditions[0], u[0], dt_s)
        rows, solved = run(plant, state, commands, conditions, dt_s)
        if solved < len(u):
            raise ModelError(
                f"the engine's gas path has no solution {_where(u[solved])}", row=solved
            )
        return {name: rows[:, j].copy() for j, name in enumerate(COLUMNS)}

    def _check(self, u: FloatArray, dt_s: float) -> None:
        if not (np.isfinite(dt_s) and 0.0 < dt_s <= 0.2):
            raise ModelError(f"the virtual engine runs at steps of up to 0.2 s, got {dt_s} s")
        outside = ~self._box.inside(u)
        if len(u) == 0 or outside.any():
            raise ModelError(_outside(u, outside))

    def _conditions(self, u: FloatArray, commands: FloatArray) -> FloatArray:
        """Rows (n, 6) of what the gas path is asked for; bleeds follow the switches."""
        rows = np.zeros((len(u), CONDITIONS))
        temperature, rows[:, STATIC_PA] = isa(u[:, 1])
        rows[:, STATIC_K] = temperature + u[:, 3]
        rows[:, MACH] = u[:, 2]
        rows[:, N1] = commands / self.preset.speed_pct[0]
        p = self.preset
        rows[:, BLEED] = u[:, 6:9] @ np.array([p.ecs_bleed, p.nai_bleed, p.wai_bleed])
        rows[:, BLEED] += self.fit.bleed * (u[:, 6:9] > 0.5).any(axis=1)
        rows[:, OFFTAKE_W] = p.offtake_W
        return rows

    def _add_switches(self, conditions: FloatArray, dt_s: float) -> None:
        time_s = np.arange(len(conditions)) * dt_s
        for effect in self.fit.switches:
            for start, stop in effect.windows:
                on = (time_s >= start) & (time_s < stop)
                conditions[on, BLEED] += effect.value("bleed")
                conditions[on, OFFTAKE_W] += 1e3 * effect.value("power_kW")

    def _solved(self, u: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Conditions, unknowns and stations at the settled points `u` (n, 9)."""
        commands = n1_command(self.fit.ratings, u + self.fit.lever.bias_deg * (np.arange(9) == 0))
        conditions = self._conditions(u, commands)
        unknowns, rows, good = rest_points(self._machine, self._line, conditions)
        if not good.all():
            raise ModelError(f"the engine has no steady state {_where(u[np.argmin(good)])}")
        return conditions, unknowns, rows

    def _settled(self, u: FloatArray) -> FloatArray:
        conditions, unknowns, rows = self._solved(u)
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

    def _at_rest(self, condition: FloatArray, u: FloatArray, dt_s: float) -> State:
        """State of an engine that has long been running at `condition`, which follows from `u`."""
        unknowns, rows, good = rest_points(self._machine, self._line, condition[np.newaxis])
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
            felt=np.array([command, N2, s.P3, s.T45]),
            positions=x[:POSITIONS].copy(),
            inverse=np.zeros((POSITIONS, POSITIONS)),
            fadec=fadec.settled(self._fadec, sensed, fuel),
            valve=fuel_valve.settled(self.fit.valve, fuel, dt_s / steps_per_sample(dt_s)),
        )


def build_scatter(random: np.random.Generator, sigma_pct: float = 0.5) -> Health:
    """Draw a build: every efficiency and flow off by a normal `sigma_pct` percent."""
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
    """Settled N1, N2 and EGT (..., 3) at `inputs` (..., 9), the virtual engine's.

    Raises `ModelError` naming the condition that does not converge.
    """
    return _business_jet().outputs(inputs)[..., :3]


@lru_cache(maxsize=1)
def _business_jet() -> VirtualEngine:
    """Built once: a replay asks for one row at a time."""
    return VirtualEngine("business_jet")
