"""What a diagnosis finds: the budget of the gap's energy, and every effect with its intervals.

Energy is the mean squared gap, each channel over its range squared; 1 is the whole gap. Shares of
the causes add up to 1. All values are plain, ready for a page, a table or `gap.json`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any, Literal

from narxcal.effects.library import LIBRARY
from narxcal.support.arrays import BoolArray, FloatArray

Kind = Literal["none", "effects", "ambiguous", "unknown"]
BUILD, OFFSETS, NOISE, UNEXPLAINED = "build", "offsets", "noise", "unexplained"


@dataclass(frozen=True)
class Interval:
    """A value with the ends of its 90 % interval."""

    value: float
    low: float
    high: float


@dataclass(frozen=True)
class Cause:
    """One row of the budget.

    `cause` is an effect's name, `build`, `offsets`, `noise` or `unexplained`. `share` is of the
    whole gap, `low` and `high` are the shares with effects first and with build first. `channels`
    and `phases` divide the share; each is of the whole gap as well. `probability` that the effect
    acts and its 80 % `credible_set` are those of effects alone.
    """

    cause: str
    share: float
    low: float
    high: float
    channels: Mapping[str, float]
    phases: Mapping[str, float]
    probability: float | None = None
    credible_set: tuple[str, ...] = ()


@dataclass(frozen=True)
class Weighed:
    """One effect of the library, claimed or not.

    `probability` is that it acts. `parameters` maps a name to value and 90 % interval, `units`
    likewise. `gain` is the share of the squared gap, beyond noise, that it takes by itself;
    `flights` the same for each flight by the parameters of the others. `nameable` is the smallest
    size of its first parameter that these flights could name, None where the effect is claimed.
    `with_effects` are the others of the layers it was fitted beside.
    """

    name: str
    probability: float
    parameters: Mapping[str, Interval]
    units: Mapping[str, str]
    gain: float
    flights: tuple[float, ...]
    nameable: float | None = None
    credible_set: tuple[str, ...] = ()
    at_bound: tuple[str, ...] = ()
    with_effects: tuple[str, ...] = ()


@dataclass(frozen=True)
class Verdict:
    """The answer in words: which kind, which effects, what else it may be, and why."""

    kind: Kind
    effects: tuple[str, ...]
    ambiguous_with: tuple[str, ...]
    reason: str
    separating_manoeuvre: str = ""


@dataclass(frozen=True, eq=False)
class Budget:
    """The whole diagnosis of one set of flights.

    `causes` are the rows of the budget, effects first, largest first; `effects` every effect of
    the library that was tried, by probability. `none` and `unknown` are the probabilities that
    nothing acts and that something acts that the library lacks. `by_others` (flights, time,
    outputs) is what the claim does in each flight by the parameters of the other flights, less
    what it does by those of all. `on` (flights, time) says when an unlogged load was on, None
    where none is claimed. `facts` are numbers for `quality`.
    """

    verdict: Verdict
    causes: tuple[Cause, ...]
    effects: tuple[Weighed, ...]
    none: float
    unknown: float
    gap_share: float
    facts: Mapping[str, Any] = field(default_factory=dict)
    by_others: FloatArray | None = field(default=None, repr=False)
    on: BoolArray | None = field(default=None, repr=False)

    @property
    def claimed(self) -> dict[str, dict[str, float]]:
        """Effects that the verdict names: name -> parameter -> value."""
        known = {one.name: one for one in self.effects}
        return {
            name: {key: found.value for key, found in known[name].parameters.items()}
            for name in self.verdict.effects
        }

    def rows(self) -> list[dict[str, Any]]:
        """`budget` of `gap.json`: one row per cause."""
        return [cause_row(one) for one in self.causes]

    def effect_rows(self) -> list[dict[str, Any]]:
        """`effects` of `gap.json`: one row per effect that was tried."""
        return [_effect_row(one) for one in self.effects]

    def verdict_row(self) -> dict[str, Any]:
        """`verdict` of `gap.json`."""
        found = asdict(self.verdict)
        found["effects"] = list(self.verdict.effects)
        found["ambiguous_with"] = list(self.verdict.ambiguous_with)
        return found | {"besides": "", "none": self.none, "unknown": self.unknown}


def cause_row(one: Cause) -> dict[str, Any]:
    """One row of `budget` of `gap.json`."""
    return asdict(one) | {"credible_set": list(one.credible_set)}


def _effect_row(one: Weighed) -> dict[str, Any]:
    kind, _, channel = one.name.partition(":")
    found = LIBRARY[kind]
    row: dict[str, Any] = {"id": kind} | ({"channel": channel} if channel else {})
    flights = [min(1.0, max(-1.0, gain)) for gain in (one.gain, *one.flights)]
    return row | {
        "family": found.family,
        "side": found.side,
        "meaning": found.meaning,
        "probability": one.probability,
        "parameters": {
            key: {**asdict(value), "unit": one.units[key]} for key, value in one.parameters.items()
        },
        "gain": {"value": flights[0], "low": min(flights), "high": max(flights)},
        "nameable": one.nameable,
        "credible_set": list(one.credible_set),
        "at_bound": list(one.at_bound),
        "with": list(one.with_effects),
    }
