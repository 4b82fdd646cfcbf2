"""The throttle linkage: from the pilot's lever to the resolver angle that the control reads.

In series: the play of the linkage, a limit on its rate, the delay of resolver and data bus, and
the bias of the pick-off. The Spey identification (DeHoff and Hall) needed a hysteresis and a
pick-off bias in the throttle; 1 to 3 % of travel are usual for a cable, 50 to 150 ms for resolver
and bus (both unverified). Nothing feeds back from the engine, so a whole log is computed at once.

Play, rate limit and delay are written here once more on purpose: blind cases of the diagnosis fly
this engine, and its equations must not be those that the diagnosis fits (`narxcal.effects`).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from narxcal.support.arrays import FloatArray
from narxcal.support.compiled import compiled
from narxcal.support.errors import ConfigError


class LeverParameters(NamedTuple):
    """Linkage and resolver; the defaults do not change the angle.

    Each parameter is one effect of the library: `backlash_deg` is `throttle_backlash`, the total
    width of the play; `delay_s` is `throttle_delay`; `rate_limit_degps` is `throttle_rate_limit`;
    `bias_deg`, added to what is read, is `throttle_bias`.
    """

    backlash_deg: float = 0.0
    delay_s: float = 0.0
    rate_limit_degps: float = math.inf
    bias_deg: float = 0.0


def resolver(tra_deg: FloatArray, dt_s: float, parameters: LeverParameters) -> FloatArray:
    """Resolver angle (time,) in deg for the lever `tra_deg` (time,) sampled every `dt_s`.

    Before its first sample the lever is assumed not to move, in the middle of its play.

    Raises `ConfigError` if a parameter is negative or not a number, a rate limit of zero included.
    """
    _check(parameters, dt_s)
    angle = np.asarray(tra_deg, dtype=np.float64)
    if parameters.backlash_deg > 0.0:
        angle = _play(angle, parameters.backlash_deg)
    if math.isfinite(parameters.rate_limit_degps):
        angle = _rate_limited(angle, parameters.rate_limit_degps * dt_s)
    if parameters.delay_s > 0.0:
        angle = _delayed(angle, parameters.delay_s / dt_s)
    return angle + parameters.bias_deg if parameters.bias_deg else angle.copy()


def _check(parameters: LeverParameters, dt_s: float) -> None:
    for name in ("backlash_deg", "delay_s"):
        value = getattr(parameters, name)
        if not (value >= 0.0 and math.isfinite(value)):
            raise ConfigError(f"lever: '{name}' has to be zero or more, found {value}")
    if not parameters.rate_limit_degps > 0.0:
        raise ConfigError(
            f"lever: 'rate_limit_degps' has to be above zero, found {parameters.rate_limit_degps}",
            hint="Leave it out for no limit",
        )
    if not math.isfinite(parameters.bias_deg):
        raise ConfigError(f"lever: 'bias_deg' has to be finite, found {parameters.bias_deg}")
    if not (dt_s > 0.0 and math.isfinite(dt_s)):
        raise ConfigError(f"lever: the sampling interval has to be above zero, found {dt_s} s")


@compiled
def _play(angle: FloatArray, width: float) -> FloatArray:
    """Play operator: the output moves only while the input pushes it."""
    moved = np.empty_like(angle)
    state = angle[0] if len(angle) else 0.0
    for k in range(len(angle)):
        state = min(max(state, angle[k] - 0.5 * width), angle[k] + 0.5 * width)
        moved[k] = state
    return moved


@compiled
def _rate_limited(angle: FloatArray, largest: float) -> FloatArray:
    """Follow `angle`, by no more than `largest` per sample."""
    moved = np.empty_like(angle)
    state = angle[0] if len(angle) else 0.0
    for k in range(len(angle)):
        gap = angle[k] - state
        state = angle[k] if abs(gap) <= largest else state + math.copysign(largest, gap)
        moved[k] = state
    return moved


def _delayed(angle: FloatArray, steps: float) -> FloatArray:
    """Delay by `steps` samples, which need not be whole, with linear interpolation."""
    index = np.arange(len(angle), dtype=np.float64)
    return np.interp(index - steps, index, angle) if len(angle) else angle
