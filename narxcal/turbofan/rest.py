"""Steady states of the gas path, many conditions at once.

Newton starts from the running line at sea level static, looked up at the corrected speed asked
for, with the Jacobian of the nearest point of the line; where that does not converge, the flight
condition is approached in steps, as short as need be. A point that still does not
converge is reported, never filled in.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from narxcal.turbofan.compiled import compiled
from narxcal.turbofan.cycle import POSITIONS
from narxcal.turbofan.intake import SEA_LEVEL_K, SEA_LEVEL_PA, Air, delta, intake, theta
from narxcal.turbofan.lag import table_value
from narxcal.turbofan.solve import UNKNOWN, balances, inverse_jacobian, solved
from narxcal.turbofan.stations import GasPath, Health, Running, Stations

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
STATIC_K, STATIC_PA, MACH, N1, BLEED, OFFTAKE_W, CONDITIONS = range(7)  # columns of a condition
FIELDS = len(Stations._fields)
_LONGEST, _SHORTEST = 0.25, 1.0 / 256.0  # steps, of the way to a condition not reached at once


class Line(NamedTuple):
    """The running line at sea level static.

    Relative N1 (m,), ascending, unknowns (7, m), and inverses (m, 7, 7) of the Jacobians there;
    zero where they are not known.
    """

    n1: FloatArray
    unknowns: FloatArray
    inverses: FloatArray


class Machine(NamedTuple):
    """All that steady states need: constants, health, intake recovery, and the unit of fuel."""

    path: GasPath
    health: Health
    recovery: float
    fuel_unit_kgps: float


@compiled
def _air(machine: Machine, condition: FloatArray) -> Air:
    return intake(condition[STATIC_K], condition[STATIC_PA], condition[MACH], machine.recovery)


@compiled
def _start(
    machine: Machine, line: Line, condition: FloatArray, x: FloatArray, inverse: FloatArray
) -> None:
    """Unknowns on the running line at the corrected speed asked for, taken back to real ones.

    `inverse` is that of the nearest point, likewise: rows of real unknowns per relative balance.
    """
    air = _air(machine, condition)
    root = theta(air.T2_K) ** 0.5
    n1 = condition[N1] / root
    near = 0
    for k in range(len(line.n1)):
        if abs(line.n1[k] - n1) < abs(line.n1[near] - n1):
            near = k
    for i in range(UNKNOWN):
        scale = 1.0
        if i >= POSITIONS:
            scale = root if i == POSITIONS else root * delta(air.P2_Pa)
        x[i] = scale * table_value(n1, line.n1, line.unknowns[i])
        for j in range(UNKNOWN):
            inverse[i, j] = scale * line.inverses[near, i, j]


@compiled
def _reach(
    machine: Machine, line: Line, condition: FloatArray, x: FloatArray
) -> tuple[Stations, bool]:
    """Settle at `condition`: at once, or by walking there from sea level static.

    The walk starts on the line at the same corrected speed; a step that fails is halved.
    """
    here, first, kept = np.empty(CONDITIONS), np.zeros(CONDITIONS), np.empty(UNKNOWN)
    first[STATIC_K], first[STATIC_PA] = SEA_LEVEL_K, SEA_LEVEL_PA
    corrected = condition[N1] / theta(_air(machine, condition).T2_K) ** 0.5
    first[N1] = min(max(corrected, line.n1[0]), line.n1[-1])
    engine, unit = (machine.path, machine.health), machine.fuel_unit_kgps
    done, step, inverse = 0.0, 1.0, np.zeros((UNKNOWN, UNKNOWN))
    _start(machine, line, condition, x, inverse)
    while step >= _SHORTEST:
        for j in range(UNKNOWN):
            kept[j] = x[j]
        share = min(done + step, 1.0)
        for j in range(CONDITIONS):
            here[j] = condition[j] - (1.0 - share) * (condition[j] - first[j])
        if step < 1.0:
            inverse[0, 0] = 0.0
        asked = Running(here[N1], 1.0, unit, here[BLEED], here[OFFTAKE_W], 0.0, 0.0)
        stations, converged = solved(engine, _air(machine, here), asked, x, inverse)
        if converged and share == 1.0:
            return stations, True
        if converged:
            done = share
        elif step == 1.0:
            _start(machine, line, first, x, inverse)
            step = _LONGEST
        else:
            step *= 0.5
            for j in range(UNKNOWN):
                x[j] = kept[j]
    return stations, False


@compiled
def rest_points(
    machine: Machine, line: Line, conditions: FloatArray
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Settle at each row of `conditions` (n, 6).

    Returns the unknowns (n, 7), all stations (n, len(Stations)) and which rows converged.
    """
    count = len(conditions)
    unknowns, rows = np.empty((count, UNKNOWN)), np.empty((count, FIELDS))
    good = np.zeros(count, dtype=np.bool_)
    for k in range(count):
        stations, good[k] = _reach(machine, line, conditions[k], unknowns[k])
        for j in range(FIELDS):
            rows[k, j] = stations[j]
    return unknowns, rows, good


@compiled
def face_pressures(machine: Machine, conditions: FloatArray) -> FloatArray:
    """Total pressure (n,) in Pa at the fan face, at `conditions` (n, 6)."""
    pressures = np.empty(len(conditions))
    for k in range(len(conditions)):
        pressures[k] = _air(machine, conditions[k]).P2_Pa
    return pressures


def running_line(machine: Machine, n1: FloatArray, first: FloatArray) -> Line:
    """Follow the line at sea level static down to `n1[0]` from the unknowns (7,) at `n1[-1]`.

    `n1` (m,) ascends. The line starts above the last speed that does not converge.
    """
    found, ahead, inverses = [first], first, []
    unknown = np.zeros((1, UNKNOWN, UNKNOWN))
    condition = np.zeros((1, CONDITIONS))
    condition[0, STATIC_K], condition[0, STATIC_PA] = SEA_LEVEL_K, SEA_LEVEL_PA
    for speed in n1[::-1]:
        condition[0, N1] = speed
        start = Line(np.array([speed]), ahead.reshape(-1, 1).copy(), unknown)
        unknowns, _, good = rest_points(machine, start, condition)
        if not good[0]:
            break
        ahead = 2.0 * unknowns[0] - found[-1]  # the line goes on straight
        found.append(unknowns[0])
        inverses.append(_inverse_at(machine, condition[0], unknowns[0]))
    count = len(found) - 1
    return Line(
        n1[len(n1) - count :].copy(),
        np.array(found[:0:-1]).T.copy(),
        np.array(inverses[::-1]),
    )


@compiled
def _inverse_at(machine: Machine, condition: FloatArray, x: FloatArray) -> FloatArray:
    """Inverse of the Jacobian (7, 7) at the steady state `x`."""
    inverse, residual = np.zeros((UNKNOWN, UNKNOWN)), np.zeros(UNKNOWN)
    point = (
        (machine.path, machine.health),
        _air(machine, condition),
        Running(condition[N1], 1.0, machine.fuel_unit_kgps, 0.0, 0.0, 0.0, 0.0),
    )
    balances(point[0], point[1], point[2], x, residual)
    inverse_jacobian(point, x, residual, inverse)
    return inverse
