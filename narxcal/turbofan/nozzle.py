"""A convergent nozzle: flow, velocity and gross thrust, choked or not."""

from __future__ import annotations

import math
from typing import NamedTuple

from narxcal.turbofan.compiled import compiled
from narxcal.turbofan.gas import gas_constant, specific_heat

_KNEE = 1.0005  # pressure ratio below which the flow goes on straight, through zero


class Jet(NamedTuple):
    """What leaves a nozzle: capacity `W sqrt(T) / (P A)`, SI, and gross thrust per kg/s of flow."""

    capacity: float
    velocity_mps: float
    pressure_thrust: float  # (p_exit - p_ambient) / P_total


@compiled
def _subsonic_mach(pressure_ratio: float, gamma: float) -> float:
    return math.sqrt(2.0 / (gamma - 1.0) * (pressure_ratio ** ((gamma - 1.0) / gamma) - 1.0))


@compiled
def jet(total_K: float, far: float, pressure_ratio: float) -> Jet:
    """Isentropic expansion from total conditions over `pressure_ratio` = P / p_ambient.

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
