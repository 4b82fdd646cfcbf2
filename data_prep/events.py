"""Trend Intercept: cut the push and pull events of the driving channel out of a log.

A move is where the lever starts and stops; its event lasts until the responses have settled.
Signals are `(time,)`, NaN where nothing was measured.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from statistics import median
from typing import Literal

import numpy as np
from pydantic import Field

from data_prep.equilibrium import in_equilibrium
from data_prep.log import Log
from narxcal.channels import described
from narxcal.support.arrays import (
    BoolArray,
    FloatArray,
    bridge_gaps,
    long_runs,
    noise_level,
    robust_range,
    runs,
)
from narxcal.support.errors import DataError
from narxcal.support.settings import Section

Speed = Literal["fast", "slow", "small"]

PUSH, PULL = 0, 1
AUTO = "auto"
_ON_GROUND = "WOW"

# A lever that is not moved may toggle by its resolution; smaller changes than this part of the
# channel's physical range are none. Outputs used as driver are judged by their own noise.
_LEVER_FLOOR = 0.005
# Peak to peak of white noise over a settling window, in standard deviations.
_PEAK_TO_PEAK = 6.0
# A change has to exceed the driver's own noise by this many standard deviations.
_NOISE_FACTOR = 8.0
# The lever counts as moving while its rate exceeds this part of the move's peak rate.
_MOVING = 0.05
# A lever that pauses for less than this within one move has not finished it.
_PAUSE_S = 0.5
# The level from which a noisy move begins is the median of this many samples before it.
_LEVEL_SAMPLES = 16
# The rate of a noisy driver is computed over at least this time, and this many standard
# deviations of the noise are no movement.
_RATE_S = 0.25
_RATE_NOISE = 4.0


class EventsConfig(Section):
    """TOML table `[events]`: what counts as a push or a pull, and where it ends.

    driver, response: the channel that is moved, and those that have to settle.
    condition, condition_value: only samples where this channel has this value; "" for all. "auto"
        is WOW in a log that has it, and all samples in one that has none.
    window_s, min_change, min_fraction: a move changes the driver within `window_s` by
        `min_change` (its unit) or, where that is absent, by `min_fraction` of its range.
    small_fraction, fast_s: a move below `small_fraction` of the driver's range is small; any
        other is fast where the driver stops within `fast_s`, else slow.
    settle_s, settle_fraction: settled once driver and responses stay for `settle_s` within
        `settle_fraction` of their range (and their noise). max_length_s: longest event.
    """

    driver: str = "TRA_deg"
    response: tuple[str, ...] = ("N1_pct",)
    condition: str = AUTO
    condition_value: float = 0.0
    window_s: float = Field(default=2.0, gt=0)
    min_change: float | None = Field(default=None, gt=0)
    min_fraction: float = Field(default=0.02, gt=0, lt=1)
    small_fraction: float = Field(default=0.1, ge=0, lt=1)
    fast_s: float = Field(default=3.0, gt=0)
    settle_s: float = Field(default=3.0, gt=0)
    settle_fraction: float = Field(default=0.01, gt=0, lt=1)
    max_length_s: float = Field(default=60.0, gt=0)

    def for_log(self, log: Log, outputs: Sequence[str]) -> EventsConfig:
        """Return the same with the responses that `log` has; without any, all `outputs` it has.

        An event ends when its responses have settled: one that is not recorded cannot, and with
        none left every event would end with the last movement of the lever.
        """
        known = log.recorded(self.response) or log.recorded(outputs)
        return self.model_copy(update={"response": known}) if known else self


@dataclass(frozen=True)
class Event:
    """Samples `start:stop` of one log, from the start of one lever movement to equilibrium.

    `start` is n0, the last sample before the lever moves; `label` is 0 for a push, 1 for a
    pull. `interrupted`: the next movement came before everything had settled. `lever_before`
    and `lever_after` are in the driver's unit.
    """

    log: str
    start: int
    stop: int
    label: int
    speed: Speed
    start_s: float
    lever_before: float
    lever_after: float
    settled: bool
    interrupted: bool


def find_events(log: Log, config: EventsConfig | None = None) -> list[Event]:
    """Pushes and pulls in order of time (calibration paper, section 2.5).

    A driver that never moves gives an empty list. Events do not overlap and hold no sample
    that violates the condition. Raises `DataError` where the driver, a response or a
    condition channel of the configuration is missing, and for several logs at once.
    """
    if not isinstance(log, Log):
        raise DataError(
            f"events are those of one log, found a {type(log).__name__}",
            hint="Call it for each: [find_events(log) for log in logs]",
        )
    config = config or EventsConfig()
    allowed = _allowed(log, config)
    if len(log) < 3:
        return []
    window = max(1, round(config.window_s / log.dt_s))
    driver = Driver.of(log[config.driver], window // 4)
    allowed &= ~driver.lost
    moves = find_moves(driver, window, _least(driver, config), log.dt_s)
    settled = _settled(log, config)
    cutter = _Cutter(log, config, driver, allowed, settled)
    nexts = [*(move.start for move in moves), len(log)][1:]
    events = [cutter.cut(move, until) for move, until in zip(moves, nexts, strict=True)]
    return [event for event in events if event is not None]


def _allowed(log: Log, config: EventsConfig) -> BoolArray:
    """Mark the samples that meet the condition; NaN does not."""
    channel = _condition(log, config)
    if not channel:
        return np.ones(len(log), dtype=np.bool_)
    if channel not in log.channels:
        raise DataError(
            "events need their condition channel, and the log has none",
            file=log.name,
            channel=channel,
            hint='Derive it in [logs], or set condition = "" in [events]',
        )
    return np.asarray(log[channel] == config.condition_value)


def _condition(log: Log, config: EventsConfig) -> str:
    """The channel that allows events; empty where they may be everywhere."""
    if config.condition != AUTO:
        return config.condition
    return _ON_GROUND if _ON_GROUND in log.channels else ""


def needs_condition(log: Log, config: EventsConfig) -> str:
    """Warn of a log in which nothing separates the ground from flight; empty for others."""
    if config.condition != AUTO or _ON_GROUND in log.channels:
        return ""
    return f"there is no {_ON_GROUND} channel: events on the ground count like those in flight"


def _least(driver: Driver, config: EventsConfig) -> float:
    if config.min_change is not None:
        return config.min_change
    known = described(config.driver)
    floor = _LEVER_FLOOR * (known.high - known.low) if known.role == "lever" else 0.0
    return max(config.min_fraction * driver.span, floor)


def _settled(log: Log, config: EventsConfig) -> BoolArray:
    """Mark sample k where driver and responses stay in their bands over `k:k + settle`."""
    size = max(2, round(config.settle_s / log.dt_s))
    bands = {}
    for name in (config.driver, *config.response):
        if np.isfinite(log[name]).any():
            low, high = robust_range(log[name])
            noise = noise_level(bridge_gaps(log[name]))
            bands[name] = config.settle_fraction * (high - low) + _PEAK_TO_PEAK * noise
    flags = in_equilibrium(log, bands, size, ahead=True, longest_gap=size // 2)
    flags[max(0, len(log) - size + 1) :] = False
    return flags


@dataclass(frozen=True)
class _Cutter:
    log: Log
    config: EventsConfig
    driver: Driver
    allowed: BoolArray
    settled: BoolArray

    def cut(self, move: Move, until: int) -> Event | None:
        """Cut the event of one move, at the latest at sample `until`; None where not allowed."""
        limit = self._limit(move.start, until)
        if limit <= move.start + 1 or limit < min(move.stop, until):
            return None
        moved = min(move.stop, limit)
        quiet = np.flatnonzero(self.settled[moved:limit])
        settle = max(2, round(self.config.settle_s / self.log.dt_s))
        stop = moved + int(quiet[0]) + settle if len(quiet) else limit
        settled = bool(len(quiet)) and stop <= limit
        return self._event(move, min(stop, limit), settled, limit == until < len(self.log))

    def _limit(self, start: int, until: int) -> int:
        longest = start + max(2, round(self.config.max_length_s / self.log.dt_s))
        limit = min(until, longest, len(self.log))
        barred = np.flatnonzero(~self.allowed[start:limit])
        return start + int(barred[0]) if len(barred) else limit

    def _event(self, move: Move, stop: int, settled: bool, cut_short: bool) -> Event:
        values = self.driver.values
        before = median(values[max(0, move.start - 3) : move.start + 1].tolist())
        after = median(values[min(move.stop, stop - 1) : stop].tolist())
        return Event(
            log=self.log.name,
            start=move.start,
            stop=stop,
            label=PUSH if move.sign > 0 else PULL,
            speed=self._speed(move, abs(after - before)),
            start_s=float(self.log.time_s[move.start]),
            lever_before=before,
            lever_after=after,
            settled=settled,
            interrupted=cut_short and not settled,
        )

    def _speed(self, move: Move, change: float) -> Speed:
        if change < self.config.small_fraction * self.driver.span:
            return "small"
        fast = (move.stop - move.start) * self.log.dt_s <= self.config.fast_s
        return "fast" if fast else "slow"


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
    tracked back to the sample where the lever left its resting position. Of those that begin at
    one sample the longest stays. `least` is raised to eight standard deviations of the driver's
    noise.
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
    moves.sort(key=lambda move: (move.start, move.stop))
    return list({move.start: move for move in moves}.values())


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
            first = max(0, start - _LEVEL_SAMPLES)
            values = sign * self.driver.values[first : stop + 1]
            start = _refined(values, self.driver.noise, start, first)
        return Move(start, stop, sign)

    def change(self, move: Move, window: int) -> float:
        """Largest change of the move within the fixed window."""
        values = move.sign * self.driver.values[move.start : move.stop + 1]
        if len(values) <= window:
            return float(values[-1] - values[0])
        return float((values[window:] - values[:-window]).max())


def _refined(values: FloatArray, noise: float, start: int, first: int) -> int:
    """Extend the line through the first third of a noisy rise back to the resting level.

    `values` (time,) begin with sample `first` of the log, rest up to sample `start` and end with
    the rise.
    """
    level = float(median(values[: start - first + 1].tolist()))
    rise = float(values[-1]) - level
    foot = np.flatnonzero(values[start - first :] <= level + 4.0 * noise)
    begin = start + (int(foot[-1]) if len(foot) else 0)
    third = np.flatnonzero(values[begin - first :] >= level + rise / 3.0)
    end = begin + (int(third[0]) if len(third) else 0)
    if rise <= 0.0 or end - begin < 2:
        return begin
    samples = np.arange(begin + 1, end + 1)
    rising = values[samples - first]
    middle = float(samples.mean())
    slope = float((samples - middle) @ rising / ((samples - middle) ** 2).sum())
    if slope <= 0.0:
        return begin
    lead = min(8.0 * noise / slope, begin)
    back = middle - (float(rising.mean()) - level) / slope
    return round(min(max(back, begin - lead), begin))
