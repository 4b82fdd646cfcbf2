"""Which effects act, how much of the gap each takes, and what is left: from record to budget."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from scipy.special import log_softmax

from narxcal.channels import symbol
from narxcal.effects.base import unit
from narxcal.effects.library import LIBRARY, hypotheses
from narxcal.effects.running import Emulator
from narxcal.support.arrays import FloatArray
from training.diagnosis import load as unlogged
from training.diagnosis.budget import (
    Budget,
    Interval,
    Joint,
    Phases,
    Verdict,
    Weighed,
    by_others,
    causes_of,
    credible,
    gap_share,
    interval,
    together,
)
from training.diagnosis.dictionary import Dictionary
from training.diagnosis.discrepancy import Discrepancy
from training.diagnosis.fit import Frame, Single, no_columns, solve
from training.diagnosis.layers import (
    Layer,
    Odds,
    Setting,
    alike,
    features,
    further,
    stored_odds,
)
from training.diagnosis.metric import TOLERANCE, Metric, Record, assumed_variance
from training.diagnosis.nuisances import BUILD, nuisances
from training.diagnosis.remainder import largest_left

_SURE: Final = 0.5  # probability below which the first effect is not named alone
_SHORT_S: Final = 600.0  # twice what one unit of a flight is at least
_NOTHING: Final = 0.03  # of the noise's energy: less is no gap
_NAMEABLE: Final = 8.0**0.5  # standard errors of a size that could be named
_NOT_KNOWN: Final = "something acts that no effect of the library explains"


@dataclass(frozen=True, eq=False)
class Evidence:
    """Everything that probabilities are made of: single fits, layers, and their features."""

    frame: Frame
    singles: tuple[Single, ...]
    effects: FloatArray
    case: FloatArray
    setting: Setting

    @property
    def energy(self) -> float:
        """Energy of the gap beside nuisances."""
        return self.frame.energy(self.frame.none)


class NullModel(NamedTuple):
    """What flights and simulator differ by where no effect acts: learned, or assumed.

    `build` is how much of what engines of one type differ by is assumed: 0 for this very engine.
    """

    learned: Discrepancy | None = None
    build: float = 1.0


ASSUMED: Final = NullModel()


class Engines(NamedTuple):
    """What answers for the simulator: an emulator, and itself where it can be run again."""

    emulator: Emulator | None
    itself: Emulator | None = None


def weigh(
    record: Record,
    engines: Engines,
    differences: NullModel = ASSUMED,
    odds: Odds | None = None,
) -> Evidence:
    """Fit every effect by itself, with what builds and flights differ by, or what was learned."""
    learned = differences.learned
    flights = record.flights
    dictionary = Dictionary(hypotheses(flights.signals), flights, *engines)
    if learned is None:
        noise, variance = (
            nuisances(record, engines.emulator, differences.build),
            assumed_variance(record),
        )
    else:
        noise, variance = learned.nuisances(record), learned.variance(record)
    metric = Metric(record, variance)
    frame = Frame(record, metric, record.gap, noise, assumed=learned is None)
    with ThreadPoolExecutor(dictionary.threads) as pool:
        nodes = dictionary.nodes.values()
        fits = pool.map(lambda some: frame.refined(frame.fit(some), dictionary), nodes)
    singles = [*fits, *unlogged.found(frame)]
    setting = Setting(record, variance, noise, dictionary, odds or stored_odds(), learned)
    return Evidence(frame, tuple(singles), *features(frame, singles), setting)


def concluded(
    evidence: Evidence, phases: Phases, doubts: Sequence[str] = (), refused: str = ""
) -> Budget:
    """Say which effects act in recorded flights, and what share of the gap each cause takes.

    With `doubts` of the logs it is undetermined, and they are its reason. Effects that were named
    before are `refused` with a reason.
    """
    frame, record = evidence.frame, evidence.setting.record
    if evidence.setting.learned is None:
        left = largest_left(frame, phases)
        weighed = _assumed(evidence, left, claims=not (doubts or refused))
    else:
        left, weighed = "", _learned(evidence)
    if refused:
        weighed = weighed._replace(layers=[])
    known, layers = weighed.known, weighed.layers
    verdict = _named(weighed) if layers else _unnamed(weighed, evidence, left, refused)
    if doubts:
        verdict, layers = Verdict("unknown", (), (), "; ".join(doubts)), []
    elif _too_short(record) and verdict.effects:
        verdict, layers = _undetermined(verdict), []
    joint = together(frame, [one.single for one in layers])
    # A load may be found only as a further effect: then no single fit of it is there.
    alone = {one.name for one in evidence.singles}
    second = [one for one in layers if one.name not in alone]
    singles = [*evidence.singles, *(frame.fit([one.single.node]) for one in second)]
    on = [one.single for one in layers if one.single.node.on is not None]
    return Budget(
        verdict,
        causes_of(record, {o.name: o.alike for o in layers}, joint.components(), phases, known),
        _weighed(evidence, singles, joint, known),
        weighed.none,
        weighed.unknown,
        gap_share(record),
        by_others(joint),
        next((one.node.on for one in on), None),
        next((unlogged.edges(frame, one) for one in on), []),
    )


class _Answers(NamedTuple):
    """Probabilities of effects, of none and unknown; the layers, and the one that came next."""

    known: dict[str, float]
    none: float
    unknown: float
    layers: list[Layer]
    more: Layer | None


def _assumed(evidence: Evidence, left: str, *, claims: bool) -> _Answers:
    """Probabilities by the logit; layers on the likeliest effect.

    What is within what builds differ by in the same way is no effect. No layers without `claims`,
    or where none and unknown together are likelier than it and those alike to it. Of this very
    engine only noise is left where nothing acts.
    """
    names, setting = [one.name for one in evidence.singles], evidence.setting
    chances = setting.odds.first(names, evidence.effects, evidence.case)
    of_build = [evidence.frame.within_build(one) for one in evidence.singles]
    chances = log_softmax(np.where([*of_build, False, False], -np.inf, chances))
    if evidence.energy < _NOTHING * evidence.frame.floor:
        chances = np.full_like(chances, -np.inf)
        chances[-2] = 0.0
    elif left and not evidence.frame.nuisances.of_build:
        chances[-2] = -np.inf
        chances = log_softmax(chances)
    known = dict(zip(names, np.exp(chances[:-2]).tolist(), strict=True))
    none, unknown = np.exp(chances[-2:]).tolist()
    if sum(known.values()) <= none + unknown or not claims:
        return _Answers(known, none, unknown, [], None)
    best = evidence.singles[int(np.argmax(chances[:-2]))]
    same = alike(evidence.frame, best, evidence.singles, setting.dictionary)
    one_of = [best.name, *same]
    leading = sum(known[name] for name in one_of)
    if leading <= none + unknown:
        return _Answers(known, none, unknown, [], None)
    known |= {name: known[name] / leading * setting.odds.sure(leading) for name in one_of}
    first = Layer(best, (), float(chances[-2]), 0.0, same)
    layers, more = further(setting, first, evidence.energy)
    for place in layers:
        found = dict(place.chances)
        for name in (place.name, *place.alike) if found else ():
            known[name] = max(known.get(name, 0.0), float(np.exp(found[name])))
    return _Answers(known, none, unknown, layers, more)


def _learned(evidence: Evidence) -> _Answers:
    """Layers by evidence; an effect's probability is that of its place, against none."""
    layers, more = further(evidence.setting, None, evidence.energy)
    known = {one.name: 0.0 for one in evidence.singles}
    none = 0.0
    for place in (*layers, *(() if more is None else (more,))):
        none += place.none
        for name, chance in place.chances:
            known[name] = max(known.get(name, 0.0), float(np.exp(chance)))
    return _Answers(known, float(np.exp(none)), 0.0, layers, more)


def _too_short(record: Record) -> bool:
    """Whether it is one flight that gives no two parts that could confirm each other."""
    seconds = float((record.unit >= 0).sum()) * record.flights.signals.dt_s
    return len(record.real) == 1 and seconds < _SHORT_S


def _undetermined(verdict: Verdict) -> Verdict:
    """No firm answer, with the best candidate."""
    reason = (
        f"one flight of less than {_SHORT_S / 60.0:g} minutes is no evidence, an effect has to act "
        f"in others too; the best candidate is {' and '.join(verdict.effects)}"
    )
    return Verdict("unknown", (), (), reason, verdict.separating_manoeuvre)


def _within_build(frame: Frame) -> str:
    """Steady shifts that differences of build account for, and how they would be read else."""
    noise, record = frame.nuisances, frame.record
    of_build = np.array([kind == BUILD for kind in noise.kind])
    if frame.none.nu[of_build].any():
        shift = np.tensordot(frame.none.nu[of_build], noise.columns[of_build], axes=1)
        means = np.mean(shift, axis=(0, 1), where=record.known)
        parts = [
            f"{symbol(name)} {mean:+.2g} {unit(name)}"
            for name, mean, span in zip(
                record.flights.signals.outputs, means, record.span, strict=True
            )
            if abs(mean) > TOLERANCE * span
        ]
        if parts:
            return (
                f"; a steady shift of {', '.join(parts)} is within what builds of one type differ "
                "by: with --build same it would be read as deterioration, a bleed or a sensor"
            )
    return ""


def _named(found: _Answers) -> Verdict:
    """What the layers name, each with what is alike to it.

    The credible set where the first is not likelier than the others.
    """
    effects = tuple(one.name for one in found.layers)
    others = dict.fromkeys(name for one in found.layers for name in one.alike)
    first = found.layers[0]
    if sum(found.known[name] for name in (first.name, *first.alike)) < _SURE:
        others |= dict.fromkeys(credible(found.known, first.name))
    rest = tuple(name for name in others if name not in effects)
    reason = "these flights do not tell the effects apart" if rest else ""
    manoeuvre = LIBRARY[effects[0].partition(":")[0]].manoeuvre
    return Verdict("ambiguous" if rest else "effects", effects, rest, reason, manoeuvre)


def _unnamed(found: _Answers, evidence: Evidence, left: str, refused: str) -> Verdict:
    """Nothing acts where no other answer is likelier and nothing left is beyond noise and build."""
    best = max(found.known, key=lambda name: found.known[name])
    likelier = found.known[best] > max(found.none, found.unknown)
    if not (left or likelier) and found.none >= found.unknown:
        what = "what this simulator gets wrong by itself"
        if evidence.setting.learned is None:
            what = f"what builds and flights differ by{_within_build(evidence.frame)}"
        reason = "; ".join(filter(None, (f"nothing acts beyond {what}", refused)))
        return Verdict("none", (), (), reason)
    reasons = [refused or (_open(best, found) if likelier else "")]
    reasons.append(f"not in the library: {left}" if left else "")
    reason = "; ".join(filter(None, reasons)) or _NOT_KNOWN
    return Verdict("unknown", (), (), reason)


def _open(best: str, found: _Answers) -> str:
    """Why there is no firm answer where an effect leads, but is not likelier than all without."""
    return (
        f"the best candidate is {best} ({100.0 * found.known[best]:.0f} %), which is not likelier "
        f"than that nothing acts ({100.0 * found.none:.0f} %) or something that the library lacks "
        f"({100.0 * found.unknown:.0f} %)"
    )


def _weighed(
    evidence: Evidence, singles: Sequence[Single], joint: Joint, known: dict[str, float]
) -> tuple[Weighed, ...]:
    """Every effect; claimed ones by their joint fit, the others by their own."""
    claimed = {node.name: k for k, node in enumerate(joint.nodes)}
    rows = [_one(evidence, single, joint, claimed, known[single.name]) for single in singles]
    names = tuple(claimed)
    place = {name: k for k, name in enumerate(names)}
    return tuple(sorted(rows, key=lambda row: (place.get(row.name, len(names)), -row.probability)))


def _one(
    evidence: Evidence, single: Single, joint: Joint, claimed: dict[str, int], chance: float
) -> Weighed:
    frame, grams = evidence.frame, evidence.frame.grams
    before, name = frame.none.rss, single.name
    units = len(before)
    noise = grams.floor
    held = [solve(grams, single.columns, u).rss[u] for u in range(units)] if units > 1 else []
    none = [solve(grams, no_columns(grams), u).rss[u] for u in range(units)] if units > 1 else []
    flights = tuple(
        float((n - h) / max(n - f, 1e-9)) for n, h, f in zip(none, held, noise, strict=False)
    )
    gain = 1.0 - frame.energy(single.solved) / evidence.energy
    if name in claimed:
        k = claimed[name]
        node, theta, spread = joint.nodes[k], joint.theta[k], joint.spread[k]
        freedom = joint.freedom[k]
    else:
        node, theta = single.node, single.theta
        spread, freedom = np.zeros(len(theta)), np.full(len(theta), np.inf)
        spread[list(node.free)] = np.sqrt(np.maximum(np.diag(single.solved.covariance), 0.0))
    acting = [j for j, p in enumerate(node.parameters) if j in node.free or theta[j] != p.neutral]
    parameters = {
        p.name: Interval(*interval(float(theta[j]), float(spread[j]), p.low, p.high, freedom[j]))
        for j, p in ((j, node.parameters[j]) for j in acting)
    }
    return Weighed(
        name,
        chance,
        parameters,
        {p.name: p.unit for p in node.parameters},
        float(gain),
        flights,
        None if name in claimed else _NAMEABLE * float(spread[acting[0]]),
        tuple(
            f"{name}.{p.name}"
            for p, v in zip(node.parameters, theta, strict=True)
            if v in (p.low, p.high) and v != p.neutral
        ),
        tuple(other for other in claimed if other != name) if name in claimed else (),
    )
