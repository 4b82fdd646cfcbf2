"""Lever manoeuvres: pieces (corner points, sweeps, sequences), and the named ones made of them.

A manoeuvre is the change of the lever angle since its start (`swing_deg`), over a time axis of its
own that begins at 0. As every manoeuvre is relative, a sequence is continuous by construction.

Not modelled: tremor of the hand, friction and play of the lever, which are effects of the engine's
linkage.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import ClassVar, TypeAlias

import numpy as np

from narxcal.support.arrays import FloatArray
from narxcal.support.errors import ConfigError


@dataclass(frozen=True)
class Switched:
    """A switch channel that is inverted for `start_s <= t < stop_s`."""

    channel: str
    start_s: float
    stop_s: float

    def later(self, seconds: float) -> Switched:
        return Switched(self.channel, self.start_s + seconds, self.stop_s + seconds)


@dataclass(frozen=True)
class Corners:
    """Linear interpolation between `points`, (time in s, angle from the start in deg).

    The first point is (0, 0). Two points at one time are a step at that time. `switched` are the
    switches inverted meanwhile. Raises `ConfigError` for points that are not in order of time.
    """

    points: tuple[tuple[float, float], ...]
    switched: tuple[Switched, ...] = ()

    def __post_init__(self) -> None:
        times = [time for time, _ in self.points]
        ordered = all(before <= after for before, after in itertools.pairwise(times))
        if not self.points or self.points[0] != (0.0, 0.0) or not ordered:
            raise ConfigError(
                f"corner points have to begin at (0, 0) and be in order of time, got "
                f"{list(self.points[:4])}"
            )

    @property
    def duration_s(self) -> float:
        return self.points[-1][0]

    @property
    def net_deg(self) -> float:
        return self.points[-1][1]

    @property
    def reach_deg(self) -> tuple[float, float]:
        angles = [angle for _, angle in self.points]
        return min(angles), max(angles)

    def swing_deg(self, time_s: FloatArray) -> FloatArray:
        """Angle from the start at `time_s` `(time,)`: 0 before it, `net_deg` after the end."""
        times, angles = np.array(self.points).T
        # At two points of one time `interp` returns the later one.
        return np.where(time_s < 0.0, 0.0, np.interp(time_s, times, angles))


@dataclass(frozen=True)
class Sweep:
    """Frequency sweep `A sin(phi)` from `low_hz` to `high_hz` in about `wanted_s`.

    With `k = high_hz / low_hz` and `T` the duration, phi over 2 pi is
    `low_hz T (k^(t/T) - 1) / ln k` (equal time per octave). `T` is the duration nearest to
    `wanted_s` with a whole number of cycles, so that the lever returns to its start.
    """

    amplitude_deg: float
    low_hz: float
    high_hz: float
    wanted_s: float
    switched: ClassVar[tuple[Switched, ...]] = ()
    net_deg: ClassVar[float] = 0.0  # it ends at its start

    @property
    def duration_s(self) -> float:
        mean_hz = (self.high_hz - self.low_hz) / math.log(self.high_hz / self.low_hz)
        return max(1, round(self.wanted_s * mean_hz)) / mean_hz

    @property
    def reach_deg(self) -> tuple[float, float]:
        return -abs(self.amplitude_deg), abs(self.amplitude_deg)

    def swing_deg(self, time_s: FloatArray) -> FloatArray:
        """Angle from the start at `time_s` `(time,)`: 0 before the start and after the end."""
        ratio, length = self.high_hz / self.low_hz, self.duration_s
        within = (time_s > 0.0) & (time_s < length)
        inside = np.clip(time_s, 0.0, length)
        cycles = self.low_hz * length * (ratio ** (inside / length) - 1.0) / math.log(ratio)
        return np.where(within, self.amplitude_deg * np.sin(2.0 * np.pi * cycles), 0.0)


Manoeuvre: TypeAlias = Corners | Sweep


def sequence(*parts: Corners) -> Corners:
    """Join `parts`: each begins at the final angle of the one before."""
    points, switched, start_s, angle = [(0.0, 0.0)], list[Switched](), 0.0, 0.0
    for part in parts:
        points += [(start_s + time_s, angle + by_deg) for time_s, by_deg in part.points[1:]]
        switched += [flip.later(start_s) for flip in part.switched]
        start_s, angle = points[-1]
    return Corners(tuple(points), tuple(switched))


# Fastest rate of a hand: the whole travel in half a second; and rates of manoeuvres.
HAND_DEG_S = 170.0
SLAM_DEG_S, FAST_DEG_S, SLOW_DEG_S = 120.0, 40.0, 4.0
_BEFORE_S = 5.0  # of constant lever, before a switch


def hold(seconds: float) -> Corners:
    return Corners(((0.0, 0.0), (seconds, 0.0)))


def travel(by_deg: float, rate_deg_s: float) -> Corners:
    return Corners(((0.0, 0.0), (abs(by_deg) / rate_deg_s, by_deg)))


def levels(stays: Iterable[tuple[float, float]], rate_deg_s: float) -> Corners:
    """Move to each (angle from the start, seconds) in turn; the seconds include the movement."""
    clock, angle = 0.0, 0.0
    points = [(clock, angle)]
    for target, seconds in stays:
        way = abs(target - angle) / rate_deg_s
        points += [(clock + way, target), (clock + seconds, target)]
        clock, angle = clock + seconds, target
    return Corners(tuple(points))


def doublet(amplitude_deg: float, unit_s: float, rate_deg_s: float = FAST_DEG_S) -> Corners:
    """Up for `unit_s`, down for as long, and back."""
    return levels([(amplitude_deg, unit_s), (-amplitude_deg, unit_s), (0.0, unit_s)], rate_deg_s)


def three_two_one_one(
    amplitude_deg: float, unit_s: float, rate_deg_s: float = FAST_DEG_S
) -> Corners:
    """Up for three units, down for two, up for one, down for one, back: short and broad-band."""
    signs = ((1, 3), (-1, 2), (1, 1), (-1, 1), (0, 1))
    return levels([(sign * amplitude_deg, units * unit_s) for sign, units in signs], rate_deg_s)


def ladder(sizes_deg: Iterable[float], stay_s: float, rate_deg_s: float = FAST_DEG_S) -> Corners:
    """Move by each size and back: a rate limit delays in proportion to size, a lag does not."""
    stays = [(level, stay_s) for size in sizes_deg for level in (size, 0.0)]
    return levels(stays, rate_deg_s)


def reversals(amplitude_deg: float, rate_deg_s: float, cycles: int = 3) -> Corners:
    """Small triangles about one trim: play has the same effect at every rate, a lag has not."""
    quarter = abs(amplitude_deg) / rate_deg_s
    corners = [((2 * k + 1) * quarter, amplitude_deg * (-1) ** k) for k in range(2 * cycles)]
    return Corners(((0.0, 0.0), *corners, (4 * cycles * quarter, 0.0)))


def reslam(
    down_deg: float, pause_s: float, then_s: float = 15.0, rate_deg_s: float = SLAM_DEG_S
) -> Corners:
    """Chop, and slam back before the engine is in equilibrium."""
    down = -abs(down_deg)
    way = abs(down) / rate_deg_s
    return levels([(down, way + pause_s), (0.0, way + then_s)], rate_deg_s)


def switch(channel: str, on_s: float, after_s: float) -> Corners:
    """Invert bleed or anti-ice for `on_s` while the lever is constant."""
    off_s = _BEFORE_S + on_s
    return Corners(((0.0, 0.0), (off_s + after_s, 0.0)), (Switched(channel, _BEFORE_S, off_s),))
