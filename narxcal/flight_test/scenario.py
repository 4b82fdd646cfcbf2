"""A virtual flight test: which engine, which flights, which sensors, and what is not modelled.

The configuration of `narxcal fly`. From a scenario's seed each flight has a seed of its own, so
that neither the number of flights nor the order in which they are flown changes any of them.
"""

from __future__ import annotations

import zlib
from collections.abc import Mapping
from functools import lru_cache
from typing import Any, Final, Literal, NamedTuple

import numpy as np
from pydantic import Field, field_validator, model_validator

from narxcal.channels import CHANNELS, channel
from narxcal.errors import ConfigError
from narxcal.flight_test.data_sets import (
    DataSet,
    fast_push_sets,
    take_off_approach_sets,
    throttle_rate_sets,
)
from narxcal.flight_test.envelope import DT_HIGH_C, DT_LOW_C, MACH_MAX
from narxcal.flight_test.flown_effects import FlownEffect, Side, check_once, drawn_windows
from narxcal.flight_test.measurement import FloatArray
from narxcal.flight_test.profile import FlightPlan, plan_flight
from narxcal.flight_test.sensors import SensorConfig
from narxcal.settings import Section

SCHEMA: Final = "narxcal.fly/1"
_OUTPUTS = tuple(name for name, each in CHANNELS.items() if each.role == "output")
_FLIGHTS = 6
_STRETCH_S = 300.0  # one drawn window of an unlogged switch in each
_RECORDERS = {
    "fast_push": fast_push_sets,
    "throttle_rate": throttle_rate_sets,
    "take_off_approach": take_off_approach_sets,
}
_RECORDED = {"fast_push": 5, "throttle_rate": 5, "take_off_approach": 5}
# The pilot's lever moves where it is faster than a hand's tremor, and has moved so far.
_STILL_DEG_S, _LEAST_DEG = 0.2, 0.5


class FlightScenario(Section):
    """Everything that decides the logs of `narxcal fly`.

    engine: the preset. engines: which of the two on the aircraft are recorded.
    flights, seed: how many, and what they are drawn from; left out, six or all `records`.
    plan: the kind of flight; the aircraft is the engine's where it is not named.
    records: fly the data sets of `narxcal.flight_test.data_sets` instead; of `plan`, only the rate
        counts then.
    build_scatter_pct: standard deviation of each efficiency and flow between engines of one type.
    sensors: how channels are measured. outputs: which outputs are recorded; left out, all.
    effects: what these engines and sensors have that their model does not.
    """

    schema_: Literal["narxcal.fly/1"] = Field(default=SCHEMA, alias="schema")
    name: str = "virtual flight test"
    engine: Literal["business_jet", "single_aisle"] = "business_jet"
    engines: tuple[Side, ...] = Field(default=("left", "right"), min_length=1)
    flights: int | None = Field(default=None, ge=1, le=999)
    seed: int = Field(default=0, ge=0)
    plan: FlightPlan = FlightPlan()
    records: Literal["fast_push", "throttle_rate", "take_off_approach"] | None = None
    build_scatter_pct: float = Field(default=0.5, ge=0, le=3)
    sensors: SensorConfig = SensorConfig()
    outputs: tuple[str, ...] | None = Field(default=None, min_length=1)
    effects: tuple[FlownEffect, ...] = ()

    @field_validator("outputs")
    @classmethod
    def _outputs(cls, names: tuple[str, ...] | None) -> tuple[str, ...] | None:
        for name in names or ():
            if channel(name).role != "output":
                raise ConfigError(
                    f"outputs names '{name}', which is no output of an engine",
                    hint=f"Outputs are {', '.join(_OUTPUTS)}",
                )
        return names

    @model_validator(mode="after")
    def _possible(self) -> FlightScenario:
        check_once(self.effects)
        most = _RECORDED[self.records] if self.records else self.flight_count
        if self.flight_count > most:
            raise ConfigError(
                f"there are {most} flights of '{self.records}' records, asked for {self.flights}"
            )
        for effect in self.effects:
            beyond = [flight for flight in effect.flights if flight > self.flight_count]
            if beyond:
                raise ConfigError(
                    f"effect '{effect.name}' names flight {beyond[0]}, "
                    f"and there are {self.flight_count}"
                )
        return self

    @property
    def flight_count(self) -> int:
        """How many flights there are."""
        if self.flights is not None:
            return self.flights
        return _RECORDED[self.records] if self.records else _FLIGHTS

    def flight_plan(self) -> FlightPlan:
        """Give the plan of every flight, with the aircraft of the engine."""
        if "aircraft" in self.plan.model_fields_set:
            return self.plan
        return self.plan.model_copy(update={"aircraft": self.engine})

    def planned(self, flight: int) -> Mapping[str, Mapping[str, FloatArray]]:
        """Plan flight number `flight` (from 1): engine -> channel -> `(time,)`."""
        if self.records:
            sets = [each for each in self._data_sets() if each.flight == flight]
            return {each.engine: _inside(each.channels) for each in sets}
        return plan_flight(self.flight_plan(), self._number(flight))

    def log_name(self, flight: int, engine: str) -> str:
        """Name of a log without the ending: `flight_01_left`, or `data_set_01` of records."""
        sides = ("left", "right")
        if self.records:
            return f"data_set_{2 * flight - 1 + sides.index(engine):02d}"
        return f"flight_{flight:02d}_{engine}"

    def _data_sets(self) -> tuple[DataSet, ...]:
        return _recorded(self.records or "", self._number(0), self.plan.rate_hz)

    def _number(self, flight: int) -> int:
        return int(self.stream(flight, "plan").generate_state(1, np.uint32)[0])

    def stream(self, flight: int, purpose: str) -> np.random.SeedSequence:
        """Give the seed of one flight for one purpose; flight 0 stands for all of them."""
        return np.random.SeedSequence(self.seed, spawn_key=(flight, zlib.crc32(purpose.encode())))

    def effects_on(self, flight: int, engine: str, end_s: float) -> list[FlownEffect]:
        """Effects of one engine's flight of `end_s` seconds, each with its windows.

        `end_s` is that of the longer log of the two. An `unlogged_switch` without windows gets
        drawn ones, the same for both engines.
        """
        return [
            self._with_windows(effect, flight, end_s)
            for effect in self.effects
            if effect.acts(flight, engine)
        ]

    def _with_windows(self, effect: FlownEffect, flight: int, end_s: float) -> FlownEffect:
        if effect.id != "unlogged_switch" or effect.windows_s:
            return effect
        random = np.random.default_rng(self.stream(flight, "unlogged_switch"))
        return effect.model_copy(update={"windows_s": drawn_windows(random, end_s, _STRETCH_S)})


@lru_cache(maxsize=2)
def _recorded(records: str, seed: int, rate_hz: float) -> tuple[DataSet, ...]:
    """Plan all data sets at once, as they are drawn together."""
    return _RECORDERS[records](seed, rate_hz)


def _inside(channels: Mapping[str, FloatArray]) -> dict[str, FloatArray]:
    """Put back what rounding has taken out of the envelope on which the records touch."""
    return {
        **channels,
        "Mach": np.clip(channels["Mach"], 0.0, MACH_MAX),
        "dT_C": np.clip(channels["dT_C"], DT_LOW_C, DT_HIGH_C),
    }


class LeverMove(NamedTuple):
    """A movement of the lever in one direction, from its start to its end."""

    start_s: float
    stop_s: float
    from_deg: float
    to_deg: float

    @property
    def kind(self) -> str:
        """`push` or `pull`."""
        return "push" if self.to_deg > self.from_deg else "pull"

    def row(self) -> dict[str, Any]:
        """Give it as a row of the truth file."""
        return {"kind": self.kind, **self._asdict()}


def lever_moves(time_s: FloatArray, tra_deg: FloatArray) -> list[LeverMove]:
    """Find the true movements of a lever `(time,)`: `start_s` is the last sample before it moves.

    A change of direction begins another movement; below half a degree there is none.
    """
    way = np.sign(np.where(np.abs(_rates(time_s, tra_deg)) > _STILL_DEG_S, np.diff(tra_deg), 0.0))
    edges = np.flatnonzero(np.diff(way)) + 1
    starts, stops = [0, *edges.tolist()], [*edges.tolist(), len(way)]
    moves = [
        LeverMove(float(time_s[a]), float(time_s[b]), float(tra_deg[a]), float(tra_deg[b]))
        for a, b in zip(starts, stops, strict=True)
        if way[a : a + 1].any()
    ]
    return [move for move in moves if abs(move.to_deg - move.from_deg) >= _LEAST_DEG]


def _rates(time_s: FloatArray, values: FloatArray) -> FloatArray:
    return np.diff(values) / np.diff(time_s)


def canonical(names: Mapping[str, Any]) -> list[str]:
    """Put channel names in the order of the table of channels."""
    return [name for name in CHANNELS if name in names]
