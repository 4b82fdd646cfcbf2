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
from typing import Protocol

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
        """Return the same, `seconds` later."""
        return Switched(self.channel, self.start_s + seconds, self.stop_s + seconds)


class Manoeuvre(Protocol):
    """Motion of one lever between 0 and `duration_s`."""

    @property
    def duration_s(self) -> float:
        """Length in s."""

    @property
    def net_deg(self) -> float:
        """Change of angle from start to end."""

    @property
    def reach_deg(self) -> tuple[float, float]:
        """Lowest and highest swing: at most and at least 0."""

    @property
    def switched(self) -> tuple[Switched, ...]:
        """Switches inverted during the manoeuvre."""

    def swing_deg(self, time_s: FloatArray) -> FloatArray:
        """Angle from the start at `time_s` `(time,)`: 0 before the start, `net_deg` after it."""


@dataclass(frozen=True)
class Corners:
    """Linear interpolation between `points`, (time in s, angle from the start in deg).

    The first point is (0, 0). Two points at one time are a step at that time.
    Raises `ConfigError` for points that are not in order of time.
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
        """Time of the last corner."""
        return self.points[-1][0]

    @property
    def net_deg(self) -> float:
        """Angle of the last corner."""
        return self.points[-1][1]

    @property
    def reach_deg(self) -> tuple[float, float]:
        """Lowest and highest corner."""
        angles = [angle for _, angle in self.points]
        return min(angles), max(angles)

    def swing_deg(self, time_s: FloatArray) -> FloatArray:
        """Interpolate between the corners."""
        times, angles = np.array(self.points).T
        # At two points of one time `interp` returns the later one.
        return np.where(time_s < 0.0, 0.0, np.interp(time_s, times, angles))


@dataclass(frozen=True)
class Sweep:
    """Frequency sweep `A sin(phi)` from `low_hz` to `high_hz` in about `wanted_s`.

    With `k = high_hz / low_hz` and `T` the duration, phi over 2 pi is
    `low_hz t + (high_hz - low_hz) t^2 / (2 T)` (linear) or `low_hz T (k^(t/T) - 1) / ln k`
    (logarithmic: equal time per octave). `T` is the duration nearest to `wanted_s` with a whole
    number of cycles, so that the lever returns to its start.
    Raises `ConfigError` unless `0 < low_hz < high_hz` and there is time for half a cycle.
    """

    amplitude_deg: float
    low_hz: float
    high_hz: float
    wanted_s: float
    logarithmic: bool = True
    switched: tuple[Switched, ...] = ()

    def __post_init__(self) -> None:
        if not 0.0 < self.low_hz < self.high_hz:
            raise ConfigError(
                f"a sweep goes from a low to a higher frequency, got {self.low_hz:g} .. "
                f"{self.high_hz:g} Hz"
            )
        if self.wanted_s * self._mean_hz < 0.5:
            raise ConfigError(
                f"a sweep of {self.wanted_s:g} s has no time for one cycle of about "
                f"{self._mean_hz:g} Hz",
                hint="Give it more time or a higher frequency",
            )

    @property
    def _mean_hz(self) -> float:
        """Cycles per second over the whole sweep."""
        if self.logarithmic:
            return (self.high_hz - self.low_hz) / math.log(self.high_hz / self.low_hz)
        return 0.5 * (self.low_hz + self.high_hz)

    @property
    def cycles(self) -> int:
        """Whole number of cycles."""
        return max(1, round(self.wanted_s * self._mean_hz))

    @property
    def duration_s(self) -> float:
        """Time of the whole cycles."""
        return self.cycles / self._mean_hz

    @property
    def net_deg(self) -> float:
        """Zero: the sweep ends at its start."""
        return 0.0

    @property
    def reach_deg(self) -> tuple[float, float]:
        """One amplitude either way."""
        return -abs(self.amplitude_deg), abs(self.amplitude_deg)

    def phase_rad(self, time_s: FloatArray) -> FloatArray:
        """Phase at `time_s` `(time,)` within the sweep."""
        ratio, length = self.high_hz / self.low_hz, self.duration_s
        if self.logarithmic:
            cycles = self.low_hz * length * (ratio ** (time_s / length) - 1.0) / math.log(ratio)
        else:
            cycles = self.low_hz * time_s
            cycles = cycles + (self.high_hz - self.low_hz) * time_s**2 / (2.0 * length)
        return 2.0 * np.pi * cycles

    def swing_deg(self, time_s: FloatArray) -> FloatArray:
        """Sine of the phase."""
        within = (time_s > 0.0) & (time_s < self.duration_s)
        inside = np.clip(time_s, 0.0, self.duration_s)
        return np.where(within, self.amplitude_deg * np.sin(self.phase_rad(inside)), 0.0)


@dataclass(frozen=True)
class ManoeuvreSequence:
    """Manoeuvres one after another; each begins at the final angle of the one before."""

    parts: tuple[Manoeuvre, ...]

    @classmethod
    def of(cls, *parts: Manoeuvre) -> ManoeuvreSequence:
        """Join `parts`."""
        return cls(parts)

    @property
    def starts_s(self) -> tuple[float, ...]:
        """When each part begins."""
        lengths = [part.duration_s for part in self.parts]
        return (0.0, *itertools.accumulate(lengths))[: len(lengths)]

    @property
    def duration_s(self) -> float:
        """Sum of the parts."""
        return sum(part.duration_s for part in self.parts)

    @property
    def net_deg(self) -> float:
        """Sum of the parts."""
        return sum(part.net_deg for part in self.parts)

    @property
    def reach_deg(self) -> tuple[float, float]:
        """Extremes over all parts."""
        level, low, high = 0.0, 0.0, 0.0
        for part in self.parts:
            below, above = part.reach_deg
            low, high = min(low, level + below), max(high, level + above)
            level += part.net_deg
        return low, high

    @property
    def switched(self) -> tuple[Switched, ...]:
        """Switches that any part inverts."""
        return tuple(
            flip.later(start)
            for start, part in zip(self.starts_s, self.parts, strict=True)
            for flip in part.switched
        )

    def swing_deg(self, time_s: FloatArray) -> FloatArray:
        """Sum of the parts: each is 0 before its start and constant after its end."""
        total = np.zeros_like(time_s, dtype=np.float64)
        for start, part in zip(self.starts_s, self.parts, strict=True):
            total += part.swing_deg(time_s - start)
        return total


# Fastest rate of a hand: the whole travel in half a second; and rates of manoeuvres.
HAND_DEG_S = 170.0
SLAM_DEG_S, FAST_DEG_S, SLOW_DEG_S = 120.0, 40.0, 4.0


def hold(seconds: float) -> Corners:
    """Keep the lever constant."""
    return Corners(((0.0, 0.0), (_time("a hold", seconds), 0.0)))


def travel(by_deg: float, rate_deg_s: float) -> Corners:
    """Move the lever by `by_deg` (negative: back) at a constant rate."""
    return Corners(((0.0, 0.0), (abs(by_deg) / _rate(rate_deg_s), by_deg)))


def levels(stays: Iterable[tuple[float, float]], rate_deg_s: float) -> Corners:
    """Move to each (angle from the start, seconds) in turn; the seconds include the movement.

    Raises `ConfigError` where the seconds are too few for the movement.
    """
    clock, angle = 0.0, 0.0
    points = [(clock, angle)]
    for target, seconds in stays:
        way = abs(target - angle) / _rate(rate_deg_s)
        if way > seconds:
            raise ConfigError(
                f"the lever needs {way:.3g} s to get to {target:g} deg at {rate_deg_s:g} deg/s, "
                f"and its stay there is over after {seconds:.3g} s",
                hint="Let it stay longer, move less or faster",
            )
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
    quarter = abs(amplitude_deg) / _rate(rate_deg_s)
    corners = [((2 * k + 1) * quarter, amplitude_deg * (-1) ** k) for k in range(2 * cycles)]
    return Corners(((0.0, 0.0), *corners, (4 * cycles * quarter, 0.0)))


def reslam(
    down_deg: float, pause_s: float, then_s: float = 15.0, rate_deg_s: float = SLAM_DEG_S
) -> Corners:
    """Chop, and slam back before the engine is in equilibrium."""
    down = -abs(down_deg)
    way = abs(down) / _rate(rate_deg_s)
    return levels([(down, way + pause_s), (0.0, way + then_s)], rate_deg_s)


def switch(channel: str, on_s: float, before_s: float = 5.0, after_s: float = 20.0) -> Corners:
    """Invert bleed or anti-ice for `on_s` while the lever is constant."""
    end = before_s + _time("a switch", on_s) + after_s
    return Corners(((0.0, 0.0), (end, 0.0)), (Switched(channel, before_s, before_s + on_s),))


def _rate(rate_deg_s: float) -> float:
    if not 0.0 < rate_deg_s <= HAND_DEG_S:
        raise ConfigError(
            f"a hand moves the lever at up to {HAND_DEG_S:g} deg/s, got {rate_deg_s:g} deg/s",
            hint="A step or an impulse is instantaneous",
        )
    return rate_deg_s


def _time(what: str, seconds: float) -> float:
    if not 0.0 < seconds < math.inf:
        raise ConfigError(f"{what} takes a positive time, got {seconds:g} s")
    return seconds
