"""Lever manoeuvres by the names that pilots and papers give them, made of `manoeuvre_pieces`.

Modelled: steps, impulses, ramps, pushes and pulls, re-slams, reversals, multisteps, ladders, and
switches that are flipped while the lever rests. Not modelled: tremor of the hand, friction and play
of the lever; play and its like are unmodelled effects, which the engine adds.

Step, impulse and ramp are Equations (1)-(3) of the Citation X identification paper. Its
equation (2) reads 1 < t < 1 + Ts, in which no sample of a raster through t = 1 lies; here
samples at `1 <= t < 1 + Ts` are moved, and a step counts from its own instant on.
"""

from __future__ import annotations

import math
from collections.abc import Iterable

from narxcal.errors import ConfigError
from narxcal.flight_test.manoeuvre_pieces import Corners, Switched

# What a hand does at most: the whole travel in half a second.
HAND_DEG_S = 170.0
# Slam: as fast as pilots move it when asked to.
SLAM_DEG_S, FAST_DEG_S, SLOW_DEG_S = 120.0, 40.0, 4.0


def hold(seconds: float) -> Corners:
    """Leave the lever where it is."""
    return Corners(((0.0, 0.0), (_time("a hold", seconds), 0.0)))


def travel(by_deg: float, rate_deg_s: float) -> Corners:
    """Move the lever by `by_deg` (negative: back) at a steady rate."""
    return Corners(((0.0, 0.0), (abs(by_deg) / _rate(rate_deg_s), by_deg)))


def step(by_deg: float, after_s: float = 1.0, then_s: float = 30.0) -> Corners:
    """Move at once after `after_s`, then hold for `then_s` (Citation X paper, Equation 1)."""
    end = after_s + _time("the hold after a step", then_s)
    return Corners(((0.0, 0.0), (after_s, 0.0), (after_s, by_deg), (end, by_deg)))


def impulse(by_deg: float, width_s: float, after_s: float = 1.0, then_s: float = 30.0) -> Corners:
    """Move at once for `width_s`, in the paper one sample, and back (Equation 2)."""
    back = after_s + _time("the width of an impulse", width_s)
    points = ((after_s, 0.0), (after_s, by_deg), (back, by_deg), (back, 0.0))
    return Corners(((0.0, 0.0), *points, (back + then_s, 0.0)))


def ramp(by_deg: float, ramp_s: float, after_s: float = 1.0, then_s: float = 30.0) -> Corners:
    """Move steadily over `ramp_s` after `after_s`, then hold (Equation 3)."""
    top = after_s + _time("a ramp", ramp_s)
    return Corners(((0.0, 0.0), (after_s, 0.0), (top, by_deg), (top + then_s, by_deg)))


def levels(stays: Iterable[tuple[float, float]], rate_deg_s: float) -> Corners:
    """Go to each (angle from the start, seconds) in turn; the seconds include the way there.

    Raises `ConfigError` where a stay is over before the lever has arrived.
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
    """Up for three units, down for two, up for one, down for one, back: a broad band in short."""
    signs = ((1, 3), (-1, 2), (1, 1), (-1, 1), (0, 1))
    return levels([(sign * amplitude_deg, units * unit_s) for sign, units in signs], rate_deg_s)


def ladder(sizes_deg: Iterable[float], stay_s: float, rate_deg_s: float = FAST_DEG_S) -> Corners:
    """Out to each size and back: what a rate limit delays in proportion and a lag does not."""
    stays = [(level, stay_s) for size in sizes_deg for level in (size, 0.0)]
    return levels(stays, rate_deg_s)


def reversals(amplitude_deg: float, rate_deg_s: float, cycles: int = 3) -> Corners:
    """Small triangles about one trim; play shows the same at every rate, a lag does not."""
    quarter = abs(amplitude_deg) / _rate(rate_deg_s)
    turns = [((2 * k + 1) * quarter, amplitude_deg * (-1) ** k) for k in range(2 * cycles)]
    return Corners(((0.0, 0.0), *turns, (4 * cycles * quarter, 0.0)))


def reslam(
    down_deg: float, pause_s: float, then_s: float = 15.0, rate_deg_s: float = SLAM_DEG_S
) -> Corners:
    """Chop, and slam back before the engine has settled."""
    down = -abs(down_deg)
    way = abs(down) / _rate(rate_deg_s)
    return levels([(down, way + pause_s), (0.0, way + then_s)], rate_deg_s)


def switch(channel: str, on_s: float, before_s: float = 5.0, after_s: float = 20.0) -> Corners:
    """Flip bleed or anti-ice for `on_s` while the lever rests."""
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
