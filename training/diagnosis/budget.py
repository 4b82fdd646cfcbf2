r"""What a diagnosis finds: the budget of the gap's energy, and every effect with its intervals.

Energy is the mean squared gap, each channel over its range squared; 1 is the whole gap. Shares of
the causes add up to 1, by Shapley values: what a set S of causes explains is
`v(S) = |d|^2 - |d - sum_S c_i|^2`, where the component c_i is what a cause does in a flight by the
joint fit to the others (`joint`). A cause's share is the mean of what it adds over all orders in
which causes enter, for fixed components

    c_i' (2 d - sum c);    c_i' (2 d - c_i) where it enters first, and last c_i' (2 r + c_i)

with r = d - sum c. Components fitted for each set anew would let differences of build, which mimic
every effect, have a third of what an effect does. All values are plain, ready for a page, a table
or `gap.json`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any, Final, Literal

import numpy as np

from narxcal.effects.library import LIBRARY
from narxcal.support.arrays import BoolArray, FloatArray, IntArray
from training.diagnosis.metric import Record

_SET: Final = 0.8  # of a credible set
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
    where none is claimed; `edges` are the intervals of its edges per flight, in steps. `facts` are
    numbers for `quality`.
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
    edges: Sequence[Sequence[tuple[float, float]]] = ()

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


@dataclass(frozen=True, eq=False)
class Split:
    """What each cause takes, (causes, ...): on the mean of all orders, first, and last."""

    shares: FloatArray
    first: FloatArray
    last: FloatArray


def split(gap: FloatArray, components: Sequence[FloatArray]) -> Split:
    """Split the squared `gap` (...) between fixed `components` of it, sample by sample."""
    parts = np.stack(components)
    rest = gap - parts.sum(axis=0)
    return Split(parts * (gap + rest), parts * (2.0 * gap - parts), parts * (2.0 * rest + parts))


@dataclass(frozen=True, eq=False)
class Phases:
    """`names` of what moves, and the number of each sample's, (flights, time), -1 for none."""

    names: tuple[str, ...]
    index: IntArray


def gap_share(record: Record) -> float:
    """Share of the squared gap, over ranges squared, that is no noise."""
    count, scale = record.known.sum(axis=(0, 1)), 1.0 / record.span**2
    fast = count * record.fast
    energy = ((record.gap**2 * record.known).sum(axis=(0, 1)) + fast) * scale
    noise = (count * record.noise**2 + fast) * scale
    return float(max(0.0, 1.0 - noise.sum() / max(energy.sum(), 1e-300)))


def causes_of(
    record: Record,
    effects: Sequence[str],
    components: Sequence[FloatArray],
    phases: Phases,
    known: dict[str, float],
) -> tuple[Cause, ...]:
    """Rows of the budget: effects, build, offsets, noise, unexplained."""
    inside = np.eye(len(phases.names))[np.maximum(phases.index, 0)]
    inside = inside * (phases.index >= 0)[..., None]
    scale = 1.0 / record.span**2

    def cells(values: FloatArray) -> FloatArray:
        return np.asarray(np.einsum("...ftc,ftp->...cp", values * record.known * scale, inside))

    found = split(record.gap, components)
    slow, ones = cells(record.gap**2), cells(np.ones_like(record.gap))
    fast = ones * np.broadcast_to(record.fast, scale.shape)[:, None]
    noise = np.minimum(ones * record.noise[:, None] ** 2, slow) + fast
    shares = cells(found.shares)
    rest = slow + fast - shares.sum(axis=0) - noise
    total = max(float((slow + fast).sum()), 1e-300)
    rows = list(
        zip([*effects, BUILD, OFFSETS], shares, cells(found.first), cells(found.last), strict=True)
    )
    rows += [(NOISE, noise, noise, noise), (UNEXPLAINED, rest, rest, rest)]
    outputs = record.flights.signals.outputs
    return tuple(
        _cause(name, [each / total for each in three], (outputs, phases.names), known)
        for name, *three in rows
    )


def _cause(
    name: str,
    three: Sequence[FloatArray],
    names: tuple[Sequence[str], Sequence[str]],
    known: dict[str, float],
) -> Cause:
    """One row from its shares (outputs, phases): on the mean, first, and last."""
    share, ends = three[0], [float(each.sum()) for each in three]
    return Cause(
        name,
        ends[0],
        min(ends),
        max(ends),
        dict(zip(names[0], share.sum(axis=1).tolist(), strict=True)),
        dict(zip(names[1], share.sum(axis=0).tolist(), strict=True)),
        known.get(name),
        (name, *credible(known, name)) if name in known else (),
    )


def credible(known: dict[str, float], first: str) -> tuple[str, ...]:
    """The 80 % credible set of the place that `first` has, without it, likeliest first."""
    whole, total, found = sum(known.values()), known[first], []
    for name in sorted(known, key=lambda n: -known[n]):
        if total >= _SET * whole:
            break
        if name != first:
            found.append(name)
            total += known[name]
    return tuple(found)
