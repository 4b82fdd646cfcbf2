"""Properties of dry air and of the products of burning kerosene in it.

Polynomials in `t = T / 1000 K` of Walsh & Fletcher, *Gas Turbine Performance*, 2nd ed., formulae
F3.23 to F3.27, valid from 200 K to 2000 K. `far` is the ratio of fuel to air by mass; all
properties are per kg of mixture. Dissociation and humidity are left out.
"""

from __future__ import annotations

import math

from narxcal.turbofan.compiled import compiled

LOWER_HEATING_VALUE = 43.12e6  # J/kg, kerosene at 298 K (Walsh & Fletcher, chapter 13)
REFERENCE_K = 298.15  # where the heating value is stated

# Dry air, and what each share `far / (1 + far)` of fuel adds: kJ/(kg K).
_A = (0.992313, 0.236688, -1.852148, 6.083152, -8.893933, 7.097112, -3.234725, 0.794571, -0.081873)
_B = (-0.718874, 8.747481, -15.863157, 17.254096, -10.233795, 3.081778, -0.361112, -0.003919)
_A_ENTHALPY, _B_ENTHALPY = 0.422178, 0.0555930
_A_ENTROPY, _B_ENTROPY = 0.001053, -0.0016079
_R_AIR, _R_FUEL = 287.05, -0.0099  # J/(kg K), and its change with `far`


@compiled
def gas_constant(far: float) -> float:
    """Gas constant in J/(kg K) (F3.22: 287.05 - 0.0099 far + 1e-7 far^2)."""
    return _R_AIR + _R_FUEL * far + 1e-7 * far * far


@compiled
def specific_heat(temperature_K: float, far: float) -> float:
    """Specific heat at constant pressure, J/(kg K) (F3.23)."""
    t = 1e-3 * temperature_K
    air = 0.0
    for k in range(len(_A) - 1, -1, -1):
        air = air * t + _A[k]
    fuel = 0.0
    for k in range(len(_B) - 1, -1, -1):
        fuel = fuel * t + _B[k]
    return 1e3 * (air + far / (1.0 + far) * fuel)


@compiled
def enthalpy(temperature_K: float, far: float) -> float:
    """Enthalpy in J/kg, the integral of the specific heat (F3.26)."""
    t = 1e-3 * temperature_K
    air = 0.0
    for k in range(len(_A) - 1, -1, -1):
        air = (air + _A[k] / (k + 1)) * t
    fuel = 0.0
    for k in range(len(_B) - 1, -1, -1):
        fuel = (fuel + _B[k] / (k + 1)) * t
    share = far / (1.0 + far)
    return 1e6 * (air + _A_ENTHALPY + share * (fuel + _B_ENTHALPY))


@compiled
def entropy(temperature_K: float, far: float) -> float:
    """Entropy function, the integral of `cp / T`, J/(kg K) (F3.27)."""
    t = 1e-3 * temperature_K
    air = 0.0
    for k in range(len(_A) - 1, 0, -1):
        air = (air + _A[k] / k) * t
    fuel = 0.0
    for k in range(len(_B) - 1, 0, -1):
        fuel = (fuel + _B[k] / k) * t
    share = far / (1.0 + far)
    logarithm = math.log(t)
    air += _A[0] * logarithm + _A_ENTROPY
    fuel += _B[0] * logarithm + _B_ENTROPY
    return 1e3 * (air + share * fuel)


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

    The heating value is stated at `REFERENCE_K`, and so are the enthalpies it joins: fuel
    enters at that temperature.
    """
    at_reference = enthalpy_in - enthalpy(REFERENCE_K, 0.0)
    heat = efficiency * far * LOWER_HEATING_VALUE
    return (at_reference + heat) / (1.0 + far) + enthalpy(REFERENCE_K, far)
