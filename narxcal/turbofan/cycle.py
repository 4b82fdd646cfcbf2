"""The gas path: all components at given speeds, fuel flow and map positions.

Stations after SAE AS755: 0 ambient, 2 fan face, 13 bypass behind the fan, 21 core behind fan root
and low-pressure compressor, 3 compressor exit, 4 burner exit, 41 rotor inlet of the high-pressure
turbine, 45 inlet of the low-pressure turbine (where ITT or EGT is read), 5 its exit, 8 core
nozzle, 18 bypass nozzle.

Five *map positions* are unknown: the angles of the three compressor maps and the pressure ratios
of the two turbines. They follow from five balances of flow: bypass nozzle, high-pressure
compressor, both turbines, core nozzle. Power balances make the spools accelerate (`power`).
"""

from __future__ import annotations

from typing import NamedTuple

from narxcal.support.arrays import FloatArray
from narxcal.support.compiled import compiled
from narxcal.turbofan.gas import (
    Air,
    burnt_enthalpy,
    delta,
    enthalpy,
    isentropic_temperature,
    jet,
    temperature_at_enthalpy,
    theta,
)
from narxcal.turbofan.maps import (
    CompressorMap,
    TurbineMap,
    compressor,
    turbine_capacity,
    turbine_efficiency,
)


class GasPath(NamedTuple):
    """Constants of an engine's gas path. Shares are of the flow that enters the compressor."""

    fan: CompressorMap
    lpc: CompressorMap
    hpc: CompressorMap
    hpt: TurbineMap
    lpt: TurbineMap
    hpc_reference_K: float = 0.0  # HPC inlet temperature at the design point
    core_area_m2: float = 0.0  # sized at the design point, as are the two next to it
    bypass_area_m2: float = 0.0
    burner_efficiency: float = 0.995
    burner_loss: float = 0.05
    core_duct_loss: float = 0.01
    bypass_duct_loss: float = 0.015
    vane_cooling: float = 0.05  # HPC exit air that does work in the HPT
    rotor_cooling: float = 0.04  # HPC exit air that returns behind the HPT
    mechanical_efficiency: float = 0.99
    thrust_coefficient: float = 0.985
    handling_bleed: float = 0.0  # share of the LPC flow dumped at low speed
    handling_shut: float = 0.9  # relative corrected N2 above which the handling bleed is shut
    reynolds_loss: float = 0.012  # efficiency lost where the Reynolds index is zero


class Running(NamedTuple):
    """Inputs of the gas path: relative speeds (1 at design), fuel, bleed and heat taken off."""

    n1: float
    n2: float
    fuel_kgps: float
    bleed: float  # customer bleed, share of the HPC flow
    offtake_W: float  # shaft power taken from the HP spool
    soak_W: float  # heat flow from the gas into the metal of the hot section
    clearance: float  # loss of HPT efficiency by open tip clearances


class Health(NamedTuple):
    """Multipliers of efficiency and flow of the components; 1 as built."""

    fan_efficiency: float = 1.0
    hpc_efficiency: float = 1.0
    hpc_flow: float = 1.0
    hpt_efficiency: float = 1.0
    hpt_area: float = 1.0
    lpt_efficiency: float = 1.0


class Stations(NamedTuple):
    """The solved gas path: K, Pa, kg/s, W, N."""

    W2: float
    W13: float
    W21: float
    W25: float
    W4: float
    W45: float
    far4: float
    far45: float
    T13: float
    T21: float
    T3: float
    T4: float
    T41: float
    T45: float
    T5: float
    P13: float
    P21: float
    P3: float
    P45: float
    P5: float
    fan_W: float
    lpc_W: float
    hpc_W: float
    hpt_W: float
    lpt_W: float
    power1_W: float  # surplus on the low-pressure spool
    power2_W: float
    gross_N: float
    net_N: float


FAN, LPC, HPC, HPT, LPT = range(5)  # indices in the vector of map positions
BYPASS_FLOW, HPC_FLOW, HPT_FLOW, LPT_FLOW, CORE_FLOW = range(5)  # and in that of the balances
POSITIONS = 5


@compiled
def _compress(temperature: float, ratio: float, efficiency: float) -> tuple[float, float]:
    """Exit temperature of air in K, and the work in J/kg; below a ratio of 1 it is a turbine."""
    ideal = isentropic_temperature(temperature, 0.0, ratio)
    before = enthalpy(temperature, 0.0)
    rise = enthalpy(ideal, 0.0) - before
    work = rise / efficiency if ratio > 1.0 else rise * efficiency
    return temperature_at_enthalpy(before + work, 0.0, ideal), work


@compiled
def reynolds_factor(loss: float, air: Air) -> float:
    """Factor on all efficiencies: boundary layers are thicker in thin air.

    Linear in the Reynolds number index `delta / theta^1.25` (Walsh & Fletcher, section 4.3).
    """
    index: float = min(delta(air.P2_Pa) / theta(air.T2_K) ** 1.25, 1.0)
    return 1.0 - loss * (1.0 - index)


@compiled
def handling_bleed(path: GasPath, n2_corrected: float) -> float:
    """Share of the LPC flow dumped: shut above `handling_shut`, wide open at 60 % of that.

    It depends on the corrected speed of the core, which limits the flow: at idle in fast flight
    the fan windmills and delivers more than at the same core speed on the ground.
    """
    opening = (path.handling_shut - n2_corrected) / (0.4 * path.handling_shut)
    opening = min(max(opening, 0.0), 1.0)
    return path.handling_bleed * opening * opening * (3.0 - 2.0 * opening)


class _Cold(NamedTuple):
    """Results of fan and compressors."""

    W13: float
    W21: float
    W25: float
    T13: float
    T21: float
    T3: float
    P13: float
    P21: float
    P3: float
    fan_W: float
    lpc_W: float
    hpc_W: float


class _Hot(NamedTuple):
    """Results of burner and high-pressure turbine."""

    W4: float
    W45: float
    far4: float
    far45: float
    T4: float
    T41: float
    T45: float
    P45: float
    hpt_W: float


@compiled
def gas_path(
    engine: tuple[GasPath, Health], air: Air, run: Running, x: FloatArray, residual: FloatArray
) -> Stations:
    """Compute all stations at map positions `x` (5,); balances of flow go into `residual` (5,).

    Each residual is relative: zero where a component delivers the flow that the next one swallows.
    """
    path = engine[0]
    re = reynolds_factor(path.reynolds_loss, air)
    cold = _cold_section((engine, re), air, run, x, residual)
    hot = _hot_section((engine, re), cold, run, x, residual)
    T5, P5, lpt_W = _low_pressure_turbine((engine, re), hot, run.n1, x, residual)
    P8, P18 = P5 * (1.0 - path.core_duct_loss), cold.P13 * (1.0 - path.bypass_duct_loss)
    core = jet(T5, hot.far45, P8 / air.static_Pa)
    bypass = jet(cold.T13, 0.0, P18 / air.static_Pa)
    passed = core.capacity * path.core_area_m2 * P8 / T5**0.5
    residual[CORE_FLOW] = passed / hot.W45 - 1.0
    passed = bypass.capacity * path.bypass_area_m2 * P18 / cold.T13**0.5
    residual[BYPASS_FLOW] = passed / cold.W13 - 1.0
    momentum = hot.W45 * core.velocity_mps + cold.W13 * bypass.velocity_mps
    gross = path.thrust_coefficient * momentum
    gross += core.pressure_thrust * P8 * path.core_area_m2
    gross += bypass.pressure_thrust * P18 * path.bypass_area_m2
    W2 = cold.W13 + cold.W21
    power1 = path.mechanical_efficiency * lpt_W - cold.fan_W - cold.lpc_W
    power2 = path.mechanical_efficiency * hot.hpt_W - cold.hpc_W - run.offtake_W
    return Stations(
        W2, cold.W13, cold.W21, cold.W25, hot.W4, hot.W45, hot.far4, hot.far45,
        cold.T13, cold.T21, cold.T3, hot.T4, hot.T41, hot.T45, T5,
        cold.P13, cold.P21, cold.P3, hot.P45, P5,
        cold.fan_W, cold.lpc_W, cold.hpc_W, hot.hpt_W, lpt_W, power1, power2,
        gross, gross - W2 * air.velocity_mps,
    )  # fmt: skip


@compiled
def _cold_section(
    build: tuple[tuple[GasPath, Health], float],
    air: Air,
    run: Running,
    x: FloatArray,
    residual: FloatArray,
) -> _Cold:
    """Fan, low-pressure compressor, handling bleed, high-pressure compressor."""
    (path, health), re = build
    root2 = theta(air.T2_K) ** 0.5
    per_flow = delta(air.P2_Pa) / root2
    n1c = run.n1 / root2
    w, fan_ratio, efficiency = compressor(path.fan, n1c, x[FAN])
    W13 = w * per_flow
    T13, fan_work = _compress(air.T2_K, fan_ratio, efficiency * health.fan_efficiency * re)
    w, lpc_ratio, efficiency = compressor(path.lpc, n1c, x[LPC])
    W21 = w * per_flow
    T21, lpc_work = _compress(air.T2_K, lpc_ratio, efficiency * re)
    P21 = lpc_ratio * air.P2_Pa
    root25 = theta(T21) ** 0.5
    n2c = run.n2 * (path.hpc_reference_K / T21) ** 0.5
    W25 = W21 * (1.0 - handling_bleed(path, n2c))
    w, hpc_ratio, efficiency = compressor(path.hpc, n2c, x[HPC])
    residual[HPC_FLOW] = w * health.hpc_flow * delta(P21) / root25 / W25 - 1.0
    T3, hpc_work = _compress(T21, hpc_ratio, efficiency * health.hpc_efficiency * re)
    return _Cold(
        W13, W21, W25, T13, T21, T3, fan_ratio * air.P2_Pa, P21, hpc_ratio * P21,
        W13 * fan_work, W21 * lpc_work, W25 * hpc_work,
    )  # fmt: skip


@compiled
def _hot_section(
    build: tuple[tuple[GasPath, Health], float],
    cold: _Cold,
    run: Running,
    x: FloatArray,
    residual: FloatArray,
) -> _Hot:
    """Burner, cooled vanes, high-pressure turbine, and the rotor's cooling air behind it."""
    (path, health), re = build
    h3 = enthalpy(cold.T3, 0.0)
    vanes, rotor = path.vane_cooling * cold.W25, path.rotor_cooling * cold.W25
    W31 = cold.W25 * (1.0 - run.bleed) - vanes - rotor
    far4 = run.fuel_kgps / W31
    W4 = W31 + run.fuel_kgps
    h4 = burnt_enthalpy(h3, far4, path.burner_efficiency)
    T4 = temperature_at_enthalpy(h4, far4, 1200.0)
    P4 = cold.P3 * (1.0 - path.burner_loss)
    W41, far41 = W4 + vanes, run.fuel_kgps / (W31 + vanes)
    h41 = (W4 * h4 + vanes * h3 - run.soak_W) / W41
    T41 = temperature_at_enthalpy(h41, far41, T4)
    ratio = max(x[HPT], 1.0001)
    capacity = turbine_capacity(path.hpt, x[HPT]) * health.hpt_area
    residual[HPT_FLOW] = capacity * P4 / T41**0.5 / W41 - 1.0
    drop = h41 - enthalpy(isentropic_temperature(T41, far41, 1.0 / ratio), far41)
    efficiency = turbine_efficiency(path.hpt, run.n2, drop) * health.hpt_efficiency * re
    work = drop * efficiency * (1.0 - run.clearance)
    W45, far45 = W41 + rotor, run.fuel_kgps / (W31 + vanes + rotor)
    h45 = (W41 * (h41 - work) + rotor * h3) / W45
    T45 = temperature_at_enthalpy(h45, far45, T41 - work / 1200.0)
    return _Hot(W4, W45, far4, far45, T4, T41, T45, P4 / ratio, W41 * work)


@compiled
def _low_pressure_turbine(
    build: tuple[tuple[GasPath, Health], float],
    hot: _Hot,
    n1: float,
    x: FloatArray,
    residual: FloatArray,
) -> tuple[float, float, float]:
    """Exit temperature and pressure of the low-pressure turbine, and its power."""
    (path, health), re = build
    ratio = max(x[LPT], 1.0001)
    capacity = turbine_capacity(path.lpt, x[LPT])
    residual[LPT_FLOW] = capacity * hot.P45 / hot.T45**0.5 / hot.W45 - 1.0
    h45 = enthalpy(hot.T45, hot.far45)
    drop = h45 - enthalpy(isentropic_temperature(hot.T45, hot.far45, 1.0 / ratio), hot.far45)
    work = drop * turbine_efficiency(path.lpt, n1, drop) * health.lpt_efficiency * re
    T5 = temperature_at_enthalpy(h45 - work, hot.far45, hot.T45 - work / 1200.0)
    return T5, hot.P45 / ratio, hot.W45 * work
