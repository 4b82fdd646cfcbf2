"""Manoeuvres that make unmodelled effects separable: what to ask the flight test for.

Each test point splits effects that look alike in line operation (GAP section 3: play against
dead band against stiction, rate limit against asymmetry against time constant, transport delay
against sensor lag, heat soak against slow temperature lags and deterioration, bleed against
deterioration). Fly the whole set low and high, once on a cold and once on a hot engine, and
record lever, speeds and temperature at 4 Hz or more. Not modelled: which pair is ambiguous just
now; that is for the diagnosis to say.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from narxcal.errors import ConfigError
from narxcal.flight_test.lever import IDLE_DEG, TAKE_OFF_DEG
from narxcal.flight_test.manoeuvre_pieces import Manoeuvre, Sequence, Sweep
from narxcal.flight_test.manoeuvres import (
    SLAM_DEG_S,
    hold,
    ladder,
    levels,
    reversals,
    switch,
    three_two_one_one,
    travel,
)

_SMALL = 0.03  # of the travel: triangles of 2 to 5 %
_SIZES = (0.3, 0.6, 1.0)
_RATES_DEG_S = (5.0, 15.0, 40.0, SLAM_DEG_S)


@dataclass(frozen=True)
class TestPoint:
    """A manoeuvre that begins and ends at one trim, and the effects that it tells apart."""

    __test__ = False  # no test case, for all its name

    name: str
    manoeuvre: Manoeuvre
    separates: tuple[str, ...]


@dataclass(frozen=True)
class TestLevels:
    """Lever angles that the set is flown at, in deg, and how long it stays.

    `low`, `trim` and `high` are in order between the stops; `stay_s` between movements, `hold_s`
    once after the large step (3 to 5 minutes show heat soak). Raises `ConfigError` otherwise.
    """

    __test__ = False

    low: float = 5.0
    trim: float = 50.0
    high: float = 80.0
    stay_s: float = 20.0
    hold_s: float = 240.0

    def __post_init__(self) -> None:
        if not IDLE_DEG <= self.low < self.trim < self.high <= TAKE_OFF_DEG:
            raise ConfigError(
                f"test levels have to rise from low over trim to high within {IDLE_DEG:g} .. "
                f"{TAKE_OFF_DEG:g} deg, got {self.low:g}, {self.trim:g}, {self.high:g}"
            )
        if min(self.stay_s, self.hold_s) < 5.0:
            raise ConfigError(
                f"test points stay at least 5 s, got {min(self.stay_s, self.hold_s):g} s"
            )


def separating_set(at: TestLevels | None = None) -> tuple[TestPoint, ...]:
    """List the test points about one trim."""
    at = at or TestLevels()
    return (*_large(at), *_small(at), *_switches(at), *_broad_band(at))


def _large(at: TestLevels) -> Iterator[TestPoint]:
    span, up = at.high - at.low, at.high - at.trim
    slams = levels([(span, at.stay_s), (0.0, at.stay_s)] * 2, SLAM_DEG_S)
    to_low, back = travel(at.low - at.trim, 5.0), travel(at.trim - at.low, 5.0)
    yield TestPoint(
        "two slams",
        Sequence.of(to_low, hold(at.stay_s), slams, back),
        ("transport delay", "sensor lag", "time constant", "asymmetry", "rate limit"),
    )
    sizes = ladder([share * up for share in _SIZES], at.stay_s, SLAM_DEG_S)
    yield TestPoint("three step sizes", sizes, ("rate limit", "asymmetry", "time constant"))
    rates = [
        levels([(up, up / rate + at.stay_s), (0.0, up / rate + at.stay_s)], rate)
        for rate in _RATES_DEG_S
    ]
    yield TestPoint("throttle rates", Sequence(tuple(rates)), ("rate limit", "throttle rate"))
    soak = levels([(at.high - at.low, at.hold_s)], SLAM_DEG_S)
    yield TestPoint(
        "long hold",
        Sequence.of(to_low, hold(at.stay_s), soak, travel(at.trim - at.high, 5.0)),
        ("heat soak", "deterioration", "sensor drift", "slow temperature lag"),
    )


def _small(at: TestLevels) -> Iterator[TestPoint]:
    amplitude = min(_SMALL * TAKE_OFF_DEG, at.high - at.trim, at.trim - at.low)
    for name, rate in (("slow reversals", 1.0), ("fast reversals", 10.0)):
        yield TestPoint(name, reversals(amplitude, rate), ("backlash", "dead band", "stiction"))


def _switches(at: TestLevels) -> Iterator[TestPoint]:
    for name in ("ECS", "NAI", "WAI"):
        point = switch(name, at.stay_s, after_s=at.stay_s)
        yield TestPoint(f"{name} on and off", point, ("bleed", "deterioration", "hot day"))


def _broad_band(at: TestLevels) -> Iterator[TestPoint]:
    amplitude = min(5.0, at.high - at.trim, at.trim - at.low)
    sweep = Sweep(amplitude, low_hz=0.02, high_hz=1.0, wanted_s=6.0 * at.stay_s)
    yield TestPoint("frequency sweep", sweep, ("transport delay", "sensor lag", "spool coupling"))
    multistep = three_two_one_one(amplitude, unit_s=at.stay_s / 6.0)
    yield TestPoint("3-2-1-1", multistep, ("time constant", "spool coupling", "dead band"))
