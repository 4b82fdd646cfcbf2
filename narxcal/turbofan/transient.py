"""The engine over time: rotors, metal, sensors and control around the gas path.

    J dn/dt = surplus power / n        with J = I omega_design^2, n relative to design

The rotors are stepped by the two-step Adams-Bashforth formula, probes and sensors by the exact
response of a lag to a ramp, and the gas path is solved fully at each step. A step is one cycle of
the digital control, 16 ms at most (AGTF30: 15 ms), whatever the sampling of the log; inputs are
constant from sample to sample.

The metal of the hot section is one node that takes heat out of the gas between burner and
turbine, `Q = h A (T41 - T_metal)`, `h A` with the 0.8 power of flow (turbulent heat transfer;
T-MATS uses the same). The casing follows the metal slowly; while it is colder, tip
clearances are open and cost efficiency. The time constant of the ITT probe is proportional to
flow^-0.6 (bayonet probes; unverified).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from narxcal.atmosphere import P0_PA, T0_K
from narxcal.support.arrays import FloatArray
from narxcal.support.compiled import compiled, lagged, ramp_lagged
from narxcal.turbofan.cycle import HPC, Running, Stations
from narxcal.turbofan.fadec import (
    BURNED,
    METERED,
    FadecParameters,
    FuelValveParameters,
    Sensed,
    control_step,
    valve_step,
)
from narxcal.turbofan.solve import BLEED, OFFTAKE_W, Machine, inlet_air, solve

LONGEST_STEP_S = 0.016
COLUMNS = (
    "N1_pct", "N2_pct", "EGT_C", "FF_kgph", "FN_kN", "FPR", "EPR",
    "FG_kN", "W2_kgps", "T45_K", "P3_kPa", "metal_K", "casing_K", "hpc_angle", "limiter",
)  # fmt: skip
_WIDTH = len(COLUMNS)
LEAST_FLOW = 0.02  # of the design flow, below which powers of the flow are constant


class Body(NamedTuple):
    """Constants of rotors, metal and sensors."""

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
    # Effective inertia during acceleration over that during deceleration.
    asymmetry: float = 1.0
    # Exponent of `sqrt(theta2) / delta2`, a factor on the inertias in thin air.
    thin_air: float = 0.0


class State(NamedTuple):
    """State of the engine between steps; arrays are changed in place."""

    rotors: FloatArray  # n1, n2, and their rates a step ago
    metal: FloatArray  # metal K, casing K, heat flow W, clearance loss
    sensed: FloatArray  # readings of N1 %, N2 %, P3 Pa, T45 K
    measured: FloatArray  # true values of the same, a step ago
    positions: FloatArray
    inverse: FloatArray
    fadec: FloatArray
    valve: FloatArray


class Plant(NamedTuple):
    """Constants of engine, control and fuel system."""

    machine: Machine
    body: Body
    fadec: FadecParameters
    valve: FuelValveParameters


@compiled
def steps_per_sample(dt_s: float) -> int:
    return max(1, math.ceil(dt_s / LONGEST_STEP_S - 1e-9))


@compiled
def _read_sensors(body: Body, state: State, stations: Stations, dt_s: float) -> None:
    """Advance sensors and probe by `dt_s`."""
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
    sensed, measured = state.sensed, state.measured
    for i in range(4):
        sensed[i] = ramp_lagged(sensed[i], (measured[i], now[i]), lags[i], dt_s)
        measured[i] = now[i]


@compiled
def heat_metal(body: Body, metal: FloatArray, stations: Stations, dt_s: float) -> None:
    """Advance metal and casing by `dt_s`, and update heat flow and clearance loss."""
    flow = max(stations.W45 / body.flow_kgps, LEAST_FLOW) ** 0.8
    metal[0] = lagged(metal[0], stations.T41, body.metal_tau_s / flow, dt_s)
    metal[1] = lagged(metal[1], metal[0], body.casing_tau_s, dt_s)
    metal[2] = body.metal_WpK * flow * (stations.T41 - metal[0])
    metal[3] = body.clearance_pK * max(metal[0] - metal[1], 0.0)


@compiled
def turn_rotors(
    body: Body, rotors: FloatArray, stations: Stations, weight: float, dt_s: float
) -> None:
    """Advance both rotors by `dt_s`; `weight` multiplies their inertia."""
    powers = (stations.power1_W, stations.power2_W)
    inertias = (body.inertia1_J, body.inertia2_J)
    for i in range(2):
        factor = body.asymmetry if powers[i] > 0.0 else 1.0
        rate = powers[i] / (inertias[i] * weight * factor * rotors[i])
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
    """Simulate `conditions` (time, 6) at the commanded N1 `commands` (time,) in %, from `state`.

    Each sample is the state of the engine at the beginning of its interval. Returns all `COLUMNS`
    (time, 15) and the number of samples solved: where that is less than all, the next sample did
    not converge.
    """
    machine, body = plant.machine, plant.body
    engine = (machine.path, machine.health)
    count = steps_per_sample(dt_s)
    step_s = dt_s / count
    rows = np.empty((len(commands), _WIDTH))
    fuel = state.valve[BURNED]
    for k in range(len(commands)):
        c = conditions[k]
        air = inlet_air(machine, c)
        stretch = math.sqrt(air.T2_K / T0_K) * P0_PA / air.P2_Pa
        weight = stretch**body.thin_air
        for s in range(count):
            at = Running(
                state.rotors[0], state.rotors[1], fuel, c[BLEED], c[OFFTAKE_W],
                state.metal[2], state.metal[3],
            )  # fmt: skip
            stations, good = solve(engine, air, at, state.positions, state.inverse)
            if not good:
                return rows, k
            _read_sensors(body, state, stations, step_s)
            if s == 0:
                _row(plant, state, stations, air.P2_Pa, rows[k])
            sensed = Sensed(
                commands[k], state.sensed[0], state.sensed[1], state.sensed[3], state.sensed[2],
                air.P2_Pa, air.T2_K,
            )  # fmt: skip
            demand, rows[k, _WIDTH - 1] = control_step(plant.fadec, state.fadec, sensed, step_s)
            fuel = valve_step(plant.valve, state.valve, demand, step_s)
            heat_metal(body, state.metal, stations, step_s)
            turn_rotors(body, state.rotors, stations, weight, step_s)
    return rows, len(commands)
