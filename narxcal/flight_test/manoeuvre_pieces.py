"""Pieces that lever manoeuvres are made of: corner points, frequency sweeps, and pieces in a row.

A piece says how far the lever is from where the piece began (`swing_deg`), over a time axis of its
own that begins at 0. Because every piece is relative, joined pieces are continuous by construction.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from narxcal.errors import ConfigError

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Switched:
    """A switch channel that is the other way round from `start_s` until before `stop_s`."""

    channel: str
    start_s: float
    stop_s: float

    def later(self, seconds: float) -> Switched:
        """The same, `seconds` later."""
        return Switched(self.channel, self.start_s + seconds, self.stop_s + seconds)


class Manoeuvre(Protocol):
    """What the pilot does with one lever between 0 and `duration_s`."""

    @property
    def duration_s(self) -> float:
        """How long it takes."""

    @property
    def net_deg(self) -> float:
        """Where the lever ends, from where it began."""

    @property
    def reach_deg(self) -> tuple[float, float]:
        """Lowest and highest swing: never above, never below 0."""

    @property
    def fastest_deg_s(self) -> float:
        """Highest rate of the lever; infinite for a step."""

    @property
    def switched(self) -> tuple[Switched, ...]:
        """What is flipped meanwhile."""

    def swing_deg(self, time_s: FloatArray) -> FloatArray:
        """Angle from the start at `time_s` `(time,)`: 0 before the start, `net_deg` after it."""


@dataclass(frozen=True)
class Corners:
    """Straight lines between `points`, (time in s, angle from the start in deg).

    The first point is (0, 0). Two points at one time are a step, which counts from that time on.
    Raises `ConfigError` for points that are not in order of time.
    """

    points: tuple[tuple[float, float], ...]
    switched: tuple[Switched, ...] = ()

    def __post_init__(self) -> None:
        times = [time for time, _ in self.points]
        ordered = all(before <= after for before, after in itertools.pairwise(times))
        if not self.points or self.points[0] != (0.0, 0.0) or not ordered:
            raise ConfigError(
                f"corner points have to begin at (0, 0) and go on in order of time, got "
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

    @property
    def fastest_deg_s(self) -> float:
        """Steepest line."""
        return max(
            (
                abs(angle - before) / (time - start) if time > start else math.inf
                for (start, before), (time, angle) in itertools.pairwise(self.points)
                if angle != before
            ),
            default=0.0,
        )

    def swing_deg(self, time_s: FloatArray) -> FloatArray:
        """Interpolate between the corners."""
        times, angles = np.array(self.points).T
        # Behind two points at one time `interp` gives the later one from that very time on.
        return np.where(time_s < 0.0, 0.0, np.interp(time_s, times, angles))


@dataclass(frozen=True)
class Sweep:
    """Frequency sweep `A sin(phi)` from `low_hz` to `high_hz` in about `wanted_s`.

    With `k = high_hz / low_hz` and `T` the duration, phi over 2 pi is
    `low_hz t + (high_hz - low_hz) t^2 / (2 T)` (linear) or `low_hz T (k^(t/T) - 1) / ln k`
    (logarithmic: equal time per octave). `T` is the one nearest to `wanted_s` that ends on a
    whole number of cycles, so the lever comes back to where it began.
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
        """Nothing: the sweep ends where it began."""
        return 0.0

    @property
    def reach_deg(self) -> tuple[float, float]:
        """One amplitude either way."""
        return -abs(self.amplitude_deg), abs(self.amplitude_deg)

    @property
    def fastest_deg_s(self) -> float:
        """Rate through the middle at the highest frequency."""
        return 2.0 * math.pi * self.high_hz * abs(self.amplitude_deg)

    def phase_rad(self, time_s: FloatArray) -> FloatArray:
        """Phase at `time_s` `(time,)` within the sweep."""
        ratio, length = self.high_hz / self.low_hz, self.duration_s
        if self.logarithmic:
            turns = self.low_hz * length * (ratio ** (time_s / length) - 1.0) / math.log(ratio)
        else:
            turns = self.low_hz * time_s
            turns = turns + (self.high_hz - self.low_hz) * time_s**2 / (2.0 * length)
        return 2.0 * np.pi * turns

    def swing_deg(self, time_s: FloatArray) -> FloatArray:
        """Sine of the phase."""
        within = (time_s > 0.0) & (time_s < self.duration_s)
        inside = np.clip(time_s, 0.0, self.duration_s)
        return np.where(within, self.amplitude_deg * np.sin(self.phase_rad(inside)), 0.0)


@dataclass(frozen=True)
class Sequence:
    """Manoeuvres one after another; each begins where the one before has left the lever."""

    parts: tuple[Manoeuvre, ...]

    @classmethod
    def of(cls, *parts: Manoeuvre) -> Sequence:
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
    def fastest_deg_s(self) -> float:
        """Fastest of the parts."""
        return max((part.fastest_deg_s for part in self.parts), default=0.0)

    @property
    def switched(self) -> tuple[Switched, ...]:
        """What any part flips."""
        return tuple(
            flip.later(start)
            for start, part in zip(self.starts_s, self.parts, strict=True)
            for flip in part.switched
        )

    def swing_deg(self, time_s: FloatArray) -> FloatArray:
        """Sum of the parts: each is 0 before it begins and stays where it ended."""
        total = np.zeros_like(time_s, dtype=np.float64)
        for start, part in zip(self.starts_s, self.parts, strict=True):
            total += part.swing_deg(time_s - start)
        return total
