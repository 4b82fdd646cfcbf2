"""Newton's method for the gas path: flows at given speeds and fuel, and all balances at rest.

In a transient the five balances of flow are solved from the positions of the sample before, with
the Jacobian of some samples ago for as long as that converges well (a chord method). At rest, N2
and the fuel flow are unknown too, and the powers of both spools must balance.
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
_LEAST_GAIN = 0.1  # a chord step that leaves more of the error than this asks for a new Jacobian
_LOWEST, _HIGHEST = (-3.0, 1.0), (2.6, 15.0)  # of angles, of pressure ratios


@compiled
def worst(values: FloatArray) -> float:
    """Largest magnitude; infinite where a value is no number."""
    largest = 0.0
    for value in values:
        if not np.isfinite(value):
            return np.inf
        largest = max(largest, abs(value))
    return largest


@compiled
def _moved(x: FloatArray, step: FloatArray, share: float) -> FloatArray:
    """`x - share * step`, no unknown by more than `_REACH`, and all within their ranges."""
    share *= min(1.0, _REACH / max(worst(step), 1e-12))
    after = x - share * step
    for i in range(3):
        after[i] = min(max(after[i], _LOWEST[0]), _HIGHEST[0])
    for i in range(3, POSITIONS):
        after[i] = min(max(after[i], _LOWEST[1]), _HIGHEST[1])
    for i in range(POSITIONS, len(x)):
        after[i] = min(max(after[i], 1e-3), 3.0)
    return after


@compiled
def _flow_jacobian(
    engine: tuple[GasPath, Health], air: Air, run: Running, x: FloatArray
) -> FloatArray:
    """Forward differences of the balances of flow, (5, 5)."""
    base, beside, jacobian = np.empty(5), np.empty(5), np.empty((5, 5))
    gas_path(engine, air, run, x, base)
    for j in range(5):
        at = x.copy()
        at[j] += _DIFFERENCE
        gas_path(engine, air, run, at, beside)
        jacobian[:, j] = (beside - base) / _DIFFERENCE
    return jacobian


@compiled
def match_flows(
    engine: tuple[GasPath, Health], air: Air, run: Running, x: FloatArray, inverse: FloatArray
) -> tuple[Stations, bool]:
    """Move `x` (5,) until all flows balance; `inverse` (5, 5) is that of a Jacobian near `x`.

    Both are changed in place and kept from call to call; an `inverse` that is all zero is made
    anew. Returns the stations, and whether it converged.
    """
    residual = np.empty(5)
    stations = gas_path(engine, air, run, x, residual)
    error = worst(residual)
    fresh, share = False, 1.0
    for _ in range(80):
        if error < TOLERANCE:
            return stations, True
        if inverse[0, 0] == 0.0 and not fresh:
            inverse[:] = np.linalg.inv(_flow_jacobian(engine, air, run, x))
            fresh = True
        beside = np.empty(5)
        trial = _moved(x, inverse @ residual, share)
        tried = gas_path(engine, air, run, trial, beside)
        found = worst(beside)
        stale = found > _LEAST_GAIN * error and not fresh
        if found < error:
            x[:], residual, error, stations, share = trial, beside, found, tried, 1.0
            fresh = False
        elif not stale:
            share *= 0.5
        if stale and error >= TOLERANCE:
            inverse[:] = np.linalg.inv(_flow_jacobian(engine, air, run, x))
            fresh = True
    return stations, False


@compiled
def at_rest(
    engine: tuple[GasPath, Health],
    air: Air,
    asked: Running,
    x: FloatArray,
    residual: FloatArray,
) -> Stations:
    """All seven balances at `x` (7,): five of flow, then the powers over that of the HPT.

    `asked.n2` is ignored and `asked.fuel_kgps` is the unit of the last unknown.
    """
    run = Running(
        asked.n1,
        x[POSITIONS],
        asked.fuel_kgps * x[POSITIONS + 1],
        asked.bleed,
        asked.offtake_W,
        asked.soak_W,
        asked.clearance,
    )
    stations = gas_path(engine, air, run, x, residual)
    residual[POSITIONS] = stations.power1_W / stations.hpt_W
    residual[POSITIONS + 1] = stations.power2_W / stations.hpt_W
    return stations


@compiled
def settle(
    engine: tuple[GasPath, Health], air: Air, asked: Running, x: FloatArray
) -> tuple[Stations, bool]:
    """Move `x` (7,) until flows and powers balance at `asked.n1`; damped Newton.

    Returns the stations, and whether it converged.
    """
    residual, beside = np.empty(UNKNOWN), np.empty(UNKNOWN)
    jacobian, step = np.empty((UNKNOWN, UNKNOWN)), np.empty(UNKNOWN)
    stations = at_rest(engine, air, asked, x, residual)
    error = worst(residual)
    for _ in range(60):
        if error < TOLERANCE:
            return stations, True
        for j in range(UNKNOWN):
            at = x.copy()
            at[j] += _DIFFERENCE
            at_rest(engine, air, asked, at, beside)
            jacobian[:, j] = (beside - residual) / _DIFFERENCE
        if not np.isfinite(jacobian).all():
            return stations, False
        step[:] = np.linalg.solve(jacobian, residual)
        share, found = 1.0, np.inf
        while share > 1e-3:
            trial = _moved(x, step, share)
            stations = at_rest(engine, air, asked, trial, beside)
            found = worst(beside)
            if found < error:
                break
            share *= 0.5
        if not found < error:
            return stations, False
        x[:], error = trial, found
        residual[:] = beside
    return stations, error < TOLERANCE
