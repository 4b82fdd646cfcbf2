"""The effects that a virtual flight is flown with: which, how large, where, when, and their text.

On a command line an effect reads `ID[@CHANNEL]:NAME=VALUE[,NAME=VALUE...]`, and several are
separated by commas or blanks, as in `spool_lag:factor=1.3,sensor_lag@EGT_C:tau_s=1.5`: what has a
name and a value only belongs to the effect before it. Besides an effect's own parameters there are
`window=START-END` (s, only for effects that may come and go), `flight=N` and `engine=NAME`, each
as often as wanted.
"""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Literal

import numpy as np
from pydantic import Field, model_validator

from narxcal.channels import channel
from narxcal.errors import ConfigError
from narxcal.flight_test import sensor_faults
from narxcal.flight_test.sensor_faults import SensorFault, channels_of
from narxcal.settings import Section
from narxcal.turbofan import unmodelled

Side = Literal["left", "right"]
SIDES: tuple[Side, ...] = ("left", "right")
# Effect -> parameter -> (unit, low, high, neutral).
PARAMETERS: dict[str, Mapping[str, tuple[str, float, float, float]]] = {
    **unmodelled.PARAMETERS,
    **sensor_faults.PARAMETERS,
}
_EXAMPLE = {"flowmeter_dynamics": "FF_kgph"}
WINDOWED = ("unlogged_switch", *sensor_faults.WINDOWED)
GRAMMAR = "ID[@CHANNEL]:NAME=VALUE[,NAME=VALUE...]"


class FlownEffect(Section):
    """One of the TOML tables `[[effects]]`.

    `parameters` maps a name to its size. `windows_s` are (start, end) in each flight; without any,
    `unlogged_switch` draws its own and the others act all the time. `flights` (from 1) and
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
        if self.id not in PARAMETERS:
            raise ConfigError(f"unknown effect '{self.id}'", hint=_nearest(self.id, PARAMETERS))
        self._check_channel()
        self._check_sizes()
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
        """Whether this engine has it on this flight."""
        there = not self.flights or flight in self.flights
        return there and (not self.engines or engine in self.engines)

    def fault(self) -> SensorFault:
        """Give the fault of a sensor that it is."""
        return SensorFault(self.id, self.channel or "", self.parameters, self.windows_s)

    def _check_channel(self) -> None:
        if not self.on_sensor:
            if self.channel is not None:
                raise ConfigError(
                    f"effect '{self.id}' sits in the engine and takes no channel, "
                    f"found '{self.channel}'",
                    hint=f"Write {self.id} alone",
                )
            return
        fitting = channels_of(self.id)
        if self.channel is None:
            raise ConfigError(
                f"effect '{self.id}' sits on one channel, and none is given",
                hint=f"Write, for example, {self.id}@{_EXAMPLE.get(self.id, 'EGT_C')}",
            )
        channel(self.channel)
        if self.channel not in fitting:
            raise ConfigError(
                f"effect '{self.id}' cannot sit on {self.channel}",
                hint=f"It can sit on {', '.join(fitting)}",
            )

    def _check_sizes(self) -> None:
        known = PARAMETERS[self.id]
        for name, value in self.parameters.items():
            if name not in known:
                raise ConfigError(
                    f"effect '{self.id}' has no parameter '{name}'", hint=_nearest(name, known)
                )
            unit, low, high, _ = known[name]
            if not low <= value <= high:
                raise ConfigError(
                    f"effect '{self.id}': {name} has to lie in {low:g} .. {high:g}"
                    f"{'' if unit == '-' else f' {unit}'}, found {value:g}"
                )
        if not self.parameters:
            raise ConfigError(f"effect '{self.id}' has no size", hint=f"Give {' or '.join(known)}")

    def _check_windows(self) -> None:
        if self.windows_s and self.id not in WINDOWED:
            raise ConfigError(
                f"effect '{self.id}' acts all the time and takes no windows",
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
    """Refuse an effect that one engine would have twice; raises `ConfigError`."""
    for number, one in enumerate(effects):
        for other in effects[:number]:
            engines = not (one.engines and other.engines) or set(one.engines) & set(other.engines)
            flights = not (one.flights and other.flights) or set(one.flights) & set(other.flights)
            if one.name == other.name and engines and flights:
                raise ConfigError(
                    f"effect '{one.name}' is given twice", hint="Give its parameters at one place"
                )


def parse_effects(words: Iterable[str]) -> tuple[FlownEffect, ...]:
    """Read effects from the words of a command line; `none` alone means no effects.

    Raises `ConfigError` for what cannot be read, and as `FlownEffect` for what cannot be.
    """
    pieces = [piece for word in words for piece in re.split(r"[,\s]+", word) if piece]
    if pieces == ["none"]:
        return ()
    tables: list[dict[str, Any]] = []
    for piece in pieces:
        head, *settings = piece.split(":")
        if settings or "=" not in piece:
            tables.append(_head(head))
        elif tables:
            settings = [piece]
        else:
            raise ConfigError(f"'{piece}' belongs to no effect", hint=f"Write {GRAMMAR}")
        for setting in settings:
            _set(tables[-1], setting)
    effects = tuple(FlownEffect.parse(table) for table in tables)
    check_once(effects)
    return effects


def _head(text: str) -> dict[str, Any]:
    name, at, where = text.partition("@")
    if not name or (at and not where):
        raise ConfigError(f"cannot read the effect '{text}'", hint=f"Write {GRAMMAR}")
    table: dict[str, Any] = {"id": name, "parameters": {}}
    return table | ({"channel": where} if at else {})


def _set(table: dict[str, Any], text: str) -> None:
    """Put one `NAME=VALUE` in its place."""
    name, equals, value = text.partition("=")
    if not (name and equals and value):
        raise ConfigError(f"effect '{table['id']}': cannot read '{text}'", hint=f"Write {GRAMMAR}")
    if name == "window":
        ends = value.split("-")
        if len(ends) != 2:
            raise ConfigError(
                f"effect '{table['id']}': window has to be START-END in s, found '{value}'"
            )
        pair = tuple(_number(table["id"], name, end) for end in ends)
        table.setdefault("windows_s", []).append(pair)
    elif name == "flight":
        table.setdefault("flights", []).append(_whole(table["id"], name, value))
    elif name == "engine":
        table.setdefault("engines", []).append(value)
    elif name in table["parameters"]:
        raise ConfigError(f"effect '{table['id']}': {name} is given twice")
    else:
        table["parameters"][name] = _number(table["id"], name, value)


def _number(effect: str, name: str, text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise ConfigError(f"effect '{effect}': {name} has to be a number, found '{text}'")
    return value


def _whole(effect: str, name: str, text: str) -> int:
    if not text.isdecimal():
        raise ConfigError(f"effect '{effect}': {name} has to be a whole number, found '{text}'")
    return int(text)


def _nearest(name: str, known: Iterable[str]) -> str:
    names = sorted(known)
    near = difflib.get_close_matches(name, names, n=1, cutoff=0.5)
    return f"Did you mean '{near[0]}'?" if near else f"Known are {', '.join(names)}"


def drawn_windows(
    random: np.random.Generator, end_s: float, stretch_s: float
) -> tuple[tuple[float, float], ...]:
    """One window in each stretch of about `stretch_s`, long enough to tell from noise."""
    count = max(1, round(end_s / stretch_s))
    stretch = end_s / count
    spans = []
    for number in range(count):
        length = stretch * random.uniform(0.2, 0.5)
        start = stretch * number + random.uniform(0.1, 0.9) * (stretch - length)
        spans.append((round(start, 3), round(start + length, 3)))
    return tuple(spans)
