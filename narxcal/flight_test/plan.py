"""A whole flight for both engines of an aircraft, as input channels of the virtual engine.

Taxi, take-off, step climbs, cruise, descent, approach, go-around, landing and taxi. `route` plans
legs, air and switches, `pilot` both levers; their docstrings say what each leaves out.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from pydantic import model_validator

from narxcal.flight_test.manoeuvres import HAND_DEG_S
from narxcal.flight_test.pilot import SIDES, STYLES, compose, flips, set_apart, work_levers
from narxcal.flight_test.route import (
    AIRCRAFT,
    CHANNEL_NAMES,
    DT_HIGH_C,
    DT_LOW_C,
    RATE_HZ,
    SHORTEST_S,
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
_FIELD_FT = (0.0, 6000.0)


class FlightPlan(Section):
    """The kind of flight to plan; values left out are drawn from the seed.

    style: `line` or `enriched`. aircraft: `business_jet` or `single_aisle`, which limits altitude
        and Mach. duration_s: length, at least 480 s; left out, the natural one (80 to 130 min).
    rate_hz: sampling rate. top_ft, cruise_mach: highest altitude and Mach in cruise.
    dT_C: static temperature off the standard day. field_ft: pressure altitude of the airfield.

    Raises `ConfigError` for an unknown name or a value out of range.
    """

    style: str = "enriched"
    aircraft: str = "business_jet"
    duration_s: float | None = None
    rate_hz: float = 32.0
    top_ft: float | None = None
    cruise_mach: float | None = None
    dT_C: float | None = None
    field_ft: float | None = None

    @model_validator(mode="after")
    def _possible(self) -> FlightPlan:
        _check_known("style", self.style, tuple(STYLES))
        _check_known("aircraft", self.aircraft, tuple(AIRCRAFT))
        limits = AIRCRAFT[self.aircraft]
        check_between("rate_hz", self.rate_hz, *RATE_HZ)
        for name, value, bounds, hint in (
            ("duration_s", self.duration_s, (SHORTEST_S, LONGEST_S), "No leg has less"),
            ("top_ft", self.top_ft, (_LOWEST_TOP_FT, limits.ceiling_ft), ""),
            ("cruise_mach", self.cruise_mach, (_SLOWEST_MACH, limits.mach_max), ""),
            ("dT_C", self.dT_C, (DT_LOW_C, DT_HIGH_C), ""),
            ("field_ft", self.field_ft, _FIELD_FT, ""),
        ):
            if value is not None:
                check_between(name, value, *bounds, hint)
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
    placed = work_levers(legs, "line" if plan.style == "line" else "enriched", random)
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


def seeded(seed: int) -> np.random.Generator:
    """Random generator of a seed; raises `ConfigError` for a negative one."""
    if seed < 0:
        raise ConfigError(f"a seed is a whole number from 0 on, got {seed}")
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
    """Put the channels in canonical order, switches as 0 and 1."""
    every = continuous | {name: flags.astype(np.float64) for name, flags in switches.items()}
    return {name: every[name].copy() for name in CHANNEL_NAMES}


def _check_known(name: str, value: str, known: tuple[str, ...]) -> None:
    if value not in known:
        raise ConfigError(f"unknown {name} '{value}'", hint=f"Known: {', '.join(known)}")
