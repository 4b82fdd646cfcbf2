"""Find the moves of the driving channel: where a push or a pull begins and where the lever stops.

Signals are `(time,)`, NaN where nothing was measured.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from narxcal.support.arrays import (
    BoolArray,
    FloatArray,
    bridge_gaps,
    long_runs,
    noise_level,
    robust_range,
    runs,
)

# A change has to exceed the driver's own noise by this many standard deviations.
_NOISE_FACTOR = 8.0
# The lever counts as moving while its rate exceeds this part of the move's peak rate.
_MOVING = 0.05
# A lever that pauses for less than this within one move has not finished it.
_PAUSE_S = 0.5
# The rate of a noisy driver is computed over at least this time, and this many standard
# deviations of the noise are no movement.
_RATE_S = 0.25
_RATE_NOISE = 4.0


@dataclass(frozen=True)
class Move:
    """The lever starts to move after sample `start` and has stopped at sample `stop`."""

    start: int
    stop: int
    sign: int


@dataclass(frozen=True)
class Driver:
    """The driving channel `(time,)`, gaps bridged, with its noise and range.

    `lost` marks samples of gaps too long to be bridged: no move reaches across them.
    """

    values: FloatArray
    lost: BoolArray
    noise: float
    span: float

    @classmethod
    def of(cls, channel: FloatArray, longest_gap: int) -> Driver:
        """Bridge NaN runs of at most `longest_gap` samples, measure noise and robust range."""
        known = np.isfinite(channel)
        if not known.any():
            return cls(np.zeros_like(channel), ~known, 0.0, 0.0)
        low, high = robust_range(channel)
        values = bridge_gaps(channel)
        return cls(values, long_runs(~known, longest_gap), noise_level(values), high - low)


def find_moves(driver: Driver, window: int, least: float, dt_s: float) -> list[Move]:
    """Find the moves that change the driver by at least `least` within `window` samples.

    Trend Intercept of the calibration paper, section 2.5: stretches in which the driver keeps
    moving one way, of which those stay that change it enough within the fixed window; each is
    tracked back to the sample where the lever left its resting position. `least` is raised to
    eight standard deviations of the driver's noise.
    """
    least = max(least, _NOISE_FACTOR * driver.noise)
    if least <= 0.0 or len(driver.values) <= window:
        return []
    # Half the mean rate of the least move: slower than this is drift.
    slowest = 0.5 * least / window
    width = _width(driver.noise, slowest, window, dt_s)
    rate = driver.values[width:] - driver.values[:-width]
    gaps = np.concatenate(([0], np.cumsum(driver.lost)))
    rate[gaps[width + 1 :] - gaps[: -width - 1] > 0] = 0.0
    threshold = max(slowest * width, _RATE_NOISE * driver.noise)
    search = _Search(driver, rate, width, threshold)
    moves = [
        move
        for sign in (1, -1)
        for span in search.stretches(sign, round(_PAUSE_S / dt_s))
        if (move := search.trimmed(span, sign)) and search.change(move, window) >= least
    ]
    return _distinct(moves)


def _width(noise: float, slowest: float, window: int, dt_s: float) -> int:
    """Choose over how many samples to compute the rate, so that it exceeds the noise."""
    if noise == 0.0:
        return 1
    needed = int(np.ceil(_RATE_NOISE * noise / slowest))
    return int(np.clip(needed, max(1, round(_RATE_S / dt_s)), window))


@dataclass(frozen=True)
class _Search:
    """The driver, its change `rate` over `width` samples, and the `threshold` of moving."""

    driver: Driver
    rate: FloatArray
    width: int
    threshold: float

    def stretches(self, sign: int, pause: int) -> list[tuple[int, int]]:
        """Find runs of moving in direction `sign`; pauses of up to `pause` samples are bridged."""
        starts, stops = runs(sign * self.rate > self.threshold)
        if not len(starts):
            return []
        against = np.concatenate(([0], np.cumsum(-sign * self.rate > self.threshold)))
        turned = against[starts[1:]] > against[stops[:-1]]
        apart = (starts[1:] - stops[:-1] > pause) | turned
        firsts = starts[np.concatenate(([True], apart))]
        lasts = stops[np.concatenate((apart, [True]))]
        return list(zip(firsts.tolist(), lasts.tolist(), strict=True))

    def trimmed(self, span: tuple[int, int], sign: int) -> Move:
        """Cut off what is slow compared with the peak rate, and place the start exactly."""
        first, last = span
        rate = sign * self.rate[first:last]
        moving = np.flatnonzero(rate > _MOVING * rate.max())
        start, stop = first + int(moving[0]), first + int(moving[-1]) + self.width
        if self.driver.noise > 0.0:
            start = _refined(sign * self.driver.values, self.driver.noise, start, stop)
        return Move(start, stop, sign)

    def change(self, move: Move, window: int) -> float:
        """Largest change of the move within the fixed window."""
        values = move.sign * self.driver.values[move.start : move.stop + 1]
        if len(values) <= window:
            return float(values[-1] - values[0])
        return float((values[window:] - values[:-window]).max())


def _refined(values: FloatArray, noise: float, start: int, stop: int) -> int:
    """Extend the line through the first third of a noisy rise back to the resting level."""
    level = float(np.median(values[max(0, start - 16) : start + 1]))
    rise = float(values[stop]) - level
    foot = np.flatnonzero(values[start : stop + 1] <= level + 4.0 * noise)
    begin = start + (int(foot[-1]) if len(foot) else 0)
    third = np.flatnonzero(values[begin : stop + 1] >= level + rise / 3.0)
    end = begin + (int(third[0]) if len(third) else 0)
    if rise <= 0.0 or end - begin < 2:
        return begin
    slope, offset = np.polyfit(np.arange(begin + 1, end + 1), values[begin + 1 : end + 1], 1)
    if slope <= 0.0:
        return begin
    lead = min(8.0 * noise / slope, begin)
    return round(float(np.clip((level - offset) / slope, begin - lead, begin)))


def _distinct(moves: list[Move]) -> list[Move]:
    """Sort by start; of moves that begin at one sample the longest stays."""
    kept: dict[int, Move] = {}
    for move in sorted(moves, key=lambda move: (move.start, move.stop)):
        kept[move.start] = move
    return list(kept.values())
