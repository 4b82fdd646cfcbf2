"""The engine in time: rotors, metal, probe and control round the gas path.

    J dn/dt = surplus power / n        with J = I omega_design^2, n relative to design

The rotors are stepped by the two-step Adams-Bashforth formula, probes and sensors by the closed
form of a lag behind a straight line, and the gas path is solved fully at each step. A step is one
cycle of the digital control, 16 ms at most (FACTS A6: 15 ms), whatever the sampling of the log;
inputs are held from sample to sample.

The metal of the hot section is one node that takes heat out of the gas between burner and
turbine, `Q = h A (T41 - T_metal)`, `h A` with the 0.8 power of flow (turbulent heat transfer;
T-MATS uses the same, FACTS A4). The casing follows the metal slowly; while it is the colder of the
two, tip clearances are open and cost efficiency. The ITT probe lags by a time constant that goes
with flow^-0.6 (FACTS A3).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from narxcal.support.arrays import FloatArray
from narxcal.support.compiled import compiled, lagged, ramp_lagged
from narxcal.turbofan import fadec, fuel_valve
from narxcal.turbofan.cycle import HPC, Running, Stations
from narxcal.turbofan.fadec import FadecParameters, Sensed
from narxcal.turbofan.fuel_valve import METERED, FuelValveParameters
from narxcal.turbofan.gas import intake
from narxcal.turbofan.solve import BLEED, MACH, OFFTAKE_W, STATIC_K, STATIC_PA, Machine, solved

LONGEST_STEP_S = 0.016
COLUMNS = (
    "N1_pct", "N2_pct", "EGT_C", "FF_kgph", "FN_kN", "FPR", "EPR",
    "FG_kN", "W2_kgps", "T45_K", "P3_kPa", "metal_K", "casing_K", "hpc_angle", "limiter",
)  # fmt: skip
_WIDTH = len(COLUMNS)
LEAST_FLOW = 0.02  # of the design flow, below which powers of flow are held


class Body(NamedTuple):
    """What stores energy, and what senses."""

    inertia1_J: float  # I omega^2 at design speed
    inertia2_J: float
    N1_design_pct: float
    N2_design_pct: float
    metal_WpK: float  # h A at design flow
    metal_tau_s: float  # heat capacity over h A, at design flow
    casing_tau_s: float
    clearance_pK: float  # share of HPT efficiency per K by which the casing trails
    flow_kgps: float  # W45 at design, the unit of the two powers of flow
    probe_tau_s: float
    speed_sensor_tau_s: float = 0.02
    pressure_sensor_tau_s: float = 0.04
    # Inertia felt while speeding up, over that felt while slowing down.
    asymmetry: float = 1.0
    # Exponent of `sqrt(theta2) / delta2` by which inertias appear larger in thin air.
    thin_air: float = 0.0


class State(NamedTuple):
    """What the engine remembers from step to step; arrays are changed in place."""

    rotors: FloatArray  # n1, n2, and their rates a step ago
    metal: FloatArray  # metal K, casing K, heat flow W, clearance loss
    sensed: FloatArray  # N1 %, N2 %, P3 Pa, T45 K as sensors and probe give them
    felt: FloatArray  # the same as they were a step ago
    positions: FloatArray
    inverse: FloatArray
    fadec: FloatArray
    valve: FloatArray


class Plant(NamedTuple):
    """The constants of everything that moves."""

    machine: Machine
    body: Body
    fadec: FadecParameters
    valve: FuelValveParameters


@compiled
def steps_per_sample(dt_s: float) -> int:
    """How many steps of the engine one sample of the log takes."""
    return max(1, math.ceil(dt_s / LONGEST_STEP_S - 1e-9))


@compiled
def _sense(body: Body, state: State, stations: Stations, dt_s: float) -> None:
    """Bring sensors and probe to now, `dt_s` after the last time."""
    flow = max(stations.W45 / body.flow_kgps, LEAST_FLOW)
    now = (
        body.N1_design_pct * state.rotors[0],
        body.N2_design_pct * state.rotors[1],
        stations.P3,
        stations.T45,
    )
    lags = (
        body.speed_sensor_tau_s,
        body.speed_sensor_tau_s,
        body.pressure_sensor_tau_s,
        body.probe_tau_s / flow**0.6,
    )
    sensed, felt = state.sensed, state.felt
    for i in range(4):
        sensed[i] = ramp_lagged(sensed[i], (felt[i], now[i]), lags[i], dt_s)
        felt[i] = now[i]


@compiled
def soak(body: Body, metal: FloatArray, stations: Stations, dt_s: float) -> None:
    """Heat metal and casing for `dt_s`; the heat flow and the clearances they leave."""
    flow = max(stations.W45 / body.flow_kgps, LEAST_FLOW) ** 0.8
    metal[0] = lagged(metal[0], stations.T41, body.metal_tau_s / flow, dt_s)
    metal[1] = lagged(metal[1], metal[0], body.casing_tau_s, dt_s)
    metal[2] = body.metal_WpK * flow * (stations.T41 - metal[0])
    metal[3] = body.clearance_pK * max(metal[0] - metal[1], 0.0)


@compiled
def spin(body: Body, rotors: FloatArray, stations: Stations, weight: float, dt_s: float) -> None:
    """Advance both rotors by `dt_s`; `weight` multiplies their inertia."""
    powers = (stations.power1_W, stations.power2_W)
    inertias = (body.inertia1_J, body.inertia2_J)
    for i in range(2):
        felt = body.asymmetry if powers[i] > 0.0 else 1.0
        rate = powers[i] / (inertias[i] * weight * felt * rotors[i])
        rotors[i] = max(rotors[i] + dt_s * (1.5 * rate - 0.5 * rotors[2 + i]), 0.02)
        rotors[2 + i] = rate


@compiled
def _row(plant: Plant, state: State, stations: Stations, air_Pa: float, row: FloatArray) -> None:
    """Write one sample of all `COLUMNS` but the last."""
    row[0] = plant.body.N1_design_pct * state.rotors[0]
    row[1] = plant.body.N2_design_pct * state.rotors[1]
    row[2] = state.sensed[3] - 273.15
    row[3] = 3600.0 * state.valve[METERED]
    row[4] = 1e-3 * stations.net_N
    row[5] = stations.P13 / air_Pa
    row[6] = stations.P5 / air_Pa
    row[7] = 1e-3 * stations.gross_N
    row[8] = stations.W2
    row[9] = stations.T45
    row[10] = 1e-3 * stations.P3
    row[11] = state.metal[0]
    row[12] = state.metal[1]
    row[13] = state.positions[HPC]


@compiled
def run(
    plant: Plant, state: State, commands: FloatArray, conditions: FloatArray, dt_s: float
) -> tuple[FloatArray, int]:
    """Run through `conditions` (time, 6) at the N1 `commands` (time,) in %, from `state`.

    Each sample shows the engine as the conditions of that sample find it, before it moves on.
    Returns all `COLUMNS` (time, 15) and the number of samples that were solved: where that is
    less than all, the next sample did not converge.
    """
    machine, body = plant.machine, plant.body
    engine = (machine.path, machine.health)
    count = steps_per_sample(dt_s)
    step_s = dt_s / count
    rows = np.empty((len(commands), _WIDTH))
    fuel = state.valve[fuel_valve.BURNED]
    for k in range(len(commands)):
        c = conditions[k]
        air = intake(c[STATIC_K], c[STATIC_PA], c[MACH], machine.recovery)
        stretch = math.sqrt(air.T2_K / 288.15) * 101325.0 / air.P2_Pa
        weight = stretch**body.thin_air
        for s in range(count):
            at = Running(
                state.rotors[0], state.rotors[1], fuel, c[BLEED], c[OFFTAKE_W],
                state.metal[2], state.metal[3],
            )  # fmt: skip
            stations, good = solved(engine, air, at, state.positions, state.inverse)
            if not good:
                return rows, k
            _sense(body, state, stations, step_s)
            if s == 0:
                _row(plant, state, stations, air.P2_Pa, rows[k])
            sensed = Sensed(
                commands[k], state.sensed[0], state.sensed[1], state.sensed[3], state.sensed[2],
                air.P2_Pa, air.T2_K,
            )  # fmt: skip
            demand, rows[k, _WIDTH - 1] = fadec.step(plant.fadec, state.fadec, sensed, step_s)
            fuel = fuel_valve.step(plant.valve, state.valve, demand, step_s)
            soak(body, state.metal, stations, step_s)
            spin(body, state.rotors, stations, weight, step_s)
    return rows, len(commands)
