"""Heat of the metal in a lumped engine: it trails the gas by seconds (blades) or minutes (casings).

    soak   <- exp(-h / tau) (soak + share D)          heat taken from a move, given up later
    casing <- exp(-h / tau) casing                    heat left from before the run
    dm/dt = (f - m) / tau_m,     dn/dt = (m - n) / 80 s,     open = max(m - n, 0)

Clearances are open while the casing is colder than the metal inside it; they cost efficiency.

| symbol | meaning | unit |
|---|---|---|
| D | increment of an output's steady-state value over the step | of the output |
| share | part of it that appears as heat | - |
| h, tau | step; time constant | s |
| f, m, n | fuel; temperatures of metal and casing, as the core speed that they match | scaled |

Metal takes up heat in proportion to flow^0.8 (as in NASA's T-MATS), which is the slope of `tau_m`
over thin air; casings take 30 s to 300 s. All functions are for floats and for dual numbers.
"""

from __future__ import annotations

import math

from narxcal.support.compiled import compiled
from narxcal.support.dual import clip

_LOG_METAL_S, _BY_SPEED, _BY_AIR = 2.85, -0.5, 0.8  # ln tau_m: 17 s at half speed, sea level
_CASING_S = 80.0
_MOST_LOG = 5.0


@compiled(exact=False)
def soaked(soak: float, increment: float, log_tau: float, h: float) -> float:
    """Heat after a step, from that before it and share D."""
    return math.exp(-h / math.exp(log_tau)) * (soak + increment)


@compiled(exact=False)
def warmed(
    metal: float, casing: float, fuel: float, at: tuple[float, float, float]
) -> tuple[float, float]:
    """Return m and n after a step at `fuel`; `at` are the core's speed, `thin` and h."""
    v, thin, h = at
    log_tau = clip(_LOG_METAL_S + _BY_SPEED * v + _BY_AIR * thin, -_MOST_LOG, _MOST_LOG)
    metal = fuel + (metal - fuel) * math.exp(-h / math.exp(log_tau))
    return metal, metal + (casing - metal) * math.exp(-h / _CASING_S)


@compiled(exact=False)
def opening(metal: float, casing: float) -> float:
    return clip(metal - casing, 0.0, math.inf)
