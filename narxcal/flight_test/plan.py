"""A whole flight for both engines of an aircraft, as input channels of the virtual engine.

Taxi, take-off, step climbs, cruise, descent, approach, go-around, landing and taxi. `route` plans
legs, air and switches, `pilot` both levers; their docstrings say what each leaves out. Or the steps
of a flight card, as a pilot flies them.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from narxcal.flight_test.manoeuvres import HAND_DEG_S
from narxcal.flight_test.moves import FlightCard, Move, course
from narxcal.flight_test.pilot import (
    IDLE_DEG,
    LATER_S,
    SIDES,
    TAKE_OFF_DEG,
    Style,
    compose,
    flips,
    rate_limited,
    set_apart,
    work_levers,
)
from narxcal.flight_test.route import (
    AIRCRAFT,
    CHANNEL_NAMES,
    DT_HIGH_C,
    DT_LOW_C,
    RATE_HZ,
    SHORTEST_S,
    SWITCH_NAMES,
    Air,
    Aircraft,
    Day,
    altitude,
    check_between,
    draw_weather,
    flipped,
    flown_mach,
    plan_legs,
    planned_mach,
    planned_switches,
    temperature_deviation,
)
from narxcal.support.arrays import FloatArray
from narxcal.support.errors import ConfigError
from narxcal.support.settings import Section

LONGEST_S = 43_200.0
_LOWEST_TOP_FT, _SLOWEST_MACH = 15_000.0, 0.55
# A step of a card begins so late (chosen), so far off its altitude (the tolerance of FAA-S-ACS-11).
_LATE_S, _OFF_FT = 2.0, 100.0
_BRIEFEST_S = 5.0


class FlightPlan(Section):
    """The kind of flight to plan; values left out are drawn from the seed.

    style: `line` or `enriched`. aircraft: `business_jet` or `single_aisle`, which limits altitude
        and Mach. duration_s: length, at least 480 s; left out, the natural one (80 to 130 min).
    rate_hz: sampling rate. top_ft, cruise_mach: highest altitude and Mach in cruise.
    dT_C: static temperature off the standard day. field_ft: pressure altitude of the airfield.

    Raises `ConfigError` for an unknown name or a value out of range.
    """

    style: Style = "enriched"
    aircraft: Literal["business_jet", "single_aisle"] = "business_jet"
    duration_s: float | None = Field(default=None, ge=SHORTEST_S, le=LONGEST_S)
    rate_hz: float = Field(default=32.0, ge=RATE_HZ[0], le=RATE_HZ[1])
    top_ft: float | None = None
    cruise_mach: float | None = None
    dT_C: float | None = Field(default=None, ge=DT_LOW_C, le=DT_HIGH_C)
    field_ft: float | None = Field(default=None, ge=0.0, le=6000.0)

    @model_validator(mode="after")
    def _possible(self) -> FlightPlan:
        limits = AIRCRAFT[self.aircraft]
        if self.top_ft is not None:
            check_between("top_ft", self.top_ft, _LOWEST_TOP_FT, limits.ceiling_ft)
        if self.cruise_mach is not None:
            check_between("cruise_mach", self.cruise_mach, _SLOWEST_MACH, limits.mach_max)
        return self


def plan_flight(plan: FlightPlan, seed: int) -> dict[str, dict[str, FloatArray]]:
    """Plan one flight: engine (`left`, `right`) -> channel -> `(time,)`.

    Channels are `time_s`, `TRA_deg` (0 idle .. 85 take-off), `ALT_ft`, `Mach`, `dT_C` and the
    switches `WOW`, `Approach`, `ECS`, `NAI`, `WAI` as 0 or 1. The air is the same for both
    engines; levers and some bleed tests differ. The same plan and seed give the same numbers.
    """
    random = seeded(seed)
    aircraft = AIRCRAFT[plan.aircraft]
    day = _draw_day(plan, aircraft, random)
    weather = draw_weather(day, random)
    legs = plan_legs(day, aircraft, plan.duration_s)
    time_s = np.arange(int(legs[-1].stop_s * plan.rate_hz + 1e-9)) / plan.rate_hz
    placed = work_levers(legs, plan.style, random)
    levers = {
        engine: set_apart(compose(placed[engine], time_s, 0.0, HAND_DEG_S), random)
        for engine in SIDES
    }
    alt_ft = altitude(day, legs, time_s)
    air = Air(
        time_s, alt_ft, planned_mach(day, legs, time_s, alt_ft), temperature_deviation(day, alt_ft)
    )
    switches = planned_switches(day, weather, legs, air)
    together = 0.5 * (levers["left"] + levers["right"])
    mach = flown_mach(air.mach, together, 1.0 / plan.rate_hz, aircraft.mach_max)
    shared = {"time_s": time_s, "ALT_ft": air.alt_ft, "Mach": mach, "dT_C": air.dT_C}
    return {
        engine: _channels(
            shared | {"TRA_deg": levers[engine]}, flipped(switches, flips(placed[engine]), air)
        )
        for engine in SIDES
    }


def plan_card(card: FlightCard, plan: FlightPlan, seed: int) -> dict[str, dict[str, FloatArray]]:
    """Fly a card; channels as of `plan_flight`, of `plan` only aircraft and rate.

    It begins at the first altitude with the levers set. Steps begin up to 2 s late and up to 100 ft
    off within the card's limits, one lever follows the other by 0.1 to 0.6 s, both are rigged
    apart and change the speed. Raises `ConfigError` for a card that the aircraft cannot fly.
    """
    aircraft, limits, dt_s = AIRCRAFT[plan.aircraft], card.limits, 1.0 / plan.rate_hz
    _check_card(card, aircraft)
    random = seeded(seed)

    def as_flown(one: Move) -> Move:
        height = np.clip(one.altitude_ft + random.uniform(-_OFF_FT, _OFF_FT), *limits.altitude_ft)
        late = one.settle_s + random.uniform(0.0, _LATE_S)
        return one.model_copy(update={"settle_s": late, "altitude_ft": float(height)})

    path = course(limits, [as_flown(one) for one in card.steps], dt_s)
    time_s = np.arange(len(path["lever"])) / plan.rate_hz
    led = rate_limited(path["lever"], HAND_DEG_S * dt_s)
    pair = (led, np.interp(time_s - random.uniform(*LATER_S), time_s, led))
    first = int(random.integers(2))
    levers = {side: set_apart(pair[k ^ first], random) for k, side in enumerate(SIDES)}
    mach = flown_mach(path["Mach"], 0.5 * (pair[0] + pair[1]), dt_s, aircraft.mach_max)
    shared = {"time_s": time_s, "ALT_ft": path["ALT_ft"], "Mach": mach}
    shared["dT_C"] = np.full(len(time_s), limits.dT_C)
    switches = {
        name: path[name] > 0.0
        if name in path
        else np.full(len(time_s), limits.inputs.get(name, 0.0) > 0.0)
        for name in SWITCH_NAMES
    }
    return {side: _channels(shared | {"TRA_deg": levers[side]}, switches) for side in SIDES}


def _check_card(card: FlightCard, aircraft: Aircraft) -> None:
    limits = card.limits
    named = [*limits.inputs, *limits.switches]
    if card.lever != "TRA_deg" or not {*named} <= {*SWITCH_NAMES}:
        raise ConfigError(
            f"the virtual engines have the lever TRA_deg and the switches "
            f"{', '.join(SWITCH_NAMES)}; the card is for {', '.join([card.lever, *named])}",
            hint="Make the card from a run or diagnosis with these inputs",
        )
    length_s = sum(60.0 * one.minutes for one in card.steps)
    check_between("the card's length in s", length_s, _BRIEFEST_S, LONGEST_S)
    for one in card.steps:
        check_between("the card's altitude", one.altitude_ft, 0.0, aircraft.ceiling_ft)
        for _, lever in one.corners:
            check_between("the card's lever", lever, IDLE_DEG, TAKE_OFF_DEG)
    check_between("the card's Mach number", max(limits.mach), 0.0, aircraft.mach_max)
    check_between("the card's dT_C", limits.dT_C, DT_LOW_C, DT_HIGH_C)


def seeded(seed: int) -> np.random.Generator:
    return np.random.default_rng([20261121, seed])


def _draw_day(plan: FlightPlan, aircraft: Aircraft, random: np.random.Generator) -> Day:
    """Draw all properties of the day, so that a value given in the plan changes no other."""
    field_ft = random.uniform(0.0, 2500.0)
    top_ft = random.uniform(0.75, 1.0) * aircraft.ceiling_ft
    mach = random.uniform(0.72, aircraft.mach_max - 0.02)
    dT_C = random.uniform(DT_LOW_C + 2.0, DT_HIGH_C - 2.0)
    return Day(
        field_ft=field_ft if plan.field_ft is None else plan.field_ft,
        top_ft=top_ft if plan.top_ft is None else plan.top_ft,
        cruise_mach=mach if plan.cruise_mach is None else plan.cruise_mach,
        dT_C=dT_C if plan.dT_C is None else plan.dT_C,
        dT_phase=random.uniform(0.0, 2.0 * np.pi),
        spread=random.uniform(),
        long_tests=plan.style == "enriched",
    )


def _channels(
    continuous: dict[str, FloatArray], switches: dict[str, NDArray[np.bool_]]
) -> dict[str, FloatArray]:
    every = continuous | {name: flags.astype(np.float64) for name, flags in switches.items()}
    return {name: every[name].copy() for name in CHANNEL_NAMES}
