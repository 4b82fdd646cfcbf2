"""Gas properties of air and burnt kerosene, the intake and the convergent nozzle.

Properties are polynomials in `t = T / 1000 K` of Walsh & Fletcher, *Gas Turbine Performance*, 2nd
ed., formulae F3.23 to F3.27, valid from 200 K to 2000 K. `far` is the ratio of fuel to air by mass;
all properties are per kg of mixture. Dissociation and humidity are left out.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from narxcal.atmosphere import P0_PA, T0_K
from narxcal.support.compiled import compiled

LOWER_HEATING_VALUE = 43.12e6  # J/kg, kerosene at 298 K (Walsh & Fletcher, chapter 13)
REFERENCE_K = 298.15  # where the heating value is stated

# Dry air, and what each share `far / (1 + far)` of fuel adds: kJ/(kg K).
_A = (0.992313, 0.236688, -1.852148, 6.083152, -8.893933, 7.097112, -3.234725, 0.794571, -0.081873)
_B = (-0.718874, 8.747481, -15.863157, 17.254096, -10.233795, 3.081778, -0.361112, -0.003919)
_A_ENTHALPY, _B_ENTHALPY = 0.422178, 0.0555930
_A_ENTROPY, _B_ENTROPY = 0.001053, -0.0016079
_R_AIR, _R_FUEL = 287.05, -0.0099  # J/(kg K), and its change with `far`
# The same integrated over t, and over ln t but for its first term.
_A_RISE, _B_RISE = (tuple(c / (k + 1) for k, c in enumerate(each)) for each in (_A, _B))
_A_LOG, _B_LOG = (tuple(c / k for k, c in enumerate(each) if k) for each in (_A, _B))


@compiled
def _polynomial(coefficients: tuple[float, ...], t: float) -> float:
    value = 0.0
    for k in range(len(coefficients) - 1, -1, -1):
        value = value * t + coefficients[k]
    return value


@compiled
def gas_constant(far: float) -> float:
    """Gas constant in J/(kg K) (F3.22: 287.05 - 0.0099 far + 1e-7 far^2)."""
    return _R_AIR + _R_FUEL * far + 1e-7 * far * far


@compiled
def specific_heat(temperature_K: float, far: float) -> float:
    """Specific heat at constant pressure, J/(kg K) (F3.23)."""
    t = 1e-3 * temperature_K
    return 1e3 * (_polynomial(_A, t) + far / (1.0 + far) * _polynomial(_B, t))


@compiled
def enthalpy(temperature_K: float, far: float) -> float:
    """Enthalpy in J/kg, the integral of the specific heat (F3.26)."""
    t = 1e-3 * temperature_K
    air, fuel = _polynomial(_A_RISE, t) * t, _polynomial(_B_RISE, t) * t
    return 1e6 * (air + _A_ENTHALPY + far / (1.0 + far) * (fuel + _B_ENTHALPY))


@compiled
def entropy(temperature_K: float, far: float) -> float:
    """Entropy function, the integral of `cp / T`, J/(kg K) (F3.27)."""
    t = 1e-3 * temperature_K
    logarithm = math.log(t)
    air = _polynomial(_A_LOG, t) * t + (_A[0] * logarithm + _A_ENTROPY)
    fuel = _polynomial(_B_LOG, t) * t + (_B[0] * logarithm + _B_ENTROPY)
    return 1e3 * (air + far / (1.0 + far) * fuel)


@compiled
def temperature_at_enthalpy(target: float, far: float, guess_K: float) -> float:
    """Temperature in K at which the enthalpy is `target`: Newton, to rounding."""
    temperature = guess_K
    for _ in range(50):
        step = (target - enthalpy(temperature, far)) / specific_heat(temperature, far)
        temperature = min(max(temperature + step, 120.0), 4000.0)
        if abs(step) < 1e-10 * temperature:
            break
    return temperature


@compiled
def isentropic_temperature(temperature_K: float, far: float, pressure_ratio: float) -> float:
    """Temperature in K after an isentropic change of pressure by `pressure_ratio` (F3.27)."""
    r = gas_constant(far)
    rise = r * math.log(pressure_ratio)
    target = entropy(temperature_K, far) + rise
    after = temperature_K * math.exp(rise / specific_heat(temperature_K, far))
    for _ in range(50):
        step = (target - entropy(after, far)) * after / specific_heat(after, far)
        after = min(max(after + step, 120.0), 4000.0)
        if abs(step) < 1e-10 * after:
            break
    return after


@compiled
def burnt_enthalpy(enthalpy_in: float, far: float, efficiency: float) -> float:
    """Enthalpy in J/kg of the products of burning `far` kg of fuel per kg of air at `enthalpy_in`.

    The heating value is stated at `REFERENCE_K`, the temperature at which fuel enters.
    """
    at_reference = enthalpy_in - enthalpy(REFERENCE_K, 0.0)
    heat = efficiency * far * LOWER_HEATING_VALUE
    return (at_reference + heat) / (1.0 + far) + enthalpy(REFERENCE_K, far)


class Air(NamedTuple):
    """The air ahead of the engine and at the fan face: static, then total, SI units."""

    static_K: float
    static_Pa: float
    velocity_mps: float
    T2_K: float
    P2_Pa: float


@compiled
def intake(static_K: float, static_Pa: float, mach: float, recovery: float) -> Air:
    """Stagnate the air: total enthalpy is kept, and the share `recovery` of the total pressure."""
    r = gas_constant(0.0)
    cp = specific_heat(static_K, 0.0)
    velocity = mach * math.sqrt(cp / (cp - r) * r * static_K)
    total_enthalpy = enthalpy(static_K, 0.0) + 0.5 * velocity * velocity
    total = temperature_at_enthalpy(total_enthalpy, 0.0, static_K * (1.0 + 0.2 * mach * mach))
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
    return temperature_K / T0_K


@compiled
def delta(pressure_Pa: float) -> float:
    return pressure_Pa / P0_PA


_KNEE = 1.0005  # pressure ratio below which the flow is linear, through zero


class Jet(NamedTuple):
    """Flow through a nozzle: capacity `W sqrt(T) / (P A)` in SI units, velocity and thrust."""

    capacity: float
    velocity_mps: float
    pressure_thrust: float  # (p_exit - p_ambient) / P_total


@compiled
def _subsonic_mach(pressure_ratio: float, gamma: float) -> float:
    return math.sqrt(2.0 / (gamma - 1.0) * (pressure_ratio ** ((gamma - 1.0) / gamma) - 1.0))


@compiled
def jet(total_K: float, far: float, pressure_ratio: float) -> Jet:
    """Expand isentropically from total conditions over `pressure_ratio` = P / p_ambient.

    One-dimensional, with the ratio of specific heats at the total temperature (Saravanamuttoo,
    Rogers & Cohen, section 3.3).
    """
    r = gas_constant(far)
    cp = specific_heat(total_K, far)
    gamma = cp / (cp - r)
    critical = (0.5 * (gamma + 1.0)) ** (gamma / (gamma - 1.0))
    expanded = min(max(pressure_ratio, _KNEE), critical)
    mach = _subsonic_mach(expanded, gamma)
    heat = 1.0 + 0.5 * (gamma - 1.0) * mach * mach
    capacity = math.sqrt(gamma / r) * mach * heat ** (-0.5 * (gamma + 1.0) / (gamma - 1.0))
    velocity = mach * math.sqrt(gamma * r * total_K / heat)
    if pressure_ratio < _KNEE:  # no flow at a ratio of one, and backwards below
        capacity *= (pressure_ratio - 1.0) / (_KNEE - 1.0)
    surplus = 1.0 / expanded - 1.0 / max(pressure_ratio, _KNEE)
    return Jet(capacity, velocity, surplus)


@compiled
def capacity(total_K: float, far: float, pressure_ratio: float) -> float:
    """The capacity of `jet`, for callers in Python."""
    return jet(total_K, far, pressure_ratio).capacity
