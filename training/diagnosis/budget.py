r"""What a diagnosis finds: effects fitted together, and the budget of the gap's energy.

Energy is the mean squared gap, each channel over its range squared; 1 is the whole gap. Shares of
the causes add up to 1, by Shapley values: what a set S of causes explains is
`v(S) = |d|^2 - |d - sum_S c_i|^2`, where the component c_i is what a cause does in a flight by the
joint fit to the others (`Joint`). A cause's share is the mean of what it adds over all orders in
which causes enter, for fixed components

    c_i' (2 d - sum c);    c_i' (2 d - c_i) where it enters first, and last c_i' (2 r + c_i)

with r = d - sum c. Components fitted for each set anew would let differences of build, which mimic
every effect, have a third of what an effect does. All values are plain, ready for a page, a table
or `gap.json`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any, Final, Literal

import numpy as np
from scipy import stats

from narxcal.effects.library import LIBRARY
from narxcal.support.arrays import BoolArray, FloatArray, IntArray
from training.diagnosis.dictionary import Node
from training.diagnosis.fit import Columns, Frame, Single, Solved, no_columns, solve
from training.diagnosis.metric import Record, assumed_variance
from training.diagnosis.nuisances import BUILD, OFFSET, SMALL, START

_LEVEL: Final = 0.95  # of Student's distribution: a 90 % interval


@dataclass(frozen=True, eq=False)
class Joint:
    """Effects fitted together: one node each, and the steps from it.

    `theta` and `spread` hold parameters and their standard deviations per effect, `freedom` the
    degrees of freedom that those were estimated with; `left_out` (units,) are the fits without each
    unit, and `others` the parameters found there; nothing of a single unit.
    """

    nodes: tuple[Node, ...]
    frame: Frame
    solved: Solved
    left_out: tuple[Solved, ...]
    theta: tuple[FloatArray, ...]
    spread: tuple[FloatArray, ...]
    freedom: tuple[FloatArray, ...]
    others: tuple[tuple[FloatArray, ...], ...]

    def components(self) -> list[FloatArray]:
        """What each effect does, what the differences of build do, and what the offsets do.

        In each unit by the fit to the others; of a single unit by its own.
        """
        if not self.left_out:
            return [*self.responses(self.solved.x), *of_nuisances(self.frame, self.solved.nu)]
        found = [np.zeros_like(self.frame.gap) for _ in range(len(self.nodes) + 2)]
        for u, solved in enumerate(self.left_out):
            here = self.frame.record.unit == u
            *others, offsets = *self.responses(solved.x), *of_nuisances(self.frame, solved.nu)
            own = self._own_offsets(here, solved, sum(others, np.zeros_like(offsets)))
            for into, part in zip(found, [*others, offsets + own], strict=True):
                into[here] = part[here]
        return found

    def _own_offsets(self, here: BoolArray, solved: Solved, others: FloatArray) -> FloatArray:
        """Offsets of a flight that is left out as a whole, which the others can't know.

        Those of each half are estimated in the other one; how hot it started is its own.
        """
        record, noise = self.frame.record, self.frame.nuisances
        found = np.zeros_like(self.frame.gap)
        (f, *more) = np.flatnonzero(here.any(axis=1))
        if more or (record.unit[f] >= 0).sum() > here[f].sum():
            return found
        acts = noise.columns[:, f].any(axis=(1, 2))
        start, offset = (acts & (np.array(noise.kind) == kind) for kind in (START, OFFSET))
        found[f] = np.tensordot(self.solved.nu[start], noise.columns[start, f], axes=1)
        rest, columns = self.frame.gap[f] - others[f] - found[f], noise.columns[offset, f]
        weight = record.known[f] / assumed_variance(record)[0][f]
        halves = np.array_split(np.flatnonzero(here[f]), 2)
        for seen, scored in (halves, halves[::-1]):
            part = columns[:, seen]
            inner = np.einsum("ktc,tc,ltc->kl", part, weight[seen], part)
            toward = np.einsum("ktc,tc,tc->k", part, weight[seen], rest[seen])
            nu = np.linalg.solve(inner + solved.tau * np.eye(len(inner)), toward)
            limit = noise.limit[offset]
            found[f, scored] += np.tensordot(np.clip(nu, -limit, limit), columns[:, scored], axes=1)
        return found

    def responses(self, steps: FloatArray) -> list[FloatArray]:
        """What each effect does after the steps of all."""
        return [n.response(x) for n, x in zip(self.nodes, self.parts(steps), strict=True)]

    def parts(self, x: FloatArray) -> list[FloatArray]:
        """The step of each effect out of that of all."""
        ends = np.cumsum([len(n.free) for n in self.nodes])
        return list(np.split(x, ends)[:-1])


def of_nuisances(frame: Frame, nu: FloatArray) -> list[FloatArray]:
    """What nuisances of sizes `nu` do: the differences of build, and the offsets of flights."""
    noise, kinds = frame.nuisances, np.array(frame.nuisances.kind)
    groups = [np.isin(kinds, group) for group in ((BUILD, SMALL), (OFFSET, START))]
    return [np.tensordot(nu[here], noise.columns[here], axes=1) for here in groups]


def _columns(frame: Frame, nodes: Sequence[Node]) -> Columns:
    """Columns of all nodes together: the sum of their responses, and their slopes."""
    if not nodes:
        return no_columns(frame.grams)
    rr, rn, rd = frame.inner(np.concatenate([node.rows for node in nodes]))
    first = np.cumsum([0, *(len(node.rows) for node in nodes)])[:-1]
    slopes = np.setdiff1d(np.arange(rr.shape[1]), first)
    mix = np.zeros((1 + len(slopes), rr.shape[1]))
    mix[0, first] = 1.0
    mix[np.arange(1, len(mix)), slopes] = 1.0
    names = {node.name for node in nodes}
    absent = np.array([name in names for name in frame.nuisances.effect])
    box = np.concatenate([node.box for node in nodes])
    return Columns(mix @ rr @ mix.T, mix @ rn, rd @ mix.T, box, absent)


def together(frame: Frame, singles: Sequence[Single]) -> Joint:
    """Fit the effects of `singles` together, from their nodes."""
    nodes = tuple(one.node for one in singles)
    columns = _columns(frame, nodes)
    found = solve(frame.grams, columns)
    units = len(frame.grams.dd)
    left_out = [solve(frame.grams, columns, u) for u in range(units)] if units > 1 else []
    steps = np.array([one.x for one in left_out]).reshape(len(left_out), len(found.x))
    within = np.maximum(np.diag(found.covariance), 0.0)
    between = np.zeros(len(within))
    if len(steps):
        between = (units - 1) / units * ((steps - steps.mean(axis=0)) ** 2).sum(axis=0)
    joint = Joint(nodes, frame, found, tuple(left_out), (), (), (), ())
    freedom = _freedom((within, frame.grams.independent), (between, units - 1))
    theta = _thetas(joint, found.x)
    others = tuple(_thetas(joint, x) for x in steps)
    spread = _of_parameters(joint, np.sqrt(within + between), 0.0)
    return replace(
        joint,
        theta=theta,
        spread=spread,
        freedom=_of_parameters(joint, freedom, np.inf),
        others=others,
    )


def _freedom(*parts: tuple[FloatArray, float]) -> FloatArray:
    """Degrees of freedom of a sum of variances, each with its own (Welch 1947, Satterthwaite)."""
    whole = np.sum([variance for variance, _ in parts], axis=0)
    price = np.sum([variance**2 / max(own, 1.0) for variance, own in parts], axis=0)
    none = np.full_like(whole, np.inf)
    return np.asarray(np.divide(whole**2, price, out=none, where=price > 0.0))


def _of_parameters(joint: Joint, steps: FloatArray, fixed: float) -> tuple[FloatArray, ...]:
    """Values of the steps of all effects as ones of their parameters, `fixed` of the others."""
    found = tuple(np.full(len(node.theta), fixed) for node in joint.nodes)
    for node, into, part in zip(joint.nodes, found, joint.parts(steps), strict=True):
        into[list(node.free)] = part
    return found


def _thetas(joint: Joint, x: FloatArray) -> tuple[FloatArray, ...]:
    return tuple(n.at(part) for n, part in zip(joint.nodes, joint.parts(x), strict=True))


def by_others(joint: Joint) -> FloatArray | None:
    """What the effects do in each unit by the others' parameters, less by those of all."""
    if not joint.others or not joint.nodes:
        return None
    record = joint.frame.record
    change = np.zeros_like(record.gap)
    mine = np.sum(joint.responses(joint.solved.x), axis=0)
    for u, thetas in enumerate(joint.others):
        pairs = zip(joint.nodes, thetas, strict=True)
        steps = np.concatenate([(t - n.theta)[list(n.free)] for n, t in pairs])
        theirs = np.sum(joint.responses(steps), axis=0)
        here = record.unit == u
        change[here] = (theirs - mine)[here]
    return change


def interval(
    value: float, spread: float, low: float, high: float, freedom: float = np.inf
) -> tuple[float, float, float]:
    """A value with its 90 % interval, by Student's distribution, within bounds."""
    reach = float(stats.t.ppf(_LEVEL, freedom)) * spread
    return value, max(low, value - reach), min(high, value + reach)


_SET: Final = 0.8  # of a credible set
Kind = Literal["none", "effects", "ambiguous", "unknown"]
OFFSETS, NOISE, UNEXPLAINED = "offsets", "noise", "unexplained"


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
    and `phases` divide the share; each is of the whole gap as well. An effect has the `probability`
    that it acts, and a `credible_set`: itself, and what these flights do not tell from it.
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
    where none is claimed; `edges` are the intervals of its edges per flight, in steps.
    """

    verdict: Verdict
    causes: tuple[Cause, ...]
    effects: tuple[Weighed, ...]
    none: float
    unknown: float
    gap_share: float
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
        return found | {"none": self.none, "unknown": self.unknown}


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
        "credible_set": [],
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
    effects: Mapping[str, tuple[str, ...]],
    components: Sequence[FloatArray],
    phases: Phases,
    known: dict[str, float],
) -> tuple[Cause, ...]:
    """Rows of the budget: `effects`, what is alike to each, build, offsets, noise, unexplained."""
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
        replace(
            _cause(name, [each / total for each in three], (outputs, phases.names)),
            probability=known.get(name),
            credible_set=(name, *effects[name]) if name in effects else (),
        )
        for name, *three in rows
    )


def _cause(
    name: str,
    three: Sequence[FloatArray],
    names: tuple[Sequence[str], Sequence[str]],
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
