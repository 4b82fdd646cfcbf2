"""From the pilot's lever to the N1 that the control commands.

**Linkage**, in series: its play, a limit on its rate, the delay of resolver and data bus, and the
bias of the pick-off. The Spey identification (DeHoff and Hall) needed a hysteresis and a pick-off
bias in the throttle; 1 to 3 % of travel are usual for a cable, 50 to 150 ms for resolver and bus
(both unverified). Nothing feeds back from the engine, so a whole log is computed at
once. Play, rate limit and delay are written here once more on purpose: blind cases of the diagnosis
fly this engine, and its equations must not be those that the diagnosis fits (`narxcal.effects`).

**Ratings**, idles, and the map from resolver angle to N1, are schedules in corrected N1,
`N1 / sqrt(theta2)`, which nearly determines a fan's thrust over `delta2`. A constant value up to
the corner temperature is thus a flat rating, and the decrease beyond it limits the temperature of
the gas. The command depends on flight condition and lever alone, not on the engine's state, so one
function computes it for a whole log and for a steady point. Numbers are typical of the class, not
those of an engine.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from narxcal.atmosphere import air_state
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
    """
    angle = np.asarray(tra_deg, dtype=np.float64)
    if parameters.backlash_deg > 0.0:
        angle = _play(angle, parameters.backlash_deg)
    if math.isfinite(parameters.rate_limit_degps):
        angle = _rate_limited(angle, parameters.rate_limit_degps * dt_s)
    if parameters.delay_s > 0.0:
        angle = _delayed(angle, parameters.delay_s / dt_s)
    return angle + parameters.bias_deg if parameters.bias_deg else angle.copy()


@compiled
def _play(angle: FloatArray, width: float) -> FloatArray:
    """Play operator: the output moves only while the input pushes it."""
    moved = np.empty_like(angle)
    state = angle[0]
    for k in range(len(angle)):
        state = min(max(state, angle[k] - 0.5 * width), angle[k] + 0.5 * width)
        moved[k] = state
    return moved


@compiled
def _rate_limited(angle: FloatArray, largest: float) -> FloatArray:
    """Follow `angle`, by no more than `largest` per sample."""
    moved = np.empty_like(angle)
    state = angle[0]
    for k in range(len(angle)):
        gap = angle[k] - state
        state = angle[k] if abs(gap) <= largest else state + math.copysign(largest, gap)
        moved[k] = state
    return moved


def _delayed(angle: FloatArray, steps: float) -> FloatArray:
    index = np.arange(len(angle), dtype=np.float64)
    return np.interp(index - steps, index, angle)


@dataclass(frozen=True, kw_only=True)
class Ratings:
    """All numbers of one engine's schedules; N1 in corrected %, unless said otherwise.

    `detents_deg` are the resolver angles of idle, cruise, climb and take-off. `cruise_pct`,
    `climb_pct`, `take_off_pct` are those of a standard day at `altitude_ft`, interpolated linearly
    and constant beyond the ends. Above `corner_dT_C` they decrease by `hot_slope_pct_per_C`: 1 degC
    costs about 3 degC of EGT (CFM56-7), and 10 degC of EGT correspond to 1 % N1. `N1_max_pct`
    limits physical N1. Each bleed lowers the ratings and, through the map, the lever positions
    next to them, but not the idles (FlyByWire's A32NX: packs 0.4 to 0.7, anti-ice 0.6 to 0.8 %
    each). Idles rise with altitude and, as the fan windmills, with Mach. With weight on wheels the
    ground idle applies, whatever `Approach` is.

    Effects: `idle_schedule` is a changed `approach_idle_pct`, `temperature_effect` is
    `temperature_bias_pct_per_C`, which adds to the command (in physical %) with `dT_C`.

    Raises `ConfigError` for idles in disorder, which a shifted approach idle can make.
    """

    take_off_pct: tuple[float, ...]
    climb_pct: tuple[float, ...]
    cruise_pct: tuple[float, ...]
    ground_idle_pct: float
    flight_idle_pct: float
    approach_idle_pct: float
    idle_pct_per_kft: float
    idle_pct_per_mach: float
    altitude_ft: tuple[float, ...] = (0.0, 10000.0, 20000.0, 30000.0, 40000.0)
    detents_deg: tuple[float, float, float, float] = (0.0, 58.0, 71.0, 85.0)
    corner_dT_C: float = 15.0
    hot_slope_pct_per_C: float = 0.28
    N1_max_pct: float = 104.0
    ecs_pct: float = 0.5
    nai_pct: float = 0.7
    wai_pct: float = 0.7
    temperature_bias_pct_per_C: float = 0.0

    def __post_init__(self) -> None:
        if not 0.0 < self.ground_idle_pct <= self.flight_idle_pct <= self.approach_idle_pct:
            raise ConfigError(
                "ratings: expected 0 < ground idle <= flight idle <= approach idle, found "
                f"{self.ground_idle_pct}, {self.flight_idle_pct}, {self.approach_idle_pct}"
            )


def n1_command(ratings: Ratings, inputs: ArrayLike) -> FloatArray:
    """N1 commanded, in % (...), for `inputs` (..., 9).

    The last axis is resolver angle in deg, ALT_ft, Mach, dT_C, WOW, Approach, ECS, NAI, WAI.
    Angles are clipped to the detents. NaN in, NaN out.
    """
    u = np.asarray(inputs, dtype=np.float64)
    root = np.sqrt(air_state(u[..., 1], u[..., 2], u[..., 3]).theta2)
    nodes = _nodes(ratings, u, ratings.N1_max_pct / root)
    angle = np.clip(u[..., 0], ratings.detents_deg[0], ratings.detents_deg[-1])
    corrected = _monotone(angle, np.array(ratings.detents_deg), nodes)
    return np.asarray(corrected * root + ratings.temperature_bias_pct_per_C * u[..., 3])


def idle(ratings: Ratings, inputs: ArrayLike) -> FloatArray:
    """Corrected idle N1 in % (...) for `inputs` as in `n1_command`."""
    u = np.asarray(inputs, dtype=np.float64)
    airborne = np.where(u[..., 5] > 0.5, ratings.approach_idle_pct, ratings.flight_idle_pct)
    base = np.where(u[..., 4] > 0.5, ratings.ground_idle_pct, airborne)
    rise = ratings.idle_pct_per_kft * 1e-3 * u[..., 1] + ratings.idle_pct_per_mach * u[..., 2]
    nan = 0.0 * (u[..., 4] + u[..., 5])  # NaN of a switch, too, gives NaN
    return np.asarray(base + rise + nan)


def _nodes(ratings: Ratings, u: FloatArray, ceiling: FloatArray) -> FloatArray:
    """Corrected N1 at the four detents, (4, ...), ascending."""
    hot = ratings.hot_slope_pct_per_C * np.maximum(u[..., 3] - ratings.corner_dT_C, 0.0)
    bleed = ratings.ecs_pct * u[..., 6] + ratings.nai_pct * u[..., 7] + ratings.wai_pct * u[..., 8]
    rated = [
        np.minimum(np.interp(u[..., 1], ratings.altitude_ft, line) - hot - bleed, ceiling)
        for line in (ratings.cruise_pct, ratings.climb_pct, ratings.take_off_pct)
    ]
    return np.stack([np.minimum(idle(ratings, u), rated[0]), *rated])


def _monotone(x: FloatArray, knots: FloatArray, values: FloatArray) -> FloatArray:
    """Interpolate smoothly and monotonically through `values` (n, ...) at `knots` (n,).

    Cubic Hermite pieces whose inner slopes are harmonic means of the neighbouring secants, which
    keeps them monotone (Fritsch & Butland, SIAM J. Sci. Stat. Comput. 5, 1984).
    """
    width = np.diff(knots)
    secant = np.diff(values, axis=0) / width.reshape(-1, *([1] * (values.ndim - 1)))
    total = secant[:-1] + secant[1:]
    inner = 2.0 * secant[:-1] * secant[1:] / np.where(total > 0.0, total, 1.0)
    slope = np.concatenate([secant[:1], inner, secant[-1:]])
    piece = np.clip(np.searchsorted(knots, x, side="right") - 1, 0, len(knots) - 2)
    t = (x - knots[piece]) / width[piece]

    column = np.arange(piece.size).reshape(piece.shape)

    def at(table: FloatArray, offset: int) -> FloatArray:
        return np.asarray(table.reshape(len(table), -1)[piece + offset, column])

    low, high = at(values, 0), at(values, 1)
    start, end = width[piece] * at(slope, 0), width[piece] * at(slope, 1)
    blend = t * t * (3.0 - 2.0 * t)
    return low + blend * (high - low) + t * (1.0 - t) * ((1.0 - t) * start - t * end)
