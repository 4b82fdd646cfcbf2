"""Newton's method for the gas path: flows at given speeds and fuel, and all balances at rest.

In a transient the five balances of flow are solved from the positions of the sample before, with
the Jacobian of some samples ago for as long as that converges well (a chord method). At rest, N2
and the fuel flow are unknown too, and the powers of both spools must balance.

Loops are written out: array expressions and LAPACK take several times as long to compile.

Steady states of the gas path, many conditions at once.

Newton starts from the running line at sea level static, looked up at the corrected speed asked
for, with the Jacobian of the nearest point of the line; where that does not converge, the flight
condition is approached in steps, as short as need be. A point that still does not
converge is reported, never filled in.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from narxcal.support.arrays import BoolArray, FloatArray
from narxcal.support.compiled import compiled, table_value
from narxcal.turbofan.cycle import POSITIONS, GasPath, Health, Running, Stations, gas_path
from narxcal.turbofan.gas import SEA_LEVEL_K, SEA_LEVEL_PA, Air, delta, intake, theta

TOLERANCE = 1e-10  # of the relative balances
UNKNOWN = POSITIONS + 2  # at rest: positions, N2, fuel flow over its design value
_DIFFERENCE = 1e-7
_REACH = 0.25  # longest step of any unknown
# A step that leaves more of the error than this asks for a new Jacobian: with one that is kept
# as it is, and with one that learns from every step.
_LEAST_GAIN, _LEAST_LEARNING = 0.1, 0.6
_LOWEST, _HIGHEST = (-3.0, 1.0), (2.6, 15.0)  # of angles, of pressure ratios
_LEAST_SHARE = 1e-3  # of a Newton step


@compiled
def worst(values: FloatArray) -> float:
    """Largest magnitude; infinite where a value is no number."""
    largest = 0.0
    for i in range(len(values)):
        size = abs(values[i])
        if not size < np.inf:
            return np.inf
        largest = max(size, largest)
    return largest


@compiled
def _pivot(matrix: FloatArray, inverse: FloatArray, k: int) -> bool:
    """Bring the largest of column `k` to its diagonal; False if there is none."""
    best = k
    for i in range(k + 1, len(matrix)):
        if abs(matrix[i, k]) > abs(matrix[best, k]):
            best = i
    for j in range(len(matrix)):
        matrix[k, j], matrix[best, j] = matrix[best, j], matrix[k, j]
        inverse[k, j], inverse[best, j] = inverse[best, j], inverse[k, j]
    return bool(0.0 < abs(matrix[k, k]) < np.inf)


@compiled
def invert(matrix: FloatArray, inverse: FloatArray) -> bool:
    """Gauss-Jordan elimination with partial pivoting; `matrix` (n, n) is used up.

    False, and an `inverse` (n, n) of no meaning, where the matrix is singular or no number.
    """
    n = len(matrix)
    for i in range(n):
        for j in range(n):
            inverse[i, j] = 1.0 if i == j else 0.0
    for k in range(n):
        if not _pivot(matrix, inverse, k):
            return False
        scale = 1.0 / matrix[k, k]
        for j in range(n):
            matrix[k, j] *= scale
            inverse[k, j] *= scale
        for i in range(n):
            factor = matrix[i, k]
            if i != k and factor != 0.0:
                for j in range(n):
                    matrix[i, j] -= factor * matrix[k, j]
                    inverse[i, j] -= factor * inverse[k, j]
    return True


@compiled
def _moved(
    x: FloatArray, inverse: FloatArray, residual: FloatArray, share: float, after: FloatArray
) -> None:
    """Put `x - share * inverse @ residual` into `after`.

    No unknown moves by more than `_REACH`, and all stay within their ranges.
    """
    n, longest = len(x), 1e-12
    for i in range(n):
        after[i] = 0.0
        for j in range(n):
            after[i] += inverse[i, j] * residual[j]
        longest = max(longest, abs(after[i]))
    share *= min(1.0, _REACH / longest)
    for i in range(n):
        low, high = 1e-3, 3.0
        if i < POSITIONS:
            kind = 0 if i < 3 else 1
            low, high = _LOWEST[kind], _HIGHEST[kind]
        after[i] = min(max(x[i] - share * after[i], low), high)


@compiled
def balances(
    engine: tuple[GasPath, Health],
    air: Air,
    asked: Running,
    x: FloatArray,
    residual: FloatArray,
) -> Stations:
    """The balances at `x`: the five of flow, and for seven unknowns those of power as well.

    Powers are relative to that of the HPT. With seven unknowns `asked.n2` is ignored and
    `asked.fuel_kgps` is the unit of the last of them.
    """
    n2, fuel = asked.n2, asked.fuel_kgps
    if len(x) > POSITIONS:
        n2, fuel = x[POSITIONS], fuel * x[POSITIONS + 1]
    run = Running(asked.n1, n2, fuel, asked.bleed, asked.offtake_W, asked.soak_W, asked.clearance)
    stations = gas_path(engine, air, run, x, residual)
    if len(x) > POSITIONS:
        residual[POSITIONS] = stations.power1_W / stations.hpt_W
        residual[POSITIONS + 1] = stations.power2_W / stations.hpt_W
    return stations


@compiled
def inverse_jacobian(
    point: tuple[tuple[GasPath, Health], Air, Running],
    x: FloatArray,
    residual: FloatArray,
    inverse: FloatArray,
) -> bool:
    """Inverse of the Jacobian by forward differences from the balances `residual` at `x`."""
    n = len(x)
    beside, at, jacobian = np.empty(n), np.empty(n), np.empty((n, n))
    for j in range(n):
        for i in range(n):
            at[i] = x[i]
        at[j] += _DIFFERENCE
        balances(point[0], point[1], point[2], at, beside)
        for i in range(n):
            jacobian[i, j] = (beside[i] - residual[i]) / _DIFFERENCE
    return invert(jacobian, inverse)


@compiled
def _learn(
    inverse: FloatArray, x: FloatArray, moved: FloatArray, before: FloatArray, after: FloatArray
) -> None:
    """Make `inverse` fit the step from `x` to `moved`, which led from residual `before` to `after`.

    Broyden's update (Mathematics of Computation 19, 1965) for the inverse; at rest alone, since in
    a transient the steps are too small to learn from.
    """
    n = len(x)
    if n == POSITIONS:
        return
    expected, row = np.zeros(n), np.zeros(n)
    scale = 0.0
    for i in range(n):
        for j in range(n):
            expected[i] += inverse[i, j] * (after[j] - before[j])
            row[j] += (moved[i] - x[i]) * inverse[i, j]
        scale += (moved[i] - x[i]) * expected[i]
    if 0.0 < abs(scale) < np.inf:
        for i in range(n):
            for j in range(n):
                inverse[i, j] += (moved[i] - x[i] - expected[i]) * row[j] / scale


@compiled
def solved(
    engine: tuple[GasPath, Health], air: Air, asked: Running, x: FloatArray, inverse: FloatArray
) -> tuple[Stations, bool]:
    """Move `x` (5,) until all flows balance, or (7,) until the powers do as well.

    `inverse` (n, n) is that of a Jacobian near `x`; both are changed in place and may be kept
    from call to call. An `inverse` that is all zero is made anew, and so is one whose step gains
    too little; a step with a fresh one is shortened until it gains. At rest, where few calls follow
    each other closely, it learns from every step. Returns the stations, and whether it converged.
    """
    n = len(x)
    least = _LEAST_GAIN if n == POSITIONS else _LEAST_LEARNING
    residual, beside, trial = np.empty(n), np.empty(n), np.empty(n)
    fresh, share = False, 1.0
    stations = balances(engine, air, asked, x, residual)
    error = worst(residual)
    for _ in range(120):
        if error < TOLERANCE:
            return stations, True
        if inverse[0, 0] == 0.0:
            if not inverse_jacobian((engine, air, asked), x, residual, inverse):
                break
            fresh = True
        _moved(x, inverse, residual, share, trial)
        tried = balances(engine, air, asked, trial, beside)
        found = worst(beside)
        _learn(inverse, x, trial, residual, beside)
        if found > least * error and not (fresh and found >= error):
            inverse[0, 0] = 0.0
        if found < error:
            for i in range(n):
                x[i], residual[i] = trial[i], beside[i]
            error, stations, fresh, share = found, tried, False, 1.0
        elif fresh:
            share *= 0.5
            if share < _LEAST_SHARE:
                break
    inverse[0, 0] = 0.0  # what failed once is no start for the next call
    return stations, False


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
