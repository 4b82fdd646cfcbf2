"""Newton's method for the gas path: balances of flow in a transient, and all balances when steady.

In a transient the five balances of flow are solved from the positions of the sample before, with
the Jacobian of some samples ago for as long as that converges well (a chord method). In a steady
state N2 and the fuel flow are unknown too, and the powers of both spools must balance.

A steady state is solved from the running line at sea level static at the same corrected speed, with
the Jacobian of the nearest point of the line. Where that does not converge, the flight condition is
approached in steps, as short as necessary. A point that still does not converge is reported, never
filled in.

Loops are written out: array expressions and LAPACK take several times as long to compile, and
`invert` has to return False inside compiled code.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from narxcal.atmosphere import P0_PA, T0_K
from narxcal.support.arrays import BoolArray, FloatArray
from narxcal.support.compiled import compiled, table_value
from narxcal.turbofan.cycle import POSITIONS, GasPath, Health, Running, Stations, gas_path
from narxcal.turbofan.gas import Air, delta, intake, theta

TOLERANCE = 1e-10  # of the relative balances
UNKNOWN = POSITIONS + 2  # when steady: positions, N2, fuel flow over its design value
_DIFFERENCE = 1e-7
_LONGEST_MOVE = 0.25  # of any unknown in one step
# A step that leaves a larger share of the error requires a new Jacobian: with a constant one, and
# with one that is updated after each step.
_CHORD_SHARE, _BROYDEN_SHARE = 0.1, 0.6
_LOWEST, _HIGHEST = (-3.0, 1.0), (2.6, 15.0)  # of angles, of pressure ratios
_LEAST_SHARE = 1e-3  # of a Newton step


@compiled
def largest_magnitude(values: FloatArray) -> float:
    """Largest magnitude; infinite where a value is NaN or infinite."""
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
    """Invert by Gauss-Jordan elimination with partial pivoting; `matrix` (n, n) is overwritten.

    Returns False, with an undefined `inverse` (n, n), where the matrix is singular or not finite.
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
def _step(
    x: FloatArray, inverse: FloatArray, residual: FloatArray, share: float, after: FloatArray
) -> None:
    """Put `x - share * inverse @ residual` into `after`.

    No unknown moves by more than `_LONGEST_MOVE`, and all stay within their ranges.
    """
    n, longest = len(x), 1e-12
    for i in range(n):
        after[i] = 0.0
        for j in range(n):
            after[i] += inverse[i, j] * residual[j]
        longest = max(longest, abs(after[i]))
    share *= min(1.0, _LONGEST_MOVE / longest)
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
    run: Running,
    x: FloatArray,
    residual: FloatArray,
) -> Stations:
    """Compute the balances at `x`: five of flow, and for seven unknowns two of power as well.

    Powers are relative to that of the HPT. With seven unknowns `run.n2` is ignored and
    `run.fuel_kgps` is the unit of the last of them.
    """
    n2, fuel = run.n2, run.fuel_kgps
    if len(x) > POSITIONS:
        n2, fuel = x[POSITIONS], fuel * x[POSITIONS + 1]
    at = Running(run.n1, n2, fuel, run.bleed, run.offtake_W, run.soak_W, run.clearance)
    stations = gas_path(engine, air, at, x, residual)
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
    nearby, at, jacobian = np.empty(n), np.empty(n), np.empty((n, n))
    for j in range(n):
        for i in range(n):
            at[i] = x[i]
        at[j] += _DIFFERENCE
        balances(point[0], point[1], point[2], at, nearby)
        for i in range(n):
            jacobian[i, j] = (nearby[i] - residual[i]) / _DIFFERENCE
    return invert(jacobian, inverse)


@compiled
def _broyden(
    inverse: FloatArray, x: FloatArray, moved: FloatArray, before: FloatArray, after: FloatArray
) -> None:
    """Update `inverse` after the step from `x` to `moved`, from residual `before` to `after`.

    Broyden's rank-one update of the inverse (Mathematics of Computation 19, 1965), for steady
    states alone: in a transient the steps are too small.
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
def solve(
    engine: tuple[GasPath, Health], air: Air, run: Running, x: FloatArray, inverse: FloatArray
) -> tuple[Stations, bool]:
    """Move `x` (5,) until all flows balance, or (7,) until the powers do as well.

    `inverse` (n, n) is that of a Jacobian near `x`; both are changed in place and may be kept
    from call to call. An `inverse` that starts with zero is computed anew, and so is one whose step
    reduces the error too little; a step with a new one is shortened until it reduces the error.
    Returns the stations, and whether it converged.
    """
    n = len(x)
    share_left = _CHORD_SHARE if n == POSITIONS else _BROYDEN_SHARE
    residual, nearby, trial = np.empty(n), np.empty(n), np.empty(n)
    fresh, share = False, 1.0
    stations = balances(engine, air, run, x, residual)
    error = largest_magnitude(residual)
    for _ in range(120):
        if error < TOLERANCE:
            return stations, True
        if inverse[0, 0] == 0.0:
            if not inverse_jacobian((engine, air, run), x, residual, inverse):
                break
            fresh = True
        _step(x, inverse, residual, share, trial)
        tried = balances(engine, air, run, trial, nearby)
        found = largest_magnitude(nearby)
        _broyden(inverse, x, trial, residual, nearby)
        if found > share_left * error and not (fresh and found >= error):
            inverse[0, 0] = 0.0
        if found < error:
            for i in range(n):
                x[i], residual[i] = trial[i], nearby[i]
            error, stations, fresh, share = found, tried, False, 1.0
        elif fresh:
            share *= 0.5
            if share < _LEAST_SHARE:
                break
    inverse[0, 0] = 0.0  # the next call computes a new one
    return stations, False


STATIC_K, STATIC_PA, MACH, N1, BLEED, OFFTAKE_W, CONDITIONS = range(7)  # columns of a condition
FIELDS = len(Stations._fields)
_LONGEST, _SHORTEST = 0.25, 1.0 / 256.0  # steps towards a condition, as shares of the way


class Line(NamedTuple):
    """The running line at sea level static.

    Relative N1 (m,), ascending, unknowns (7, m), and inverses (m, 7, 7) of the Jacobians there,
    zero where they have not been computed.
    """

    n1: FloatArray
    unknowns: FloatArray
    inverses: FloatArray


class Machine(NamedTuple):
    """Constants of a steady state: gas path, health, intake recovery, and the unit of fuel."""

    path: GasPath
    health: Health
    recovery: float
    fuel_unit_kgps: float


@compiled
def inlet_air(machine: Machine, condition: FloatArray) -> Air:
    """Air ahead of the engine and at the fan face, at a `condition` (6,)."""
    return intake(condition[STATIC_K], condition[STATIC_PA], condition[MACH], machine.recovery)


@compiled
def _start(
    machine: Machine, line: Line, condition: FloatArray, x: FloatArray, inverse: FloatArray
) -> None:
    """Set `x` to the point of the running line at the same corrected speed, uncorrected.

    `inverse` is that of the nearest point, uncorrected too: real unknowns per relative balance.
    """
    air = inlet_air(machine, condition)
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
def _solve_steady(
    machine: Machine, line: Line, condition: FloatArray, x: FloatArray
) -> tuple[Stations, bool]:
    """Solve the steady state at `condition`: directly, or by continuation from sea level static.

    The continuation starts on the line at the same corrected speed; a step that fails is halved.
    """
    here, first, kept = np.empty(CONDITIONS), np.zeros(CONDITIONS), np.empty(UNKNOWN)
    first[STATIC_K], first[STATIC_PA] = T0_K, P0_PA
    corrected = condition[N1] / theta(inlet_air(machine, condition).T2_K) ** 0.5
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
        run = Running(here[N1], 1.0, unit, here[BLEED], here[OFFTAKE_W], 0.0, 0.0)
        stations, converged = solve(engine, inlet_air(machine, here), run, x, inverse)
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
def steady_points(
    machine: Machine, line: Line, conditions: FloatArray
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Solve the steady state at each row of `conditions` (n, 6).

    Returns the unknowns (n, 7), all stations (n, len(Stations)) and which rows converged.
    """
    count = len(conditions)
    unknowns, rows = np.empty((count, UNKNOWN)), np.empty((count, FIELDS))
    good = np.zeros(count, dtype=np.bool_)
    for k in range(count):
        stations, good[k] = _solve_steady(machine, line, conditions[k], unknowns[k])
        for j in range(FIELDS):
            rows[k, j] = stations[j]
    return unknowns, rows, good


@compiled
def face_pressures(machine: Machine, conditions: FloatArray) -> FloatArray:
    """Total pressure (n,) in Pa at the fan face, at `conditions` (n, 6)."""
    pressures = np.empty(len(conditions))
    for k in range(len(conditions)):
        pressures[k] = inlet_air(machine, conditions[k]).P2_Pa
    return pressures


def running_line(machine: Machine, n1: FloatArray, first: FloatArray) -> Line:
    """Follow the line at sea level static down to `n1[0]` from the unknowns (7,) at `n1[-1]`.

    `n1` (m,) ascends. The line starts above the highest speed that does not converge.
    """
    found, ahead, inverses = [first], first, []
    unknown = np.zeros((1, UNKNOWN, UNKNOWN))
    condition = np.zeros((1, CONDITIONS))
    condition[0, STATIC_K], condition[0, STATIC_PA] = T0_K, P0_PA
    for speed in n1[::-1]:
        condition[0, N1] = speed
        start = Line(np.array([speed]), ahead.reshape(-1, 1).copy(), unknown)
        unknowns, _, good = steady_points(machine, start, condition)
        if not good[0]:
            break
        ahead = 2.0 * unknowns[0] - found[-1]  # linear extrapolation
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
        inlet_air(machine, condition),
        Running(condition[N1], 1.0, machine.fuel_unit_kgps, 0.0, 0.0, 0.0, 0.0),
    )
    balances(point[0], point[1], point[2], x, residual)
    inverse_jacobian(point, x, residual, inverse)
    return inverse
