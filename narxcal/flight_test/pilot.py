"""What the pilot does with the levers, leg by leg, in two styles.

`line`: few and gentle movements, as in line operation; between the changes of leg only the
small corrections of an autothrottle. `enriched`: pushes and pulls in every leg, take-off and
approach included, at rates from slow to slam, and the whole set of test points low and high.
The two engines are worked together, but never quite: one lever leads, and now and then only one
is moved. Not modelled: a pilot who closes a loop, so no movement answers what the engine does.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from narxcal.flight_test.excitation import TestLevels, separating_set
from narxcal.flight_test.journey import Leg
from narxcal.flight_test.lever import Placed
from narxcal.flight_test.manoeuvre_pieces import Manoeuvre, Sequence, Sweep
from narxcal.flight_test.manoeuvres import (
    SLAM_DEG_S,
    SLOW_DEG_S,
    doublet,
    hold,
    ladder,
    levels,
    reslam,
    reversals,
    switch,
    three_two_one_one,
    travel,
)

Style = Literal["line", "enriched"]
STYLES: tuple[Style, ...] = ("line", "enriched")
ENGINES = ("left", "right")

# The lever that follows moves this much later, in s; manoeuvres keep more than that apart.
LATER_S = (0.1, 0.6)
_APART_S = 1.0
_SOLO = 0.15
# The lever gets to the angle of a leg in this share of it.
_SET_SHARE = 0.4


@dataclass(frozen=True)
class _Setting:
    """Lever angles of one leg: where it is set, and between which angles it is worked."""

    base: float
    low: float
    high: float


# Chosen; climb is where the Citation X paper's TLA of 50 comes to lie (see `mesh`).
_SETTINGS = {
    "taxi_out": _Setting(4.0, 0.0, 24.0),
    "take_off": _Setting(80.0, 55.0, 85.0),
    "initial_climb": _Setting(78.0, 25.0, 85.0),
    "climb": _Setting(71.0, 12.0, 85.0),
    "low_level": _Setting(44.0, 0.0, 85.0),
    "climb_high": _Setting(73.0, 12.0, 85.0),
    "cruise": _Setting(56.0, 0.0, 85.0),
    "step_climb": _Setting(70.0, 20.0, 85.0),
    "high_cruise": _Setting(54.0, 0.0, 85.0),
    "descent": _Setting(5.0, 0.0, 60.0),
    "low_descent": _Setting(13.0, 0.0, 62.0),
    "approach": _Setting(32.0, 0.0, 85.0),
    "go_around": _Setting(82.0, 30.0, 85.0),
    "circuit": _Setting(38.0, 4.0, 75.0),
    "final": _Setting(30.0, 6.0, 82.0),
    "flare": _Setting(0.0, 0.0, 0.0),
    "roll_out": _Setting(0.0, 0.0, 0.0),
    "taxi_in": _Setting(4.0, 0.0, 20.0),
}
# Both levers or none: nobody tries an engine alone here.
_TOGETHER = ("take_off", "initial_climb", "go_around", "flare", "roll_out")
_STILL = ("flare", "roll_out")
_TESTED = ("low_level", "high_cruise")
# Seconds between corrections of an autothrottle: closest on approach.
_CORRECTIONS_S = {"approach": (3.0, 9.0), "final": (3.0, 9.0), "cruise": (15.0, 60.0)}
_CORRECTIONS_S["high_cruise"] = _CORRECTIONS_S["cruise"]


@dataclass
class _Programme:
    """The manoeuvres of both levers so far.

    From `free_s` on the next one can begin; `clock_s` is when the pilot means it to.
    """

    random: np.random.Generator
    free_s: float = 0.0
    clock_s: float = 0.0
    angle_deg: float = 0.0
    placed: dict[str, list[Placed]] = field(default_factory=lambda: {e: [] for e in ENGINES})

    def add(self, manoeuvre: Manoeuvre, rest_s: float, *, together: bool = True) -> None:
        """Place a manoeuvre on both levers, or on one alone if it comes back to its start."""
        solo = not together and manoeuvre.net_deg == 0.0 and self.random.random() < _SOLO
        leader = self.random.integers(2)
        for index, engine in enumerate(ENGINES):
            if solo and index != leader:
                continue
            later = 0.0 if index == leader else self.random.uniform(*LATER_S)
            self.placed[engine].append(Placed(self.clock_s + later, manoeuvre))
        self.angle_deg += manoeuvre.net_deg
        self.free_s = self.clock_s + manoeuvre.duration_s + _APART_S
        self.clock_s = max(self.free_s, self.free_s - _APART_S + rest_s)

    def fits(self, manoeuvre: Manoeuvre, leg: Leg, setting: _Setting) -> bool:
        """Whether it ends in time, and stays between the leg's angles."""
        low, high = manoeuvre.reach_deg
        inside = setting.low <= self.angle_deg + low and self.angle_deg + high <= setting.high
        return inside and self.clock_s + manoeuvre.duration_s + _APART_S <= leg.stop_s


def work_levers(
    legs: list[Leg], style: Style, random: np.random.Generator
) -> dict[str, list[Placed]]:
    """Draw the manoeuvres of the left and the right lever over a flight, from idle at 0 s."""
    programme = _Programme(random)
    for leg in legs:
        # A new leg begins when it begins, whatever rest was meant after the last movement.
        programme.clock_s = max(programme.free_s, leg.start_s + random.uniform(0.0, 1.0))
        _set(programme, leg, style)
        if leg.name in _STILL:
            continue
        if style == "enriched" and leg.name in _TESTED:
            _test(programme, leg)
        (_enrich if style == "enriched" else _correct)(programme, leg)
    return programme.placed


def _set(programme: _Programme, leg: Leg, style: Style) -> None:
    """Move the levers to the angle of the leg."""
    setting, random = _SETTINGS[leg.name], programme.random
    target = setting.base
    if target > 0.0:
        target = min(max(target + random.uniform(-3.0, 3.0), setting.low), setting.high)
    rate = draw_rate(random) if style == "enriched" else random.uniform(6.0, 15.0)
    if leg.name in _STILL or leg.name in ("take_off", "go_around"):
        rate = max(rate, 12.0)
    by = target - programme.angle_deg
    rate = max(rate, abs(by) / (_SET_SHARE * (leg.stop_s - leg.start_s)))
    if leg.name == "take_off" and style == "line":
        # Engines are first brought to an even speed.
        stable = travel(0.5 * by, rate)
        programme.add(Sequence.of(stable, hold(4.0), stable), 2.0)
    elif by != 0.0:
        programme.add(travel(by, rate), random.uniform(2.0, 6.0))


def _correct(programme: _Programme, leg: Leg) -> None:
    """Small corrections about the leg's angle, as an autothrottle makes them."""
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
    """Fly the set of test points, as far as the time of the leg goes.

    A leg that is too short for all flies quicker ones in any order.
    """
    random, trim = programme.random, programme.angle_deg
    at = TestLevels(low=random.uniform(0.0, 6.0), trim=trim, high=random.uniform(76.0, 84.0))
    points = list(separating_set(at))
    needed = sum(point.manoeuvre.duration_s + 10.0 for point in points)
    if needed > leg.stop_s - programme.clock_s:
        at = TestLevels(at.low, at.trim, at.high, stay_s=8.0, hold_s=20.0)
        quick = separating_set(at)
        points = [quick[k] for k in random.permutation(len(quick))]
    for point in points:
        if programme.fits(point.manoeuvre, leg, _SETTINGS[leg.name]):
            # Each engine flies the whole set; bleed is often tried on one side.
            one_side = bool(point.manoeuvre.switched)
            programme.add(point.manoeuvre, random.uniform(3.0, 8.0), together=not one_side)


def _enrich(programme: _Programme, leg: Leg) -> None:
    """Draw manoeuvres until the leg is full; each leaves some rest behind it."""
    setting, random = _SETTINGS[leg.name], programme.random
    # A short leg has no time for anything but pushes and pulls, close together.
    leisure = min(1.0, (leg.stop_s - leg.start_s) / 200.0)
    together = leg.name in _TOGETHER
    while programme.clock_s < leg.stop_s - 4.0:
        drawn = (_draw(random, setting, programme.angle_deg, leisure) for _ in range(8))
        fitting = (one for one in drawn if programme.fits(one, leg, setting))
        chosen = next(fitting, None)
        rest = random.uniform(5.0, 12.0) + random.exponential(15.0) * leisure
        if chosen is None:
            programme.clock_s += 1.0
        else:
            programme.add(chosen, rest, together=together)


def _draw(
    random: np.random.Generator, setting: _Setting, angle: float, leisure: float
) -> Manoeuvre:
    """Draw one of the pilot's habits: mostly a push or a pull, with leisure also the others."""
    if random.random() > 0.4 * leisure:
        drawn = random.uniform(setting.low, setting.high, size=2)
        return travel(float(drawn[np.argmax(np.abs(drawn - angle))]) - angle, draw_rate(random))
    makers = tuple(_habits(random, setting, angle))
    return makers[int(random.integers(len(makers)))]


def _habits(random: np.random.Generator, setting: _Setting, angle: float) -> Iterator[Manoeuvre]:
    """List manoeuvres that come back to the angle they began at."""
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
    """Draw a rate of the lever in deg/s: from slow to slam, every octave as often."""
    return math.exp(random.uniform(math.log(low), math.log(high)))
