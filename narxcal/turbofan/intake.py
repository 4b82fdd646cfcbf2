"""From pressure altitude, Mach number and temperature deviation to the face of the fan."""

from __future__ import annotations

import math
from typing import NamedTuple

from narxcal.turbofan.compiled import compiled
from narxcal.turbofan.gas import (
    enthalpy,
    entropy,
    gas_constant,
    specific_heat,
    temperature_at_enthalpy,
)

SEA_LEVEL_K, SEA_LEVEL_PA = 288.15, 101325.0


class Air(NamedTuple):
    """The air ahead of the engine and at the fan face: static, then total, SI units."""

    static_K: float
    static_Pa: float
    velocity_mps: float
    T2_K: float
    P2_Pa: float


@compiled
def intake(static_K: float, static_Pa: float, mach: float, recovery: float) -> Air:
    """Bring the air to rest: energy is kept, and the share `recovery` of the total pressure."""
    r = gas_constant(0.0)
    cp = specific_heat(static_K, 0.0)
    velocity = mach * math.sqrt(cp / (cp - r) * r * static_K)
    at_rest = enthalpy(static_K, 0.0) + 0.5 * velocity * velocity
    total = temperature_at_enthalpy(at_rest, 0.0, static_K * (1.0 + 0.2 * mach * mach))
    rise = math.exp((entropy(total, 0.0) - entropy(static_K, 0.0)) / r)
    return Air(static_K, static_Pa, velocity, total, recovery * rise * static_Pa)


@compiled
def fan_face(
    static_K: float, static_Pa: float, mach: float, recovery: float
) -> tuple[float, float]:
    """Total temperature and pressure at the fan face of `intake`: K, Pa."""
    air = intake(static_K, static_Pa, mach, recovery)
    return air.T2_K, air.P2_Pa


@compiled
def theta(temperature_K: float) -> float:
    """Temperature over that of the standard day at sea level."""
    return temperature_K / SEA_LEVEL_K


@compiled
def delta(pressure_Pa: float) -> float:
    """Pressure over that of the standard day at sea level."""
    return pressure_Pa / SEA_LEVEL_PA
