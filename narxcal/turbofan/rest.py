"""Steady states of the gas path, many conditions at once.

Newton starts from the running line at sea level static, looked up at the corrected speed asked
for; where that does not converge, the flight condition is approached in steps. A point that
still does not converge is reported, never filled in.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from narxcal.turbofan.compiled import compiled
from narxcal.turbofan.cycle import POSITIONS
from narxcal.turbofan.intake import SEA_LEVEL_K, SEA_LEVEL_PA, Air, intake, theta
from narxcal.turbofan.solve import UNKNOWN, settle
from narxcal.turbofan.stations import GasPath, Health, Running, Stations

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
STATIC_K, STATIC_PA, MACH, N1, BLEED, OFFTAKE_W, CONDITIONS = range(7)  # columns of a condition
FIELDS = len(Stations._fields)
_APPROACH = 12  # steps towards a condition that is not reached at once


class Line(NamedTuple):
    """The running line at sea level static: relative N1 (m,), descending, and unknowns (m, 7)."""

    n1: FloatArray
    unknowns: FloatArray


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
def _solve(machine: Machine, condition: FloatArray, x: FloatArray) -> tuple[Stations, bool]:
    air = _air(machine, condition)
    asked = Running(
        condition[N1], 1.0, machine.fuel_unit_kgps, condition[BLEED], condition[OFFTAKE_W], 0.0, 0.0
    )
    return settle((machine.path, machine.health), air, asked, x)


@compiled
def _start(machine: Machine, line: Line, condition: FloatArray) -> FloatArray:
    """Unknowns on the running line at the corrected speed asked for, taken back to real ones."""
    air = _air(machine, condition)
    root = theta(air.T2_K) ** 0.5
    corrected = condition[N1] / root
    x = np.empty(UNKNOWN)
    for j in range(UNKNOWN):
        x[j] = np.interp(corrected, line.n1[::-1], line.unknowns[::-1, j])
    x[POSITIONS] *= root
    x[POSITIONS + 1] *= root * air.P2_Pa / SEA_LEVEL_PA
    return x


@compiled
def _approach(
    machine: Machine, line: Line, condition: FloatArray
) -> tuple[Stations, FloatArray, bool]:
    """Walk from sea level static, at the same corrected speed, to the condition."""
    here = condition.copy()
    here[STATIC_K], here[STATIC_PA], here[MACH] = SEA_LEVEL_K, SEA_LEVEL_PA, 0.0
    here[BLEED] = here[OFFTAKE_W] = 0.0
    here[N1] = min(max(condition[N1] / theta(_air(machine, condition).T2_K) ** 0.5, 0.25), 1.05)
    first = here.copy()
    x = _start(machine, line, here)
    stations, converged = _solve(machine, here, x)
    for k in range(1, _APPROACH + 1):
        share = k / _APPROACH
        stations, converged = _solve(machine, (1.0 - share) * first + share * condition, x)
    return stations, x, converged


@compiled
def running_line(machine: Machine, n1: FloatArray, first: FloatArray) -> tuple[Line, int]:
    """Follow the line at sea level static down `n1` (m,) from the design point's unknowns (7,).

    Returns the line, and how many of its points converged.
    """
    unknowns = np.empty((len(n1), UNKNOWN))
    condition = np.zeros(CONDITIONS)
    condition[STATIC_K], condition[STATIC_PA] = SEA_LEVEL_K, SEA_LEVEL_PA
    x = first.copy()
    for k in range(len(n1)):
        condition[N1] = n1[k]
        _, converged = _solve(machine, condition, x)
        if not converged:
            return Line(n1[:k], unknowns[:k]), k
        unknowns[k] = x
    return Line(n1, unknowns), len(n1)


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
        x = _start(machine, line, conditions[k])
        stations, converged = _solve(machine, conditions[k], x)
        if not converged:
            stations, x, converged = _approach(machine, line, conditions[k])
        unknowns[k], good[k] = x, converged
        for j in range(FIELDS):
            rows[k, j] = stations[j]
    return unknowns, rows, good
