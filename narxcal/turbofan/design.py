"""Size a gas path from its design point, the two engines sized in this way, and their control.

The cycle is computed once, forwards, at sea level static on a standard day; areas, capacities
and the turbines' pressure ratios follow from the flows and the power balances (Saravanamuttoo,
Rogers & Cohen, chapter 3). The off-design solution at the same conditions is then this point.

Thrust, bypass and pressure ratio are those of the class, and so is the fuel flow at the four
settings of the landing and take-off cycle: JT15D-4 (1PW036) and CFM56-5B4/3 (8CM055) of the ICAO
emissions databank, as in OpenAP 2.6.2. The numbers of the maps were fitted to these fuel flows, to
an idle of the class and to the time constants of NASA's AGTF30 (`python -m
eval.benchmarks.virtual_engine` of 2f9145a prints the table); they are not those of any maker's
engine.

Schedules and gains of the control come from the running line at sea level static: the steady
`Wf/Ps3` with margins above and below, and a governor that cancels the rotors' own time constants,
which follow from the eigenvalues of the engine linearised at constant fuel.
"""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from importlib.resources import files

import numpy as np
from pydantic import TypeAdapter
from scipy.optimize import brentq

from narxcal.atmosphere import P0_PA, T0_K
from narxcal.support.arrays import FloatArray
from narxcal.support.compiled import compiled
from narxcal.support.errors import ConfigError
from narxcal.turbofan.cycle import POSITIONS, GasPath, Running, Stations, reynolds_factor
from narxcal.turbofan.fadec import FadecParameters, governor
from narxcal.turbofan.gas import (
    Air,
    burnt_enthalpy,
    capacity,
    enthalpy,
    fan_face,
    isentropic_temperature,
    temperature_at_enthalpy,
)
from narxcal.turbofan.lever import Ratings
from narxcal.turbofan.maps import BACKBONE, CompressorMap, TurbineMap
from narxcal.turbofan.solve import (
    BLEED,
    CONDITIONS,
    N1,
    OFFTAKE_W,
    STATIC_K,
    STATIC_PA,
    Line,
    Machine,
    inlet_air,
    solve,
    steady_points,
)
from narxcal.turbofan.transient import Body


@dataclass(frozen=True)
class DesignPoint:
    """Cycle at sea level static, standard day, maximum power, without bleed and offtake."""

    flow_kgps: float
    bypass_ratio: float
    fan_pressure_ratio: float
    lpc_pressure_ratio: float
    hpc_pressure_ratio: float
    T4_K: float
    fan_efficiency: float
    lpc_efficiency: float
    hpc_efficiency: float
    hpt_efficiency: float
    lpt_efficiency: float
    recovery: float = 0.995


@dataclass(frozen=True)
class Closed:
    """A sized gas path, and its fuel flow and map positions at the design point."""

    path: GasPath
    fuel_kgps: float
    positions: tuple[float, float, float, float, float]


def close(point: DesignPoint, shape: GasPath) -> Closed:
    """Fill in the sizes of `shape`, whose exponents, losses and cooling shares are kept."""
    static = (T0_K, P0_PA, 0.0)
    air = Air(*static, *fan_face(*static, point.recovery))
    re = float(reynolds_factor(shape.reynolds_loss, air))
    core = point.flow_kgps / (1.0 + point.bypass_ratio)
    maps, heat, (T21, T3) = _compressors(point, shape, air, re)
    P3 = air.P2_Pa * point.lpc_pressure_ratio * point.hpc_pressure_ratio
    fan_work, lpc_work, hpc_work = heat
    fuel, far4 = _fuel(point, shape, T3, core)
    h3, P4 = enthalpy(T3, 0.0), P3 * (1.0 - shape.burner_loss)
    vanes, rotor = shape.vane_cooling * core, shape.rotor_cooling * core
    W31 = core - vanes - rotor
    W41, far41 = W31 + fuel + vanes, fuel / (W31 + vanes)
    h4 = burnt_enthalpy(h3, far4, shape.burner_efficiency)
    h41 = ((W31 + fuel) * h4 + vanes * h3) / W41
    need = core * hpc_work / shape.mechanical_efficiency / W41
    hpt, P45, h45 = _turbine((h41, far41, P4, W41), need, (point.hpt_efficiency, re), shape.hpt)
    W45, far45 = W41 + rotor, fuel / (W31 + vanes + rotor)
    h45 = (W41 * h45 + rotor * h3) / W45
    need = (point.flow_kgps - core) * fan_work + core * lpc_work
    need /= shape.mechanical_efficiency * W45
    lpt, P5, h5 = _turbine((h45, far45, P45, W45), need, (point.lpt_efficiency, re), shape.lpt)
    T5 = temperature_at_enthalpy(h5, far45, 800.0)
    P8 = P5 * (1.0 - shape.core_duct_loss)
    P18 = air.P2_Pa * point.fan_pressure_ratio * (1.0 - shape.bypass_duct_loss)
    T13 = temperature_at_enthalpy(enthalpy(air.T2_K, 0.0) + fan_work, 0.0, 330.0)
    path = shape._replace(
        fan=maps[0], lpc=maps[1], hpc=maps[2], hpt=hpt, lpt=lpt,
        hpc_reference_K=T21,
        core_area_m2=_area(W45, T5, far45, P8),
        bypass_area_m2=_area(point.flow_kgps - core, T13, 0.0, P18),
    )  # fmt: skip
    at = (BACKBONE, BACKBONE, BACKBONE, hpt.pressure_ratio, lpt.pressure_ratio)
    return Closed(path, fuel, at)


def _compressors(
    point: DesignPoint, shape: GasPath, air: Air, re: float
) -> tuple[list[CompressorMap], list[float], tuple[float, float]]:
    """Scale the three maps; their specific work in J/kg; temperatures behind the last two."""
    core = point.flow_kgps / (1.0 + point.bypass_ratio)
    T21, lpc_work = _work(air.T2_K, point.lpc_pressure_ratio, point.lpc_efficiency * re)
    T3, hpc_work = _work(T21, point.hpc_pressure_ratio, point.hpc_efficiency * re)
    _, fan_work = _work(air.T2_K, point.fan_pressure_ratio, point.fan_efficiency * re)
    P21 = air.P2_Pa * point.lpc_pressure_ratio
    rows = (
        (shape.fan, point.flow_kgps - core, air.T2_K, air.P2_Pa, point.fan_pressure_ratio),
        (shape.lpc, core, air.T2_K, air.P2_Pa, point.lpc_pressure_ratio),
        (shape.hpc, core, T21, P21, point.hpc_pressure_ratio),
    )
    efficiencies = (point.fan_efficiency, point.lpc_efficiency, point.hpc_efficiency)
    maps = [
        chart._replace(
            flow_kgps=flow * (T / T0_K) ** 0.5 / (P / P0_PA),
            pressure_ratio=ratio,
            efficiency=efficiency,
        )
        for (chart, flow, T, P, ratio), efficiency in zip(rows, efficiencies, strict=True)
    ]
    return maps, [fan_work, lpc_work, hpc_work], (T21, T3)


def _work(temperature: float, ratio: float, efficiency: float) -> tuple[float, float]:
    before = enthalpy(temperature, 0.0)
    ideal = enthalpy(isentropic_temperature(temperature, 0.0, ratio), 0.0)
    work = (ideal - before) / efficiency
    return temperature_at_enthalpy(before + work, 0.0, temperature * ratio**0.3), work


def _fuel(point: DesignPoint, shape: GasPath, T3: float, core: float) -> tuple[float, float]:
    """Fuel flow in kg/s, and its ratio to the burner's air, that gives the design T4."""
    h3 = enthalpy(T3, 0.0)

    def excess(far: float) -> float:
        h4 = burnt_enthalpy(h3, far, shape.burner_efficiency)
        return float(temperature_at_enthalpy(h4, far, point.T4_K)) - point.T4_K

    far4 = float(brentq(excess, 1e-4, 0.06, xtol=1e-14))
    return far4 * core * (1.0 - shape.vane_cooling - shape.rotor_cooling), far4


def _turbine(
    entry: tuple[float, float, float, float],
    work: float,
    efficiency: tuple[float, float],
    shape: TurbineMap,
) -> tuple[TurbineMap, float, float]:
    """Size a turbine that gives `work` J/kg; its exit pressure and enthalpy before mixing."""
    h, far, P, W = entry
    T = temperature_at_enthalpy(h, far, 1200.0)
    ideal = work / (efficiency[0] * efficiency[1])

    def excess(ratio: float) -> float:
        return h - enthalpy(isentropic_temperature(T, far, 1.0 / ratio), far) - ideal

    ratio = float(brentq(excess, 1.001, 40.0, xtol=1e-14))
    # Efficiency is stated without the Reynolds factor, which the cycle applies.
    sized = shape._replace(
        capacity=W * T**0.5 / P,
        pressure_ratio=ratio,
        efficiency=efficiency[0],
        work_speed=1.0 / ideal**0.5,
    )
    return sized, P / ratio, h - work


def _area(flow: float, temperature: float, far: float, pressure: float) -> float:
    per_area = capacity(temperature, far, pressure / P0_PA)
    return float(flow * temperature**0.5 / pressure / per_area)


@dataclass(frozen=True, kw_only=True)
class Preset:
    """All numbers of one engine; `bleed` are shares of the HPC flow, `inertia` in kg m^2.

    `speed_pct` is what N1 and N2 read at the design point, `speed_radps` how fast that is.
    Times are those at the design point. `accel_margins` and `decel_margins` are the shares of
    steady fuel that the schedules add and take away, at idle and at full speed. `limits` lie beyond
    all steady points, so that the engine settles where the steady-state model says.
    """

    name: str
    title: str
    point: DesignPoint
    shape: GasPath
    ratings: Ratings
    speed_pct: tuple[float, float]
    speed_radps: tuple[float, float]
    inertia: tuple[float, float]
    accel_margins: tuple[float, float]
    decel_margins: tuple[float, float]
    clearance_pK: float  # share of HPT efficiency lost per K by which the casing trails
    limits: tuple[float, float]  # of N2 in %, T45 in K
    ecs_bleed: float = 0.025
    nai_bleed: float = 0.022
    wai_bleed: float = 0.02
    offtake_W: float = 10e3
    probe_tau_s: float = 0.70  # AGTF30's sensor of T45
    metal_tau_s: float = 10.0  # AGTF30 with T-MATS's heat soak: 12 s
    metal_share: float = 0.055  # of the gas's heat capacity flow, at design
    casing_tau_s: float = 80.0  # discs and casings 30 to 300 s, unverified
    governor_lag_s: float = 0.22  # valve, lines, burner, sensor and step together


_TABLES = tomllib.loads(files(__package__).joinpath("engines.toml").read_text("utf-8"))
PRESETS = {
    name: TypeAdapter(Preset).validate_python({"name": name, **table})
    for name, table in _TABLES.items()
}


def preset(name: str) -> Preset:
    """Return the preset called `name`; raises `ConfigError` for an unknown one."""
    if name not in PRESETS:
        raise ConfigError(f"unknown engine '{name}'", hint=f"Known engines: {', '.join(PRESETS)}")
    return PRESETS[name]


# --- control ---

_SCHEDULED = (0.22, 1.08)  # relative N1 between which the tables are made
_POINTS = 24
_TOPPING_SHARE = 0.25  # of the slope of fuel: toppings are stable with all lags in the loop


def control(
    preset: Preset, machine: Machine, line: Line, body: Body, margin: float
) -> FadecParameters:
    """Design the control of `preset`; `margin` multiplies its acceleration margins."""
    n1 = np.linspace(*_SCHEDULED, _POINTS)
    conditions = np.zeros((_POINTS, CONDITIONS))
    conditions[:, STATIC_K], conditions[:, STATIC_PA] = T0_K, P0_PA
    conditions[:, N1], conditions[:, OFFTAKE_W] = n1, preset.offtake_W
    unknowns, stations, _ = steady_points(machine, line, conditions)
    fuel = machine.fuel_unit_kgps * unknowns[:, -1]
    N1c, N2c = n1 * preset.speed_pct[0], unknowns[:, POSITIONS] * preset.speed_pct[1]
    ratio = fuel / stations[:, Stations._fields.index("P3")]
    pairs = zip(conditions, unknowns, strict=True)
    lags = np.array([rotor_lags_s(machine, body, condition, x) for condition, x in pairs])
    gain, reset, lead = governor(N1c, fuel, (lags[:, 0], lags[:, 1], preset.governor_lag_s))
    accel, decel = _limits(preset, N2c, ratio, margin)
    slopes = _topping_gains(fuel, N2c, stations)
    return FadecParameters(
        governor_N1c_pct=N1c,
        governor_gain=gain,
        governor_reset_s=reset,
        governor_lead_s=lead,
        schedule_N2c_pct=N2c,
        accel_ratio=accel,
        decel_ratio=decel,
        topping_limit=np.array(preset.limits),
        topping_gain=slopes,
        topping_reset_s=np.full(2, float(lags[-1, 0])),
        lean_ratio=0.45 * float(ratio.min()),
    )


def _limits(
    preset: Preset, N2c: FloatArray, ratio: FloatArray, margin: float
) -> tuple[FloatArray, FloatArray]:
    """Acceleration and deceleration limits about the steady line `ratio` over `N2c`.

    Margins are shares of the steady fuel that may be added or taken away, linear from idle to full
    speed.
    """
    share = (N2c - N2c[0]) / (N2c[-1] - N2c[0])
    up = np.interp(share, (0.0, 1.0), preset.accel_margins) * margin
    down = np.interp(share, (0.0, 1.0), preset.decel_margins)
    return (1.0 + up) * ratio, (1.0 - down) * ratio


def _topping_gains(fuel: FloatArray, N2c: FloatArray, stations: FloatArray) -> FloatArray:
    """Fuel per unit of N2 (%) and T45 (K) along the top of the line."""
    T45 = stations[:, Stations._fields.index("T45")]
    top = [float(x[-1] - x[-4]) for x in (N2c, T45)]
    return _TOPPING_SHARE * 4.0 * float(fuel[-1] - fuel[-4]) / np.array(top)


def rotor_lags_s(
    machine: Machine, body: Body, condition: FloatArray, x: FloatArray
) -> tuple[float, float]:
    """Time constants of the rotors, slow and fast, about a steady point at constant fuel."""
    inertia = np.array([body.inertia1_J, body.inertia2_J])

    def rates(speeds: FloatArray) -> FloatArray:
        at = np.array([*speeds, x[-1]])
        return _powers(machine, condition, x[:POSITIONS], at) / (inertia * speeds)

    at, step = np.array([condition[N1], x[POSITIONS]]), 1e-4
    slopes = [(rates(at + step * e) - rates(at - step * e)) / (2 * step) for e in np.eye(2)]
    values = np.linalg.eigvals(np.column_stack(slopes))
    fast, slow = sorted(float(-1.0 / value.real) for value in values)
    return slow, fast


@compiled
def _powers(
    machine: Machine, condition: FloatArray, positions: FloatArray, at: FloatArray
) -> FloatArray:
    """Surplus powers of both rotors in W at speeds and fuel `at`, relative."""
    air = inlet_air(machine, condition)
    fuel = machine.fuel_unit_kgps * at[2]
    run = Running(at[0], at[1], fuel, condition[BLEED], condition[OFFTAKE_W], 0.0, 0.0)
    engine = (machine.path, machine.health)
    stations, _ = solve(engine, air, run, positions.copy(), np.zeros((POSITIONS, POSITIONS)))
    return np.array([stations.power1_W, stations.power2_W])
