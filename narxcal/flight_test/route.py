"""The route of the aircraft: legs of a flight, its altitude, Mach number and air, and its switches.

Envelope: the calibration paper's (section 2.1), 0 to 12 km, up to Mach 0.85, static temperature
-30 to +20 degC off the standard day; two aircraft limit it further. Altitude follows from rates of
climb and descent with rounded corners, Mach from calibrated airspeed by leg, limited to cruise
Mach, and both levers change the speed slowly. The static temperature deviation depends on altitude.

Switches: weight on wheels; approach idle from each approach to touch-down or 10 s into the
go-around; some take-offs without packs; nacelle and wing anti-ice in cloud layers where the total
temperature is low. Test points flip bleed and anti-ice.

Not modelled: wind, turbulence, turns, weight and drag, engine start, icing, valves that move in
time. A flight has a natural length (80 to 90 min in line operation, 110 to 130 min enriched). In a
shorter one each leg shrinks towards its minimum time: levers and switches keep their speed, and
altitude, Mach and temperature change faster. All quantities over time are arrays `(time,)`.
"""

from __future__ import annotations

import tomllib
from collections.abc import Iterable
from dataclasses import dataclass
from importlib.resources import files
from itertools import accumulate
from typing import Any

import numpy as np
from scipy.signal import lfilter

from narxcal.atmosphere import FT_M, air_state, mach_of_cas
from narxcal.flight_test.manoeuvres import Switched
from narxcal.support.arrays import BoolArray, FloatArray, spans
from narxcal.support.errors import ConfigError

CEILING_FT = 12_000.0 / FT_M
MACH_MAX = 0.85
DT_LOW_C, DT_HIGH_C = -30.0, 20.0
# Sampling rates: at least the 4 Hz that short delays need.
RATE_HZ = (4.0, 256.0)
SWITCH_NAMES = ("WOW", "Approach", "ECS", "NAI", "WAI")
CHANNEL_NAMES = ("time_s", "TRA_deg", "ALT_ft", "Mach", "dT_C", *SWITCH_NAMES)


@dataclass(frozen=True)
class Aircraft:
    """Limits of an aircraft: ceiling, highest Mach, climb rates low and high up (ft/min)."""

    ceiling_ft: float
    mach_max: float
    climb_fpm: float
    climb_high_fpm: float


# Round figures of the classes, not of one type; both are kept inside the envelope above.
AIRCRAFT = {
    "business_jet": Aircraft(CEILING_FT, MACH_MAX, 3200.0, 1800.0),
    "single_aisle": Aircraft(39_000.0, 0.82, 2500.0, 1300.0),
}


def check_between(name: str, value: float, low: float, high: float) -> None:
    """Raise `ConfigError` unless `low <= value <= high`; NaN is refused."""
    if not low <= value <= high:
        raise ConfigError(f"{name} has to lie in {low:g} .. {high:g}, got {value:g}")


LEGS: dict[str, dict[str, Any]] = tomllib.loads(
    files(__package__).joinpath("legs.toml").read_text("utf-8")
)
LEAST_S: dict[str, float] = {name: leg["least_s"] for name, leg in LEGS.items()}
SHORTEST_S = sum(LEAST_S.values())
GROUND = ("taxi_out", "take_off", "roll_out", "taxi_in")
# Corners are rounded over this time near the ground, and over the longer one elsewhere.
_ROUND_S, _ROUND_HIGH_S = 10.0, 30.0
_NEAR_GROUND = (*GROUND, "initial_climb", "approach", "go_around", "circuit", "final", "flare")
# Idle in cruise decelerates an aircraft by about 0.6 m/s2 (lift over drag 16): with 55 deg of lever
# and a time constant of 30 s that is this much Mach per deg. The pilot trims it out in minutes.
_MACH_PER_DEG, _INERTIA_S, _TRIMMED_S = 1.1e-3, 30.0, 300.0


@dataclass(frozen=True)
class Day:
    """Random properties of one flight: airfield, altitude, speed and air.

    `long_tests`: level legs are long enough for the whole set of test points.
    """

    field_ft: float
    top_ft: float
    cruise_mach: float
    dT_C: float
    dT_phase: float
    spread: float
    long_tests: bool


@dataclass(frozen=True)
class Leg:
    """Part of a flight from `start_s` to `stop_s`, which ends at `end_ft` and `end_kt`."""

    name: str
    start_s: float
    stop_s: float
    end_ft: float
    end_kt: float


def plan_legs(day: Day, aircraft: Aircraft, duration_s: float | None) -> list[Leg]:
    """Plan the legs of `day` in time; `duration_s` None gives the natural length.

    A length between the shortest and the natural one shrinks the legs; additional time is spent in
    cruise.
    """
    ends = _altitudes(day)
    natural = _natural_s(day, aircraft, ends)
    lengths = natural if duration_s is None else _stretched(natural, duration_s)
    stops = list(accumulate(lengths.values()))
    rows = zip(LEAST_S, [0.0, *stops[:-1]], stops, strict=True)
    return [Leg(name, start, stop, ends[name], LEGS[name]["end_kt"]) for name, start, stop in rows]


def _altitudes(day: Day) -> dict[str, float]:
    """Pressure altitude at the end of each leg, ft."""
    rise = day.top_ft - day.field_ft
    low = day.field_ft + min(7000.0 + 5000.0 * day.spread, 0.45 * rise)
    cruise = day.top_ft - min(4000.0, 0.15 * rise)
    above = {"initial_climb": 3000.0, "low_descent": 3000.0, "approach": 250.0}
    above |= {"go_around": 3000.0, "circuit": 2500.0, "final": 50.0}
    ends = {name: day.field_ft + above.get(name, 0.0) for name in LEAST_S}
    ends |= dict.fromkeys(("climb", "low_level", "descent"), low)
    ends |= dict.fromkeys(("climb_high", "cruise"), cruise)
    return ends | dict.fromkeys(("step_climb", "high_cruise"), day.top_ft)


def _natural_s(day: Day, aircraft: Aircraft, ends: dict[str, float]) -> dict[str, float]:
    up, high = aircraft.climb_fpm, aircraft.climb_high_fpm
    rates = {"initial_climb": up, "climb": 0.85 * up, "climb_high": 0.5 * (up + high)}
    rates |= {"step_climb": 0.7 * high, "descent": 2300.0, "low_descent": 1500.0}
    rates |= {"approach": 750.0, "go_around": 2200.0, "final": 700.0}
    level = {"taxi_out": 300.0, "take_off": 34.0, "low_level": 90.0, "cruise": 1100.0}
    level |= {"high_cruise": 800.0, "circuit": 140.0, "flare": 10.0}
    level |= {"roll_out": 30.0, "taxi_in": 200.0}
    if day.long_tests:
        level |= {"low_level": 1500.0, "cruise": 900.0, "high_cruise": 1600.0}
    slower, before, seconds = 0.85 + 0.3 * day.spread, day.field_ft, {}
    for name, least in LEAST_S.items():
        climbed = abs(ends[name] - before)
        natural = 60.0 * climbed / rates[name] if name in rates else level[name] * slower
        seconds[name] = max(natural, least)
        before = ends[name]
    return seconds


def _stretched(natural: dict[str, float], duration_s: float) -> dict[str, float]:
    total = sum(natural.values())
    share = (duration_s - SHORTEST_S) / (total - SHORTEST_S)
    if share <= 1.0:
        return {name: LEAST_S[name] + share * (natural[name] - LEAST_S[name]) for name in LEAST_S}
    more = 0.5 * (duration_s - total)
    return {
        name: seconds + (more if name in ("cruise", "high_cruise") else 0.0)
        for name, seconds in natural.items()
    }


def during(legs: list[Leg], time_s: FloatArray, names: tuple[str, ...]) -> BoolArray:
    """Mark the samples of the legs called `names`."""
    flags = np.zeros(len(time_s), dtype=np.bool_)
    for leg in legs:
        if leg.name in names:
            flags |= (time_s >= leg.start_s) & (time_s < leg.stop_s)
    last = legs[-1]
    return flags | (time_s >= last.stop_s) if last.name in names else flags


def altitude(day: Day, legs: list[Leg], time_s: FloatArray) -> FloatArray:
    """Pressure altitude in ft at `time_s`: exactly the field's with weight on wheels."""
    corners = [(0.0, day.field_ft), *((leg.stop_s, leg.end_ft) for leg in legs)]
    times, heights = np.array(corners).T
    half = 0.5 * _ROUND_S
    names = list(LEAST_S)
    # Rounded corners must not begin to climb before lift-off, or descend below the field.
    times[1 + names.index("take_off")] += half
    times[1 + names.index("flare")] -= half
    path = np.interp(time_s, times, heights)
    near = smoothed(during(legs, time_s, _NEAR_GROUND).astype(float), time_s, _longer_s(legs))
    return near * smoothed(path, time_s, _ROUND_S) + (1.0 - near) * smoothed(
        path, time_s, _longer_s(legs)
    )


def _longer_s(legs: list[Leg]) -> float:
    """Time over which corners away from the ground are rounded; shorter in a shortened flight."""
    shortest = min(leg.stop_s - leg.start_s for leg in legs if leg.name not in _NEAR_GROUND)
    return float(np.clip(0.5 * shortest, _ROUND_S, _ROUND_HIGH_S))


def planned_mach(day: Day, legs: list[Leg], time_s: FloatArray, alt_ft: FloatArray) -> FloatArray:
    """Mach number with the levers at trim: airspeed by leg, at most cruise Mach."""
    corners = [(0.0, 0.0), *((leg.stop_s, leg.end_kt) for leg in legs)]
    times, speeds = np.array(corners).T
    mach = mach_of_cas(np.interp(time_s, times, speeds), alt_ft)
    return smoothed(np.minimum(mach, day.cruise_mach), time_s, _ROUND_S)


def flown_mach(
    planned: FloatArray, lever_deg: FloatArray, dt_s: float, mach_max: float
) -> FloatArray:
    """Add the response of the speed to the levers' deviation from trim, below `mach_max`.

    A first-order lag minus a slower one; it vanishes towards Mach 0.2, since a pilot controls the
    speed near the ground.
    """
    departure = _first_order(lever_deg, _INERTIA_S, dt_s) - _first_order(
        lever_deg, _TRIMMED_S, dt_s
    )
    change = _MACH_PER_DEG * departure * np.clip((planned - 0.2) / 0.3, 0.0, 1.0)
    room = np.maximum(mach_max - planned, 1e-6)
    flown = planned + np.where(change > 0.0, room * np.tanh(change / room), change)
    return np.minimum(flown, mach_max)


def temperature_deviation(day: Day, alt_ft: FloatArray) -> FloatArray:
    """Static temperature minus standard, degC: the day's, plus up to 3 degC by altitude."""
    room = min(3.0, DT_HIGH_C - day.dT_C, day.dT_C - DT_LOW_C)
    return day.dT_C + room * np.sin(day.dT_phase + alt_ft / 6000.0)


def _first_order(values: FloatArray, tau_s: float, dt_s: float) -> FloatArray:
    keep = float(np.exp(-dt_s / tau_s))
    filtered = lfilter([1.0 - keep], [1.0, -keep], values - values[0])
    return np.asarray(filtered + values[0], dtype=np.float64)


def smoothed(values: FloatArray, time_s: FloatArray, width_s: float) -> FloatArray:
    """Round corners by two moving averages of `width_s` together, with constant ends."""
    half = max(1, round(0.25 * width_s / float(time_s[1] - time_s[0])))
    for _ in range(2):
        padded = np.pad(values, half, mode="edge")
        sums = np.cumsum(np.insert(padded - values[0], 0, 0.0))
        values = values[0] + (sums[2 * half + 1 :] - sums[: -2 * half - 1]) / (2 * half + 1)
    return values


# Anti-ice is on at a total air temperature of 10 degC or less in visible moisture, and a static one
# of -40 degC or more: colder clouds are dry (the usual rule of flight manuals). The margin covers
# the changes of speed, and so of total temperature, that the levers cause.
ANTI_ICE_C = 10.0
DRY_C = -40.0
_MARGIN_C = 6.0
_ABOVE_FIELD_FT = 1500.0
_SHORTEST_S = 5.0
_RETRACTED_S = 10.0


@dataclass(frozen=True)
class Cloud:
    """A layer from `base_ft` to `top_ft`; in `severe` ones wing anti-ice is on, too."""

    base_ft: float
    top_ft: float
    severe: bool


@dataclass(frozen=True)
class Weather:
    """Clouds of the day, and whether take-off is flown without packs."""

    clouds: tuple[Cloud, ...]
    packs_off: bool


def draw_weather(day: Day, random: np.random.Generator) -> Weather:
    """Draw one or two layers below the top of the flight."""
    clouds = []
    for _ in range(int(random.integers(1, 3))):
        base = random.uniform(day.field_ft + 1000.0, 0.8 * day.top_ft)
        thick = random.uniform(1500.0, 8000.0)
        clouds.append(Cloud(base, base + thick, bool(random.random() < 0.6)))
    return Weather(tuple(clouds), bool(random.random() < 0.5))


@dataclass(frozen=True)
class Air:
    """Planned altitude, Mach and temperature deviation over `time_s`, each `(time,)`."""

    time_s: FloatArray
    alt_ft: FloatArray
    mach: FloatArray
    dT_C: FloatArray

    @property
    def cold(self) -> BoolArray:
        """Whether anti-ice may be on."""
        total = air_state(self.alt_ft, self.mach, self.dT_C).T2_K - 273.15
        return np.asarray(total <= ANTI_ICE_C - _MARGIN_C)

    @property
    def dry(self) -> BoolArray:
        """Whether clouds are too cold for icing."""
        return np.asarray(air_state(self.alt_ft, 0.0, self.dT_C).T_K - 273.15 < DRY_C)


def planned_switches(day: Day, weather: Weather, legs: list[Leg], air: Air) -> dict[str, BoolArray]:
    """Plan the switches, which both engines share, without test points."""
    ground = during(legs, air.time_s, GROUND)
    high = air.alt_ft > day.field_ft + _ABOVE_FIELD_FT
    clouds = [(c, (air.alt_ft >= c.base_ft) & (air.alt_ft <= c.top_ft)) for c in weather.clouds]
    none = np.zeros_like(ground)
    icing = air.cold & ~air.dry & ~ground
    nacelle = icing & np.logical_or.reduce([none, *(inside for _, inside in clouds)])
    wing = icing & high & np.logical_or.reduce([none, *(i for c, i in clouds if c.severe)])
    packs_off = during(legs, air.time_s, ("take_off", "initial_climb")) & ~high
    return {
        "WOW": ground,
        "Approach": _approach(legs, air.time_s),
        "ECS": ~(packs_off & weather.packs_off),
        "NAI": _long_enough(nacelle, air.time_s),
        "WAI": _long_enough(wing, air.time_s),
    }


def _approach(legs: list[Leg], time_s: FloatArray) -> BoolArray:
    flags = during(legs, time_s, ("approach", "final", "flare"))
    around = next(leg for leg in legs if leg.name == "go_around")
    return flags | ((time_s >= around.start_s) & (time_s < around.start_s + _RETRACTED_S))


def _long_enough(flags: BoolArray, time_s: FloatArray) -> BoolArray:
    """Drop intervals of less than a few seconds."""
    kept = np.zeros_like(flags)
    dt_s = float(time_s[1] - time_s[0])
    for start, stop in spans(flags):
        kept[start:stop] = (stop - start) * dt_s >= _SHORTEST_S
    return kept


def flipped(
    switches: dict[str, BoolArray], flips: Iterable[Switched], air: Air
) -> dict[str, BoolArray]:
    """Flip switches at test points, but no anti-ice in warm air or on the ground."""
    changed = {name: flags.copy() for name, flags in switches.items()}
    allowed = air.cold & ~switches["WOW"]
    for flip in flips:
        first, last = np.searchsorted(air.time_s, (flip.start_s, flip.stop_s))
        if flip.channel == "ECS" or allowed[first:last].all():
            changed[flip.channel][first:last] = ~switches[flip.channel][first:last]
    return changed
