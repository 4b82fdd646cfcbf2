"""The International Standard Atmosphere to 20 km, and what an engine intake feels in flight.

ISO 2533:1975 / ICAO Doc 7488: the geopotential altitude is the pressure altitude, a
temperature deviation `dT_C` shifts the temperature and leaves the pressure alone.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

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
    shape = np.broadcast_shapes(standard.shape, mach.shape, np.shape(dt_c))
    static = np.broadcast_to(standard + np.asarray(dt_c, dtype=np.float64), shape)
    static_pressure = np.broadcast_to(pressure, shape)
    rise = 1.0 + 0.5 * (GAMMA - 1.0) * mach**2
    return AirState(
        T_K=static,
        P_Pa=static_pressure,
        T2_K=static * rise,
        P2_Pa=static_pressure * rise ** (GAMMA / (GAMMA - 1.0)),
    )
