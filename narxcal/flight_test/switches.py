"""The switch channels of a flight: weight on wheels, approach idle, bleed and anti-ice.

Modelled: weight on wheels from brakes-off to lift-off and from touch-down on; approach idle from
the beginning of each approach until touch-down or ten seconds into the go-around; packs off for
some take-offs; cloud layers in which nacelle, and in some of them wing, anti-ice is on when the
total temperature is low. Test points flip bleed and anti-ice where that is allowed, one engine's
or both. Not modelled: engine start, icing itself, an anti-ice valve that moves in time.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from narxcal.atmosphere import air_state
from narxcal.flight_test.journey import GROUND, Day, Leg, during
from narxcal.flight_test.manoeuvre_pieces import Switched

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

# Anti-ice is for a total air temperature of 10 degC or less in visible moisture, and a static one
# of -40 degC or more: colder clouds are dry (the usual rule of flight manuals). Planned with a
# margin, as the levers change speed and total temperature.
ANTI_ICE_C = 10.0
DRY_C = -40.0
_MARGIN_C = 6.0
_ABOVE_FIELD_FT = 1500.0
_SHORTEST_S = 5.0
_RETRACTED_S = 10.0


@dataclass(frozen=True)
class Cloud:
    """A layer from `base_ft` to `top_ft`; `severe` ones ice the wing too."""

    base_ft: float
    top_ft: float
    severe: bool


@dataclass(frozen=True)
class Weather:
    """The day's clouds, and whether take-off is flown with the packs off."""

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
        """Whether it is too cold for clouds to ice anything."""
        return np.asarray(air_state(self.alt_ft, 0.0, self.dT_C).T_K - 273.15 < DRY_C)


def planned_switches(day: Day, weather: Weather, legs: list[Leg], air: Air) -> dict[str, BoolArray]:
    """Set the switches as both engines have them, without test points."""
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
    """Drop what is on for less than a few seconds."""
    edges = np.flatnonzero(np.diff(np.concatenate(([False], flags, [False])).view(np.int8)))
    kept = np.zeros_like(flags)
    dt_s = float(time_s[1] - time_s[0])
    for start, stop in edges.reshape(-1, 2):
        kept[start:stop] = (stop - start) * dt_s >= _SHORTEST_S
    return kept


def flipped(
    switches: dict[str, BoolArray], flips: Iterable[Switched], air: Air
) -> dict[str, BoolArray]:
    """Turn switches round where test points do, but no anti-ice on in warm air or on the ground."""
    turned = {name: flags.copy() for name, flags in switches.items()}
    allowed = air.cold & ~switches["WOW"]
    for flip in flips:
        first, last = np.searchsorted(air.time_s, (flip.start_s, flip.stop_s))
        if flip.channel == "ECS" or allowed[first:last].all():
            turned[flip.channel][first:last] = ~switches[flip.channel][first:last]
    return turned
