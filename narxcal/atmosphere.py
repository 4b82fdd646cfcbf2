"""The International Standard Atmosphere to 20 km, and what an engine intake feels in flight.

ISO 2533:1975 / ICAO Doc 7488: the geopotential altitude is the pressure altitude, a
temperature deviation `dT_C` shifts the temperature and leaves the pressure alone.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from narxcal.narx.kernels import compiled

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

T0_K = 288.15
P0_PA = 101325.0
FT_M = 0.3048
GAMMA = 1.4
_LAPSE = 0.0065  # K/m below the tropopause
_G, _R = 9.80665, 287.05287
_TROPOPAUSE_M, _TOP_M = 11000.0, 20000.0
_TROPOPAUSE_K = T0_K - _LAPSE * _TROPOPAUSE_M


@dataclass(frozen=True)
class AirState:
    """The air ahead of the engine and, brought to rest without loss, at its intake.

    `T_K`, `P_Pa` static; `T2_K`, `P2_Pa` total; `theta = T/T0`, `delta = P/P0` static and
    `theta2`, `delta2` total ratios to sea level. All have the broadcast shape of the inputs.
    """

    T_K: NDArray[np.float64]
    P_Pa: NDArray[np.float64]
    T2_K: NDArray[np.float64]
    P2_Pa: NDArray[np.float64]

    @property
    def theta(self) -> NDArray[np.float64]:
        """Static temperature ratio."""
        return self.T_K / T0_K

    @property
    def delta(self) -> NDArray[np.float64]:
        """Static pressure ratio."""
        return self.P_Pa / P0_PA

    @property
    def theta2(self) -> NDArray[np.float64]:
        """Total temperature ratio: corrected speed is `N / sqrt(theta2)`."""
        return self.T2_K / T0_K

    @property
    def delta2(self) -> NDArray[np.float64]:
        """Total pressure ratio: corrected fuel flow is `FF / (delta2 sqrt(theta2))`."""
        return self.P2_Pa / P0_PA


def isa(alt_ft: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return standard temperature in K and pressure in Pa at pressure altitude `alt_ft`, ft.

    Above 20 km the formulas of the isothermal layer are held at 20 km.
    """
    height = np.minimum(np.asarray(alt_ft, dtype=np.float64) * FT_M, _TOP_M)
    lower = np.minimum(height, _TROPOPAUSE_M)
    temperature = T0_K - _LAPSE * lower
    pressure = P0_PA * (temperature / T0_K) ** (_G / (_R * _LAPSE))
    above = np.maximum(height - _TROPOPAUSE_M, 0.0)
    return temperature, pressure * np.exp(-_G * above / (_R * _TROPOPAUSE_K))


def air_state(alt_ft: ArrayLike, mach: ArrayLike = 0.0, dt_c: ArrayLike = 0.0) -> AirState:
    """Air at pressure altitude in ft, flight Mach number and static deviation from ISA in degC.

    Total values are isentropic with gamma = 1.4: `T2 = T (1 + 0.2 M^2)`,
    `P2 = P (1 + 0.2 M^2)^3.5` (any compressible-flow text; no intake loss).
    """
    standard, pressure = isa(alt_ft)
    mach = np.asarray(mach, dtype=np.float64)
    static = standard + np.asarray(dt_c, dtype=np.float64)
    rise = 1.0 + 0.5 * (GAMMA - 1.0) * mach**2
    total = static * rise
    return AirState(
        T_K=_shaped(static, total.shape),
        P_Pa=_shaped(pressure, total.shape),
        T2_K=total,
        P2_Pa=_shaped(pressure * rise ** (GAMMA / (GAMMA - 1.0)), total.shape),
    )


def _shaped(values: NDArray[np.float64], shape: tuple[int, ...]) -> NDArray[np.float64]:
    """Broadcast where that is called for: for one sample it takes longer than the air."""
    return values if values.shape == shape else np.broadcast_to(values, shape)


@compiled
def total_ratios(alt_ft: float, mach: float, dt_c: float) -> tuple[float, float]:
    """`theta2` and `delta2` of `air_state` for one sample, compiled: the same formulas."""
    height = min(alt_ft * FT_M, _TOP_M)
    standard = T0_K - _LAPSE * min(height, _TROPOPAUSE_M)
    pressure = (standard / T0_K) ** (_G / (_R * _LAPSE))
    pressure *= math.exp(-_G * max(height - _TROPOPAUSE_M, 0.0) / (_R * _TROPOPAUSE_K))
    rise = 1.0 + 0.5 * (GAMMA - 1.0) * mach**2
    return (standard + dt_c) / T0_K * rise, pressure * rise ** (GAMMA / (GAMMA - 1.0))
