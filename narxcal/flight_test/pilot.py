"""The pilot: which manoeuvres both levers fly, leg by leg, and the lever angles over time.

Two styles. `line`: few and gentle movements as in line operation; between the changes of leg only
the small corrections of an autothrottle. `enriched`: pushes and pulls in every leg, take-off and
approach included, at rates from slow to slam, and the whole set of test points low and high.

Each test point separates effects that look alike in line operation (play against
dead band against stiction, rate limit against asymmetry against time constant, transport delay
against sensor lag, heat soak against slow temperature lags and deterioration, bleed against
deterioration). Fly the whole set low and high, once on a cold and once on a hot engine, and record
lever, speeds and temperature at 4 Hz or more.

The two levers move together but not exactly: one leads by a short time, some manoeuvres are flown
on one alone, and both are rigged up to a degree apart. Their stops are 0 (idle) and 85 deg
(take-off). Not modelled: feedback from the engine to the pilot, play and friction (effects of the
engine's linkage), reverse thrust.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from narxcal.flight_test.manoeuvres import (
    SLAM_DEG_S,
    SLOW_DEG_S,
    Manoeuvre,
    Sweep,
    Switched,
    doublet,
    hold,
    ladder,
    levels,
    reslam,
    reversals,
    sequence,
    switch,
    three_two_one_one,
    travel,
)
from narxcal.flight_test.route import LEGS, Leg
from narxcal.support.arrays import FloatArray

IDLE_DEG, TAKE_OFF_DEG = 0.0, 85.0
# Difference of the levers: half of it on each, drawn along the lever's path, and zero at the stops.
_APART_DEG, _PATH_DEG, _STOP_DEG = 0.5, 30.0, 10.0


@dataclass(frozen=True)
class Placed:
    """A manoeuvre that begins at `start_s`."""

    start_s: float
    manoeuvre: Manoeuvre

    @property
    def stop_s(self) -> float:
        return self.start_s + self.manoeuvre.duration_s


def compose(
    placed: Iterable[Placed], time_s: FloatArray, start_deg: float, hand_deg_s: float | None = None
) -> FloatArray:
    """Lever angle at `time_s` `(time,)`: constant but for the manoeuvres, which are relative.

    `hand_deg_s` limits the rate of the result.
    """
    swings, nets = np.zeros_like(time_s), np.zeros(len(time_s) + 1)
    for item in sorted(placed, key=lambda item: item.start_s):
        first, last = np.searchsorted(time_s, (item.start_s, item.stop_s))
        swings[first:last] = item.manoeuvre.swing_deg(time_s[first:last] - item.start_s)
        nets[last] += item.manoeuvre.net_deg
    angle = np.clip(start_deg + swings + np.cumsum(nets[:-1]), IDLE_DEG, TAKE_OFF_DEG)
    if hand_deg_s is None or len(angle) < 2:
        return angle
    return rate_limited(angle, hand_deg_s * float(time_s[1] - time_s[0]))


def rate_limited(angle_deg: FloatArray, most_deg: float) -> FloatArray:
    """Follow `angle_deg` `(time,)` by at most `most_deg` from one sample to the next."""
    if np.abs(np.diff(angle_deg)).max(initial=0.0) <= most_deg:
        return angle_deg
    state, followed = float(angle_deg[0]), []
    for angle in angle_deg.tolist():
        state += min(max(angle - state, -most_deg), most_deg)
        followed.append(state)
    return np.array(followed)


def set_apart(angle_deg: FloatArray, random: np.random.Generator) -> FloatArray:
    """Add a random error of at most half a degree to a lever angle `(time,)`.

    The error is a function of the distance that the lever has covered: it changes only while the
    lever moves, and is 0 at either stop.
    """
    path = np.concatenate(([0.0], np.cumsum(np.abs(np.diff(angle_deg)))))
    knots = np.arange(0.0, path[-1] + 2.0 * _PATH_DEG, _PATH_DEG)
    error = np.interp(path, knots, random.uniform(-_APART_DEG, _APART_DEG, len(knots)))
    room = np.minimum(angle_deg - IDLE_DEG, TAKE_OFF_DEG - angle_deg)
    return np.asarray(angle_deg + error * np.clip(room / _STOP_DEG, 0.0, 1.0))


def flips(placed: Iterable[Placed]) -> list[Switched]:
    """Switches that the manoeuvres invert, on the common time axis."""
    return [flip.later(item.start_s) for item in placed for flip in item.manoeuvre.switched]


_SMALL = 0.03  # of the travel: triangles of 2 to 5 %
_SIZES = (0.3, 0.6, 1.0)
_RATES_DEG_S = (5.0, 15.0, 40.0, SLAM_DEG_S)


@dataclass(frozen=True)
class TestLevels:
    """Lever angles of the set in deg, and its times.

    `low`, `trim` and `high` are in order between the stops; `stay_s` is the time between movements,
    `hold_s` that after the large step (3 to 5 minutes show heat soak).
    """

    __test__ = False

    low: float
    trim: float
    high: float
    stay_s: float = 20.0
    hold_s: float = 240.0


def separating_set(at: TestLevels) -> dict[str, Manoeuvre]:
    """Name the test points about one trim: manoeuvres that begin and end there."""
    return {**_large(at), **_small(at)}


def _large(at: TestLevels) -> dict[str, Manoeuvre]:
    span, up = at.high - at.low, at.high - at.trim
    to_low, back = travel(at.low - at.trim, 5.0), travel(at.trim - at.low, 5.0)
    slams = levels([(span, at.stay_s), (0.0, at.stay_s)] * 2, SLAM_DEG_S)
    rates = [
        levels([(up, up / rate + at.stay_s), (0.0, up / rate + at.stay_s)], rate)
        for rate in _RATES_DEG_S
    ]
    soak = levels([(span, at.hold_s)], SLAM_DEG_S)
    return {
        # Transport delay, sensor lag, time constant, asymmetry, rate limit.
        "two slams": sequence(to_low, hold(at.stay_s), slams, back),
        # Rate limit, asymmetry, time constant.
        "three step sizes": ladder([share * up for share in _SIZES], at.stay_s, SLAM_DEG_S),
        # Rate limit, throttle rate.
        "throttle rates": sequence(*rates),
        # Heat soak, deterioration, sensor drift, slow temperature lag.
        "long hold": sequence(to_low, hold(at.stay_s), soak, travel(at.trim - at.high, 5.0)),
    }


def _small(at: TestLevels) -> dict[str, Manoeuvre]:
    room = min(at.high - at.trim, at.trim - at.low)
    triangle, wave = min(_SMALL * TAKE_OFF_DEG, room), min(5.0, room)
    return {
        # Backlash, dead band, stiction.
        "slow reversals": reversals(triangle, 1.0),
        "fast reversals": reversals(triangle, 10.0),
        # Bleed, deterioration, hot day.
        **{
            f"{name} on and off": switch(name, at.stay_s, after_s=at.stay_s)
            for name in ("ECS", "NAI", "WAI")
        },
        # Transport delay, sensor lag, spool coupling.
        "frequency sweep": Sweep(wave, low_hz=0.02, high_hz=1.0, wanted_s=6.0 * at.stay_s),
        # Time constant, spool coupling, dead band.
        "3-2-1-1": three_two_one_one(wave, unit_s=at.stay_s / 6.0),
    }


Style = Literal["line", "enriched"]
Side = Literal["left", "right"]
SIDES: tuple[Side, ...] = ("left", "right")

# The second lever moves later by so many s; manoeuvres are farther apart than that.
LATER_S = (0.1, 0.6)
_APART_S = 1.0
_SOLO = 0.15  # share of manoeuvres on one lever alone
# The lever reaches the angle of a leg in this share of it.
_SET_SHARE = 0.4


@dataclass(frozen=True)
class _Setting:
    """Lever angles of one leg: trim, lowest and highest."""

    base: float
    low: float
    high: float


_SETTINGS = {name: _Setting(*leg["lever_deg"]) for name, leg in LEGS.items()}
# Legs without manoeuvres on one engine alone, without any, and with test points.
_TOGETHER = ("take_off", "initial_climb", "go_around", "flare", "roll_out")
_NO_MANOEUVRES = ("flare", "roll_out")
_TESTED = ("low_level", "high_cruise")
# Seconds between corrections of an autothrottle: closest on approach.
_CORRECTIONS_S = {"approach": (3.0, 9.0), "final": (3.0, 9.0), "cruise": (15.0, 60.0)}
_CORRECTIONS_S["high_cruise"] = _CORRECTIONS_S["cruise"]


@dataclass
class _Programme:
    """The manoeuvres of both levers so far.

    The next one can begin from `free_s` on; the pilot intends to begin at `clock_s`.
    """

    random: np.random.Generator
    free_s: float = 0.0
    clock_s: float = 0.0
    angle_deg: float = 0.0
    placed: dict[str, list[Placed]] = field(default_factory=lambda: {e: [] for e in SIDES})

    def add(self, manoeuvre: Manoeuvre, pause_s: float, *, together: bool = True) -> None:
        """Place a manoeuvre on both levers, or on one alone if it returns to its start."""
        solo = not together and manoeuvre.net_deg == 0.0 and self.random.random() < _SOLO
        leader = self.random.integers(2)
        for index, engine in enumerate(SIDES):
            if solo and index != leader:
                continue
            later = 0.0 if index == leader else self.random.uniform(*LATER_S)
            self.placed[engine].append(Placed(self.clock_s + later, manoeuvre))
        self.angle_deg += manoeuvre.net_deg
        self.free_s = self.clock_s + manoeuvre.duration_s + _APART_S
        self.clock_s = max(self.free_s, self.free_s - _APART_S + pause_s)

    def fits(self, manoeuvre: Manoeuvre, leg: Leg, setting: _Setting) -> bool:
        """Whether it ends within the leg, and stays between the leg's angles."""
        low, high = manoeuvre.reach_deg
        inside = setting.low <= self.angle_deg + low and self.angle_deg + high <= setting.high
        return inside and self.clock_s + manoeuvre.duration_s + _APART_S <= leg.stop_s


def work_levers(
    legs: list[Leg], style: Style, random: np.random.Generator
) -> dict[str, list[Placed]]:
    """Draw the manoeuvres of the left and the right lever over a flight, from idle at 0 s."""
    programme = _Programme(random)
    for leg in legs:
        # The start of a leg overrides the pause intended after the last movement.
        programme.clock_s = max(programme.free_s, leg.start_s + random.uniform(0.0, 1.0))
        _set(programme, leg, style)
        if leg.name in _NO_MANOEUVRES:
            continue
        if style == "enriched" and leg.name in _TESTED:
            _test(programme, leg)
        (_enrich if style == "enriched" else _correct)(programme, leg)
    return programme.placed


def _set(programme: _Programme, leg: Leg, style: Style) -> None:
    setting, random = _SETTINGS[leg.name], programme.random
    target = setting.base
    if target > 0.0:
        target = min(max(target + random.uniform(-3.0, 3.0), setting.low), setting.high)
    rate = draw_rate(random) if style == "enriched" else random.uniform(6.0, 15.0)
    if leg.name in _NO_MANOEUVRES or leg.name in ("take_off", "go_around"):
        rate = max(rate, 12.0)
    by = target - programme.angle_deg
    rate = max(rate, abs(by) / (_SET_SHARE * (leg.stop_s - leg.start_s)))
    if leg.name == "take_off" and style == "line":
        # Both engines are first stabilised at part power.
        stable = travel(0.5 * by, rate)
        programme.add(sequence(stable, hold(4.0), stable), 2.0)
    elif by != 0.0:
        programme.add(travel(by, rate), random.uniform(2.0, 6.0))


def _correct(programme: _Programme, leg: Leg) -> None:
    setting, random = _SETTINGS[leg.name], programme.random
    trim = programme.angle_deg
    pauses = _CORRECTIONS_S.get(leg.name, (8.0, 35.0))
    while programme.clock_s < leg.stop_s:
        target = trim + random.normal(0.0, 1.2)
        if leg.name.endswith("descent") and random.random() < 0.1:
            target = trim + random.uniform(4.0, 12.0)
        by = min(max(target, setting.low), setting.high) - programme.angle_deg
        move = travel(by, random.uniform(0.5, 3.0))
        if abs(by) > 0.2 and programme.fits(move, leg, setting):
            programme.add(move, 0.0)
        programme.clock_s += random.uniform(*pauses)


def _test(programme: _Programme, leg: Leg) -> None:
    """Place the set of test points, as many as the leg has time for."""
    random, trim = programme.random, programme.angle_deg
    at = TestLevels(low=random.uniform(0.0, 6.0), trim=trim, high=random.uniform(76.0, 84.0))
    points = list(separating_set(at).values())
    needed = sum(point.duration_s + 10.0 for point in points)
    if needed > leg.stop_s - programme.clock_s:
        at = TestLevels(at.low, at.trim, at.high, stay_s=8.0, hold_s=20.0)
        quick = list(separating_set(at).values())
        points = [quick[k] for k in random.permutation(len(quick))]
    for point in points:
        if programme.fits(point, leg, _SETTINGS[leg.name]):
            # Both engines fly the whole set; bleed is often tested on one side.
            programme.add(point, random.uniform(3.0, 8.0), together=not point.switched)


def _enrich(programme: _Programme, leg: Leg) -> None:
    setting, random = _SETTINGS[leg.name], programme.random
    # A short leg has time for pushes and pulls alone, close together.
    leisure = min(1.0, (leg.stop_s - leg.start_s) / 200.0)
    together = leg.name in _TOGETHER
    while programme.clock_s < leg.stop_s - 4.0:
        drawn = (_draw(random, setting, programme.angle_deg, leisure) for _ in range(8))
        fitting = (one for one in drawn if programme.fits(one, leg, setting))
        chosen = next(fitting, None)
        pause = random.uniform(5.0, 12.0) + random.exponential(15.0) * leisure
        if chosen is None:
            programme.clock_s += 1.0
        else:
            programme.add(chosen, pause, together=together)


def _draw(
    random: np.random.Generator, setting: _Setting, angle: float, leisure: float
) -> Manoeuvre:
    """Draw a manoeuvre: mostly a push or a pull; with `leisure` (0 to 1) also others."""
    if random.random() > 0.4 * leisure:
        drawn = random.uniform(setting.low, setting.high, size=2)
        return travel(float(drawn[np.argmax(np.abs(drawn - angle))]) - angle, draw_rate(random))
    others = tuple(_returning(random, setting, angle))
    return others[int(random.integers(len(others)))]


def _returning(random: np.random.Generator, setting: _Setting, angle: float) -> Iterator[Manoeuvre]:
    up, down = max(setting.high - angle, 1.0), max(angle - setting.low, 1.0)
    small = min(up, down, random.uniform(2.0, 4.5))
    middle = min(up, down, random.uniform(4.0, 12.0))
    stay = random.uniform(6.0, 14.0)
    yield reslam(down * random.uniform(0.6, 1.0), random.uniform(0.8, 3.0), then_s=stay)
    yield doublet(middle, stay)
    yield reversals(small, random.choice((1.0, 3.0, 10.0)), cycles=2)
    yield ladder((0.3 * up, 0.6 * up, up), stay, SLAM_DEG_S)
    yield levels([(-down * random.uniform(0.5, 1.0), stay + down / SLOW_DEG_S), (0.0, stay)], 30.0)
    yield three_two_one_one(middle, stay / 4.0)
    yield Sweep(small, 0.03, 0.8, wanted_s=5.0 * stay)
    yield switch(str(random.choice(("ECS", "NAI", "WAI"))), stay, after_s=0.5 * stay)


def draw_rate(
    random: np.random.Generator, low: float = SLOW_DEG_S, high: float = SLAM_DEG_S
) -> float:
    """Draw a rate of the lever in deg/s log-uniformly from slow to slam."""
    return math.exp(random.uniform(math.log(low), math.log(high)))
