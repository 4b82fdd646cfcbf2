"""Compute the control's tables from the engine that it controls.

Schedules and gains come from the running line at sea level static: the steady `Wf/Ps3` with
margins above and below, and a governor that cancels the rotors' own time constants, which follow
from the eigenvalues of the engine linearised at constant fuel.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from narxcal.atmosphere import P0_PA, T0_K
from narxcal.support.arrays import FloatArray
from narxcal.support.compiled import compiled
from narxcal.turbofan.cycle import POSITIONS, Running, Stations
from narxcal.turbofan.design import Preset
from narxcal.turbofan.fadec import FadecParameters, governor, schedules
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
    lags = np.array([linearised(machine, body, condition, x).lags_s for condition, x in pairs])
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
        topping_limit=np.array([*preset.limits, np.inf]),
        topping_gain=slopes,
        topping_reset_s=np.full(3, float(lags[-1, 0])),
        fuel_min_kgps=0.0,
        lean_ratio=0.45 * float(ratio.min()),
    )


def _limits(
    preset: Preset, N2c: FloatArray, ratio: FloatArray, margin: float
) -> tuple[FloatArray, FloatArray]:
    """Acceleration and deceleration limits; margins are linear from idle to full speed."""
    share = (N2c - N2c[0]) / (N2c[-1] - N2c[0])
    up = np.interp(share, (0.0, 1.0), preset.accel_margins) * margin
    down = np.interp(share, (0.0, 1.0), preset.decel_margins)
    return schedules(N2c, ratio, accel_margin=up, decel_margin=down)


def _topping_gains(fuel: FloatArray, N2c: FloatArray, stations: FloatArray) -> FloatArray:
    """Fuel per unit of N2 (%), T45 (K) and Ps3 (Pa) along the top of the line."""
    T45 = stations[:, Stations._fields.index("T45")]
    P3 = stations[:, Stations._fields.index("P3")]
    top = [float(x[-1] - x[-4]) for x in (N2c, T45, P3)]
    return _TOPPING_SHARE * 4.0 * float(fuel[-1] - fuel[-4]) / np.array(top)


class Linear(NamedTuple):
    """The engine about a steady point, for small changes of fuel.

    `lags_s`: time constants of the rotors, slow and fast. `overshoot`: the response of T45 at
    constant rotor speeds over its final response.
    """

    lags_s: tuple[float, float]
    overshoot: float


def linearised(machine: Machine, body: Body, condition: FloatArray, x: FloatArray) -> Linear:
    """Linearise by central differences of both rotors' rates and T45, by speeds and fuel.

    With `dn/dt = A n + b w` and `T = c n + d w` the final response to fuel is `d - c A^-1 b`.
    """
    inertia = np.array([body.inertia1_J, body.inertia2_J])

    def changes(at: FloatArray) -> FloatArray:
        powers = _powers(machine, condition, x[:POSITIONS], at)
        return np.array([*(powers[:2] / (inertia * at[:2])), powers[2]])

    at, step = np.array([condition[N1], *x[POSITIONS:]]), 1e-4
    columns = [(changes(at + step * e) - changes(at - step * e)) / (2 * step) for e in np.eye(3)]
    slopes = np.column_stack(columns)
    values = np.linalg.eigvals(slopes[:2, :2])
    fast, slow = sorted(float(-1.0 / value.real) for value in values)
    final = slopes[2, 2] - slopes[2, :2] @ np.linalg.solve(slopes[:2, :2], slopes[:2, 2])
    return Linear((slow, fast), float(slopes[2, 2] / final))


@compiled
def _powers(
    machine: Machine, condition: FloatArray, positions: FloatArray, at: FloatArray
) -> FloatArray:
    """Surplus powers of both rotors in W and T45 in K at speeds and fuel `at`, relative."""
    air = inlet_air(machine, condition)
    fuel = machine.fuel_unit_kgps * at[2]
    run = Running(at[0], at[1], fuel, condition[BLEED], condition[OFFTAKE_W], 0.0, 0.0)
    engine = (machine.path, machine.health)
    stations, _ = solve(engine, air, run, positions.copy(), np.zeros((POSITIONS, POSITIONS)))
    return np.array([stations.power1_W, stations.power2_W, stations.T45])
