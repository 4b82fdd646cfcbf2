"""Limits of an aircraft, the lever moves at fixed altitude that they admit, and cards of these.

Angles of a move are shares of the permitted lever range until they are placed, so that a lever in
degrees, a demanded speed and a fuel flow are served alike. Every move begins in equilibrium, after
`settle_s` at its first lever position.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Final, Literal, Self

import numpy as np
from pydantic import Field, field_validator, model_validator

from narxcal.flight_test.manoeuvres import (
    HAND_DEG_S,
    Corners,
    doublet,
    hold,
    ladder,
    levels,
    reslam,
    reversals,
    three_two_one_one,
)
from narxcal.support.arrays import FloatArray
from narxcal.support.errors import ConfigError
from narxcal.support.settings import Section, read_toml

SCHEMA: Final = "narxcal.limits/1"
CARD_SCHEMA: Final = "narxcal.card/1"
_FULL = 100.0  # shares of the lever range are in percent
_SMALL, _TRIANGLE, _UNIT_S, _PAUSE_S = 10.0, 3.0, 4.0, 2.0
_STEPS = ((0.0, 50.0), (25.0, 50.0), (50.0, 50.0), (100.0, -50.0), (75.0, -50.0), (50.0, -50.0))
_SET = 0.5  # of the time to settle, in which the lever is set
_LADDER = (15.0, 30.0, 50.0)

Pair = tuple[float, float]
Seconds = Annotated[float, Field(ge=5.0, le=600.0)]


class Limits(Section):
    """What a flight has to keep (`LIMITS.toml`).

    altitude_ft: lowest and highest; mach: at these two, between them in proportion.
    climb_ft_min: rate of climb and descent between test altitudes. lever, lever_per_s: range and
    fastest rate of what the pilot moves, in its channel's unit. settle_s: constant lever before
    each move, the setting of its first position included; hold_s: after it. altitudes: how many
    are considered. dT_C: static temperature off the standard day. highest: output -> value that it
    may not exceed. inputs: values of further inputs; switches left out are off. switches: those
    that the pilot may set for a move, each by itself; its move begins and ends with it.
    """

    schema_: Literal["narxcal.limits/1"] = Field(default=SCHEMA, alias="schema")
    altitude_ft: Pair
    mach: Pair
    climb_ft_min: float = Field(gt=0.0)
    lever: Pair
    lever_per_s: float = Field(gt=0.0)
    settle_s: Seconds = 30.0
    hold_s: Seconds = 15.0
    altitudes: int = Field(default=3, ge=1, le=9)
    dT_C: float = 0.0
    highest: dict[str, float] = Field(default_factory=dict)
    inputs: dict[str, float] = Field(default_factory=dict)
    switches: tuple[str, ...] = ()

    @model_validator(mode="after")
    def _ranges(self) -> Limits:
        for name in ("altitude_ft", "lever"):
            low, high = getattr(self, name)
            if not low < high and not (name == "altitude_ft" and low == high):
                raise ConfigError(f"{name}: expected a lowest and a higher value, found {low:g}, "
                                  f"{high:g}")  # fmt: skip
        if min(self.mach) < 0.0 or max(self.mach) > 1.0:
            raise ConfigError(f"mach: expected values from 0 to 1, found {list(self.mach)}")
        if both := {*self.inputs} & {*self.switches}:
            raise ConfigError(
                f"'{min(both)}' is both in switches and in [inputs]",
                hint="A switch is off until its moves; leave it out of [inputs]",
            )
        if self.way_s > self.settle_s:
            low, high = self.lever
            raise ConfigError(
                f"limits that admit no move: at {self.lever_per_s:g} per s the lever takes "
                f"{self.way_s:.3g} s from {low:g} to {high:g}, and settle_s is {self.settle_s:g} s",
                hint="Raise settle_s or lever_per_s, or narrow lever",
            )
        return self

    @property
    def way_s(self) -> float:
        return (self.lever[1] - self.lever[0]) / self.lever_per_s

    @classmethod
    def read(cls, file: Path) -> Limits:
        """Read a TOML file; raises `ConfigError` that names the key."""
        return cls.parse(read_toml(file, SCHEMA), file)

    @property
    def heights_ft(self) -> list[float]:
        low, high = self.altitude_ft
        return [low] if low == high else np.linspace(low, high, self.altitudes).tolist()

    def mach_at(self, altitude_ft: float) -> float:
        return float(np.interp(altitude_ft, self.altitude_ft, self.mach))

    def climb_min(self, low_ft: float, high_ft: float) -> float:
        return abs(high_ft - low_ft) / self.climb_ft_min


class Move(Section, extra="ignore"):
    """A lever move at one altitude: corners (s, lever) from its first position on.

    `switch` is the one that is on from before it settles to its end, empty for none.
    """

    name: str
    altitude_ft: float
    mach: float = Field(alias="Mach")
    settle_s: float = Field(ge=0.0)
    corners: tuple[Pair, ...] = Field(min_length=1)
    switch: str = ""

    @field_validator("corners")
    @classmethod
    def _in_order(cls, corners: tuple[Pair, ...]) -> tuple[Pair, ...]:
        Corners(tuple((at, lever - corners[0][1]) for at, lever in corners))
        return corners

    @property
    def duration_s(self) -> float:
        return self.corners[-1][0]

    @property
    def minutes(self) -> float:
        """Time that it takes of a flight, settling included."""
        return (self.settle_s + self.duration_s) / 60.0

    @property
    def steps(self) -> list[tuple[float, float, float]]:
        """Each movement as lever position, rate in its unit per s, and seconds held there."""
        found: list[tuple[float, float, float]] = []
        for (begin, was), (end, to) in pairwise(self.corners):
            if to != was:
                found.append((to, abs(to - was) / (end - begin), 0.0))
            elif found:
                found[-1] = (*found[-1][:2], found[-1][2] + end - begin)
            else:
                found.append((to, 0.0, end - begin))
        return found


class FlightCard(Section, extra="ignore"):
    """What is flown of a card: moves of `lever` in their order, within limits."""

    schema_: Literal["narxcal.card/1"] = Field(alias="schema")
    lever: str
    limits: Limits
    steps: tuple[Move, ...] = Field(min_length=1)

    @classmethod
    def read(cls, file: Path) -> Self:
        """Read the JSON document of `narxcal card`; raises `ConfigError`."""
        try:
            found = json.loads(file.read_bytes())
        except OSError as error:
            raise ConfigError(f"cannot be read: {error.strerror}", file=file) from None
        except (ValueError, RecursionError):
            found = None
        if not isinstance(found, dict) or found.get("schema") != CARD_SCHEMA:
            raise ConfigError(
                f"is no document of schema {CARD_SCHEMA}",
                file=file,
                hint="narxcal card writes it next to the page, with the ending .json",
            )
        return cls.parse(found, file)


def moves(limits: Limits) -> list[Move]:
    """List the candidate moves at each test altitude, without and with each switch."""
    low, high = limits.lever
    rate = min(_FULL * limits.lever_per_s / (high - low), HAND_DEG_S)
    shapes = list(_shapes(rate, limits.hold_s))
    return [
        Move(
            name=name,
            altitude_ft=height,
            Mach=limits.mach_at(height),
            settle_s=limits.settle_s,
            corners=tuple((t, low + (begin + a) * (high - low) / _FULL) for t, a in shape.points),
            switch=switch,
        )
        for height in limits.heights_ft
        for switch in ("", *limits.switches)
        for name, begin, shape in shapes
    ]


def _shapes(rate: float, hold_s: float) -> Iterator[tuple[str, float, Corners]]:
    """Name, first position and motion of each move, in percent of the lever range."""

    def then_held(by: float, speed: float) -> Corners:
        return levels([(by, abs(by) / speed + hold_s)], speed)

    for begin in np.linspace(0.0, _FULL, 5).tolist():
        yield "level", begin, hold(hold_s)
    for begin, by in _STEPS:
        yield ("step up" if by > 0.0 else "step down"), begin, then_held(by, rate)
    for begin, by in ((0.0, _FULL), (_FULL, -_FULL)):
        yield ("slam" if by > 0.0 else "chop"), begin, then_held(by, rate)
        slow = min(rate, max(0.1 * rate, _FULL / 60.0))
        yield ("slow push" if by > 0.0 else "slow pull"), begin, then_held(by, slow)
    stay = _FULL / rate + hold_s
    yield "slam and chop", 0.0, levels([(_FULL, stay), (0.0, stay)], rate)
    yield "slam and chop back", 0.0, levels([(_FULL, stay - hold_s + _PAUSE_S), (0.0, stay)], rate)
    yield "chop and slam back", _FULL, reslam(_FULL, _PAUSE_S, hold_s, rate)
    unit = max(_UNIT_S, 2.0 * _SMALL / rate)
    for begin in (25.0, 50.0, 75.0):
        yield "doublet", begin, doublet(_SMALL, unit, rate)
        yield "3-2-1-1", begin, three_two_one_one(_SMALL, unit, rate)
    yield "reversals", 50.0, reversals(_TRIANGLE, min(rate, _SMALL))
    yield "steps of three sizes", 50.0, ladder(_LADDER, _LADDER[-1] / rate + 0.5 * hold_s, rate)


def course(limits: Limits, some: Sequence[Move], dt_s: float) -> dict[str, FloatArray]:
    """Fly moves one after another: `lever`, `ALT_ft`, `Mach` and switches (time,) every `dt_s`.

    The switch of a move is set first. Then come climbs, then the lever goes to the first position
    within the first half of the time to settle.
    """
    times, points, clock = [0.0], [(some[0].corners[0][1], some[0].altitude_ft)], 0.0
    begins = []
    for one in some:
        begins.append(clock)
        was, height = points[-1]
        begin = one.corners[0][1]
        climb = 60.0 * limits.climb_min(height, one.altitude_ft)
        way = _SET * one.settle_s
        rows = [(climb, was), (climb + way, begin)]
        rows += [(climb + one.settle_s + at, lever) for at, lever in one.corners]
        times += [clock + at for at, _ in rows]
        points += [(lever, one.altitude_ft) for _, lever in rows]
        clock = times[-1]
    grid = np.arange(0.0, clock + 0.5 * dt_s, dt_s)
    lever, height = (np.interp(grid, times, column) for column in zip(*points, strict=True))
    mach = np.interp(height, limits.altitude_ft, limits.mach)
    flown = np.array([one.switch for one in some])[np.searchsorted(begins, grid, "right") - 1]
    switches = {name: (flown == name).astype(float) for name in limits.switches}
    return {"lever": lever, "ALT_ft": height, "Mach": mach, **switches}
