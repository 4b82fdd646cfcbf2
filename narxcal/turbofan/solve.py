"""Newton's method for the gas path: flows at given speeds and fuel, and all balances at rest.

In a transient the five balances of flow are solved from the positions of the sample before, with
the Jacobian of some samples ago for as long as that converges well (a chord method). At rest, N2
and the fuel flow are unknown too, and the powers of both spools must balance.

Loops are written out: array expressions and LAPACK take several times as long to compile.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from narxcal.turbofan.compiled import compiled
from narxcal.turbofan.cycle import POSITIONS, gas_path
from narxcal.turbofan.intake import Air
from narxcal.turbofan.stations import GasPath, Health, Running, Stations

FloatArray = NDArray[np.float64]
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
