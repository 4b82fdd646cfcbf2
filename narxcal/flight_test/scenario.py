"""The configuration of `narxcal fly`: which engine, flights and sensors, and which effects.

Each flight has a seed of its own, derived from that of the scenario, so that neither the number of
flights nor the order in which they are flown changes any of them.
"""

from __future__ import annotations

import zlib
from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Final, Literal

import numpy as np
from pydantic import Field, field_validator, model_validator

from narxcal.channels import CHANNELS, channel
from narxcal.flight_test import sensors as sensor_faults
from narxcal.flight_test.moves import FlightCard
from narxcal.flight_test.paper_records import (
    DataSet,
    fast_push_sets,
    take_off_approach_sets,
    throttle_rate_sets,
)
from narxcal.flight_test.pilot import SIDES, Side
from narxcal.flight_test.plan import FlightPlan, plan_card, plan_flight
from narxcal.flight_test.route import DT_HIGH_C, DT_LOW_C, MACH_MAX
from narxcal.flight_test.sensors import SensorConfig, SensorFault, channels_of
from narxcal.support.arrays import FloatArray
from narxcal.support.errors import ConfigError
from narxcal.support.settings import Section
from narxcal.turbofan import unmodelled

PARAMETERS: dict[str, unmodelled.Sizes] = {
    **unmodelled.PARAMETERS,
    **sensor_faults.PARAMETERS,
}
_EXAMPLE = {"flowmeter_dynamics": "FF_kgph"}
WINDOWED = ("unlogged_switch", *sensor_faults.WINDOWED)


class FlownEffect(Section):
    """One of the TOML tables `[[effects]]`.

    `parameters` maps a name to its size. `windows_s` are (start, end) in each flight; without any,
    those of `unlogged_switch` are drawn and the others act all the time. `flights` (from 1) and
    `engines` limit the effect to these; empty means all.
    """

    id: str
    channel: str | None = None
    parameters: dict[str, float] = Field(default_factory=dict)
    windows_s: tuple[tuple[float, float], ...] = ()
    flights: tuple[int, ...] = ()
    engines: tuple[Side, ...] = ()

    @model_validator(mode="after")
    def _possible(self) -> FlownEffect:
        unmodelled.check_sizes(self.id, {}, PARAMETERS)
        self._check_channel()
        unmodelled.check_sizes(self.id, self.parameters, PARAMETERS)
        if not self.parameters:
            names = " or ".join(PARAMETERS[self.id])
            raise ConfigError(f"effect '{self.id}' has no size", hint=f"Give {names}")
        self._check_windows()
        return self

    @property
    def name(self) -> str:
        """`ID`, or `ID@CHANNEL`."""
        return self.id if self.channel is None else f"{self.id}@{self.channel}"

    @property
    def on_sensor(self) -> bool:
        """Whether it acts on a recording; else it acts on an engine."""
        return self.id in sensor_faults.PARAMETERS

    def acts(self, flight: int, engine: str) -> bool:
        there = not self.flights or flight in self.flights
        return there and (not self.engines or engine in self.engines)

    def fault(self) -> SensorFault:
        return SensorFault(self.id, self.channel or "", self.parameters, self.windows_s)

    def _check_channel(self) -> None:
        if not self.on_sensor:
            if self.channel is not None:
                raise ConfigError(
                    f"effect '{self.id}' acts on the engine and has no channel, "
                    f"found '{self.channel}'",
                    hint="Leave the channel out",
                )
            return
        fitting = channels_of(self.id)
        if self.channel is None:
            raise ConfigError(
                f"effect '{self.id}' acts on one channel, and none is given",
                hint=f"Give one, for example channel = '{_EXAMPLE.get(self.id, 'EGT_C')}'",
            )
        channel(self.channel)
        if self.channel not in fitting:
            raise ConfigError(
                f"effect '{self.id}' cannot act on {self.channel}",
                hint=f"It can act on {', '.join(fitting)}",
            )

    def _check_windows(self) -> None:
        if self.windows_s and self.id not in WINDOWED:
            raise ConfigError(
                f"effect '{self.id}' acts all the time and has no windows",
                hint=f"Windows are for {', '.join(WINDOWED)}",
            )
        for start, end in self.windows_s:
            if not 0.0 <= start < end:
                raise ConfigError(
                    f"effect '{self.id}': a window has to start at 0 s or later and before its "
                    f"end, found {start:g}-{end:g}"
                )
        for flight in self.flights:
            if flight < 1:
                raise ConfigError(f"effect '{self.id}': flights are counted from 1, found {flight}")


def check_once(effects: Sequence[FlownEffect]) -> None:
    """Raise `ConfigError` for an effect that one engine would have twice."""
    for number, one in enumerate(effects):
        for other in effects[:number]:
            engines = not (one.engines and other.engines) or set(one.engines) & set(other.engines)
            flights = not (one.flights and other.flights) or set(one.flights) & set(other.flights)
            if one.name == other.name and engines and flights:
                raise ConfigError(
                    f"effect '{one.name}' is given twice", hint="Give its parameters at one place"
                )


def drawn_windows(
    random: np.random.Generator, end_s: float, stretch_s: float
) -> tuple[tuple[float, float], ...]:
    """Draw one window (start, end) in s in each interval of about `stretch_s`, up to `end_s`."""
    count = max(1, round(end_s / stretch_s))
    stretch = end_s / count
    spans = []
    for number in range(count):
        length = stretch * random.uniform(0.2, 0.5)
        start = stretch * number + random.uniform(0.1, 0.9) * (stretch - length)
        spans.append((round(start, 3), round(start + length, 3)))
    return tuple(spans)


SCHEMA: Final = "narxcal.fly/1"
_OUTPUTS = tuple(name for name, each in CHANNELS.items() if each.role == "output")
_FLIGHTS = 6
_STRETCH_S = 300.0  # one drawn window of an unlogged switch in each such interval
_RECORDERS = {
    "fast_push": fast_push_sets,
    "throttle_rate": throttle_rate_sets,
    "take_off_approach": take_off_approach_sets,
}
_RECORDED_FLIGHTS = 5  # of each family of records


class FlightScenario(Section):
    """Everything that decides the logs of `narxcal fly`.

    engine: the preset. engines: which of the two on the aircraft are recorded.
    flights: how many; left out, six or all `records`. seed: of all random numbers.
    plan: the kind of flight; the aircraft is the engine's where it is not named.
    records: fly these `paper_records` instead; of `plan`, only the rate counts then.
    card: fly this flight card on every flight; of `plan`, only rate and aircraft count then.
    build_scatter_pct: standard deviation of each efficiency and flow over engines of one type.
    sensors: how channels are measured. outputs: which outputs are recorded; left out, all.
    effects: effects of these engines and sensors that their model leaves out.
    """

    schema_: Literal["narxcal.fly/1"] = Field(default=SCHEMA, alias="schema")
    name: str = "virtual flight test"
    engine: Literal["business_jet", "single_aisle"] = "business_jet"
    engines: tuple[Side, ...] = Field(default=("left", "right"), min_length=1)
    flights: int | None = Field(default=None, ge=1, le=999)
    seed: int = Field(default=0, ge=0)
    plan: FlightPlan = FlightPlan()
    records: Literal["fast_push", "throttle_rate", "take_off_approach"] | None = None
    card: FlightCard | None = None
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
        if self.records and self.card:
            raise ConfigError("records and a card exclude each other", hint="Give one of them")
        most = _RECORDED_FLIGHTS if self.records else self.flight_count
        if self.flight_count > most:
            raise ConfigError(
                f"there are {most} flights of '{self.records}' records, "
                f"found flights = {self.flights}"
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
        if self.flights is not None:
            return self.flights
        return _RECORDED_FLIGHTS if self.records else _FLIGHTS

    def flight_plan(self) -> FlightPlan:
        """Return the plan of all flights, with the aircraft of the engine where none is named."""
        if "aircraft" in self.plan.model_fields_set:
            return self.plan
        return self.plan.model_copy(update={"aircraft": self.engine})

    def planned(self, flight: int) -> Mapping[str, Mapping[str, FloatArray]]:
        """Plan flight number `flight` (from 1): engine -> channel -> `(time,)`."""
        if self.records:
            sets = [
                each
                for each in _recorded(self.records, self._number(0), self.plan.rate_hz)
                if each.flight == flight
            ]
            return {each.engine: _inside(each.channels) for each in sets}
        if self.card is not None:
            return plan_card(self.card, self.flight_plan(), self._number(flight))
        return plan_flight(self.flight_plan(), self._number(flight))

    def log_name(self, flight: int, engine: str) -> str:
        """Name of a log without the ending: `flight_01_left`, or `data_set_01` of records."""
        if self.records:
            return f"data_set_{2 * flight - 1 + SIDES.index(engine):02d}"
        return f"flight_{flight:02d}_{engine}"

    def _number(self, flight: int) -> int:
        return int(self.stream(flight, "plan").generate_state(1, np.uint32)[0])

    def stream(self, flight: int, purpose: str) -> np.random.SeedSequence:
        """Return the seed of one flight for one purpose; flight 0 stands for all of them."""
        return np.random.SeedSequence(self.seed, spawn_key=(flight, zlib.crc32(purpose.encode())))

    def effects_on(self, flight: int, engine: str, end_s: float) -> list[FlownEffect]:
        """Effects on one engine in a flight of `end_s` seconds, each with its windows.

        `end_s` is that of the longer log of both engines. Windows of an `unlogged_switch` that has
        none are drawn, the same for both engines.
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
    """Clip to the envelope: the records touch its border, and rounding may pass it."""
    return {
        **channels,
        "Mach": np.clip(channels["Mach"], 0.0, MACH_MAX),
        "dT_C": np.clip(channels["dT_C"], DT_LOW_C, DT_HIGH_C),
    }
