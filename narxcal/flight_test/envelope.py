"""The channels and the envelope of the virtual flight test, and which speed belongs where.

The box is the calibration paper's (section 2.1): 0 to 12 km, up to Mach 0.85, static temperature
-30 to +20 degC off the standard day. Two aircraft limit it further. Modelled: pressure altitude,
calibrated airspeed and Mach number as one consistent triple (closed form, no instrument error).
Not modelled: weight, drag, buffet; what an aircraft could sustain is only bounded by rates.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from narxcal.atmosphere import FT_M, P0_PA, isa
from narxcal.errors import ConfigError

FloatArray = NDArray[np.float64]

CEILING_FT = 12_000.0 / FT_M
MACH_MAX = 0.85
DT_LOW_C, DT_HIGH_C = -30.0, 20.0
# Rasters: at least the 4 Hz that short delays need (GAP section 3).
RATE_HZ = (4.0, 256.0)
SWITCH_NAMES = ("WOW", "Approach", "ECS", "NAI", "WAI")
CHANNEL_NAMES = ("time_s", "TRA_deg", "ALT_ft", "Mach", "dT_C", *SWITCH_NAMES)
# Speed of sound at sea level on the standard day, in knots.
_SOUND_KT = 661.4786


@dataclass(frozen=True)
class Aircraft:
    """What an aircraft may do: ceiling, highest Mach, climb rates low and high up (ft/min)."""

    ceiling_ft: float
    mach_max: float
    climb_fpm: float
    climb_high_fpm: float


# Round figures of the classes, not of one type; both are kept inside the envelope above.
AIRCRAFT = {
    "business_jet": Aircraft(CEILING_FT, MACH_MAX, 3200.0, 1800.0),
    "single_aisle": Aircraft(39_000.0, 0.82, 2500.0, 1300.0),
}


def mach_of_cas(cas_kt: ArrayLike, alt_ft: ArrayLike) -> FloatArray:
    """Mach number at calibrated airspeed (kt) and pressure altitude (ft), broadcast, subsonic.

    Impact pressure `qc = p0 ((1 + 0.2 (V/a0)^2)^3.5 - 1)` is what an airspeed indicator
    measures, and `qc/p = (1 + 0.2 M^2)^3.5 - 1` (any compressible-flow text).
    """
    speed = np.asarray(cas_kt, dtype=np.float64) / _SOUND_KT
    impact = P0_PA * np.expm1(3.5 * np.log1p(0.2 * speed**2))
    pressure = isa(alt_ft)[1]
    return np.asarray(np.sqrt(5.0 * np.expm1(np.log1p(impact / pressure) / 3.5)))


def check_between(name: str, value: float, low: float, high: float, hint: str = "") -> None:
    """Raise `ConfigError` unless `low <= value <= high`; NaN is refused."""
    if not low <= value <= high:
        raise ConfigError(
            f"{name} has to lie in {low:g} .. {high:g}, got {value:g}", hint=hint or None
        )
