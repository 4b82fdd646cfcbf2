"""Standard atmosphere to 20 km, total and corrected quantities at an engine intake, airspeed.

ISO 2533:1975 / ICAO Doc 7488: the geopotential altitude is the pressure altitude; a temperature
deviation `dT_C` shifts the temperature and leaves the pressure unchanged. Total values are
isentropic with gamma = 1.4.

| symbol | meaning | unit |
|---|---|---|
| T, P | static temperature and pressure | K, Pa |
| T2, P2 | total temperature and pressure at the intake | K, Pa |
| theta, delta | T / 288.15 K, P / 101325 Pa | - |
| theta2, delta2 | the same of T2, P2; corrected speed is N / sqrt(theta2) | - |
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from narxcal.channels import SPOOLS, described
from narxcal.support.arrays import FloatArray, IntArray

T0_K = 288.15
P0_PA = 101325.0
KELVIN = 273.15  # 0 degC
FT_M = 0.3048
SOUND_KT = 661.4786  # speed of sound on a standard day at sea level
GAMMA = 1.4
_LAPSE = 0.0065  # K/m below the tropopause
_G, _R = 9.80665, 287.05287
_TROPOPAUSE_M, _TOP_M = 11000.0, 20000.0
_TROPOPAUSE_K = T0_K - _LAPSE * _TROPOPAUSE_M


@dataclass(frozen=True)
class AirState:
    """Static air ahead of the engine and total values at its intake, without intake loss.

    All have the broadcast shape of the inputs they were computed from.
    """

    T_K: FloatArray
    P_Pa: FloatArray
    T2_K: FloatArray
    P2_Pa: FloatArray

    @property
    def theta(self) -> FloatArray:
        return self.T_K / T0_K

    @property
    def delta(self) -> FloatArray:
        return self.P_Pa / P0_PA

    @property
    def theta2(self) -> FloatArray:
        return self.T2_K / T0_K

    @property
    def delta2(self) -> FloatArray:
        return self.P2_Pa / P0_PA


def isa(alt_ft: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Return standard temperature [K] and pressure [Pa] at pressure altitude `alt_ft` [ft].

    Above 20 km the values of 20 km are returned.
    """
    height = np.minimum(np.asarray(alt_ft, dtype=np.float64) * FT_M, _TOP_M)
    lower = np.minimum(height, _TROPOPAUSE_M)
    temperature = T0_K - _LAPSE * lower
    pressure = P0_PA * (temperature / T0_K) ** (_G / (_R * _LAPSE))
    above = np.maximum(height - _TROPOPAUSE_M, 0.0)
    return temperature, pressure * np.exp(-_G * above / (_R * _TROPOPAUSE_K))


def pressure_altitude(pressure_kpa: ArrayLike) -> FloatArray:
    """Return the altitude [ft] at which the standard atmosphere has a static pressure: `isa`.

    NaN for a pressure that is not positive.
    """
    ratio = np.asarray(pressure_kpa, dtype=np.float64) * 1000.0 / P0_PA
    ratio = np.where(ratio > 0.0, ratio, np.nan)
    lower = (1.0 - ratio ** (_R * _LAPSE / _G)) * T0_K / _LAPSE
    tropopause = (_TROPOPAUSE_K / T0_K) ** (_G / (_R * _LAPSE))
    above = np.log(tropopause / ratio) * _R * _TROPOPAUSE_K / _G
    return np.where(lower <= _TROPOPAUSE_M, lower, _TROPOPAUSE_M + above) / FT_M


def air_state(alt_ft: ArrayLike, mach: ArrayLike = 0.0, dt_c: ArrayLike = 0.0) -> AirState:
    """Compute the air at pressure altitude [ft], Mach number and static deviation from ISA [degC].

    `T2 = T (1 + 0.2 M^2)`, `P2 = P (1 + 0.2 M^2)^3.5` (any compressible-flow text).
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


def _shaped(values: FloatArray, shape: tuple[int, ...]) -> FloatArray:
    """Broadcast only where needed: for one sample it takes longer than the formulas."""
    return values if values.shape == shape else np.broadcast_to(values, shape)


AIR_CHANNELS = ("ALT_ft", "Mach", "dT_C")


def air_columns(names: Sequence[str]) -> IntArray:
    """Columns of altitude, Mach number and temperature deviation in `names`; -1 if missing."""
    return np.array([list(names).index(each) if each in names else -1 for each in AIR_CHANNELS])


def air_at(inputs: FloatArray, names: Sequence[str]) -> AirState:
    """Compute the air at `inputs` (..., n_in) with columns `names`; a missing channel is zero."""
    zero = np.zeros(inputs.shape[:-1])
    return air_state(*(zero if k < 0 else inputs[..., k] for k in air_columns(names)))


# What a channel scales with, in the order in which the exported runtime numbers it.
SIMILARITY = ("plain", "speed", "temperature", "fuel", "thrust")
_BY_UNIT = {
    "degC": "temperature", "kN": "thrust", "Nm": "thrust", "kPa": "thrust", "kW": "fuel",
}  # fmt: skip


def similarity(name: str) -> str:
    """One of `SIMILARITY` for a channel; "plain" where its name and unit do not settle it."""
    if name in SPOOLS:
        return "speed"
    return "fuel" if name == "FF_kgph" else _BY_UNIT.get(described(name).unit, "plain")


def corrected_scale(name: str, air: AirState) -> tuple[FloatArray | float, float]:
    """Scale s and offset o of channel `name`, so that (value + o) / s is its corrected value.

    Spool speeds refer to sqrt(theta2), temperatures (in K) to theta2, fuel flow and power to
    delta2 sqrt(theta2), thrust, torque and pressure to delta2 (Walsh and Fletcher 2004, Gas
    Turbine Performance, section 4.3). A speed in rpm may be that of a governed propeller.
    """
    kind = similarity(name)
    if kind == "speed":
        return np.sqrt(air.theta2), 0.0
    if kind == "temperature":
        return air.theta2, KELVIN
    if kind == "fuel":
        return air.delta2 * np.sqrt(air.theta2), 0.0
    return (air.delta2, 0.0) if kind == "thrust" else (1.0, 0.0)


def mach_of_cas(cas_kt: ArrayLike, alt_ft: ArrayLike) -> FloatArray:
    """Mach number at calibrated airspeed [kt] and pressure altitude [ft], broadcast, subsonic.

    Impact pressure `qc = p0 ((1 + 0.2 (V/a0)^2)^3.5 - 1)` is what an airspeed indicator
    measures, and `qc/p = (1 + 0.2 M^2)^3.5 - 1` (any compressible-flow text).
    """
    speed = np.asarray(cas_kt, dtype=np.float64) / SOUND_KT
    impact = P0_PA * np.expm1(3.5 * np.log1p(0.2 * speed**2))
    return np.asarray(np.sqrt(5.0 * np.expm1(np.log1p(impact / isa(alt_ft)[1]) / 3.5)))


def cas_of_mach(mach: ArrayLike, alt_ft: ArrayLike) -> FloatArray:
    """Calibrated airspeed [kt] at a Mach number and pressure altitude [ft]: the inverse."""
    ratio = np.expm1(3.5 * np.log1p(0.2 * np.asarray(mach, dtype=np.float64) ** 2))
    impact = ratio * isa(alt_ft)[1] / P0_PA
    return np.asarray(SOUND_KT * np.sqrt(5.0 * np.expm1(np.log1p(impact) / 3.5)))


def static_temperature(total_c: ArrayLike, mach: ArrayLike, recovery: float = 1.0) -> FloatArray:
    """Static temperature [degC] from that of a total probe: `T = Tt / (1 + 0.2 r M^2)`."""
    rise = 1.0 + 0.2 * recovery * np.asarray(mach, dtype=np.float64) ** 2
    return np.asarray((np.asarray(total_c, dtype=np.float64) + KELVIN) / rise - KELVIN)


def total_ratios(alt_ft: float, mach: float, dt_c: float) -> tuple[float, float]:
    """`theta2` and `delta2` of `air_state` for one sample, in scalar code that numba compiles."""
    height = min(alt_ft * FT_M, _TOP_M)
    standard = T0_K - _LAPSE * min(height, _TROPOPAUSE_M)
    pressure = (standard / T0_K) ** (_G / (_R * _LAPSE))
    pressure *= math.exp(-_G * max(height - _TROPOPAUSE_M, 0.0) / (_R * _TROPOPAUSE_K))
    rise = 1.0 + 0.5 * (GAMMA - 1.0) * mach**2
    return (standard + dt_c) / T0_K * rise, pressure * rise ** (GAMMA / (GAMMA - 1.0))
