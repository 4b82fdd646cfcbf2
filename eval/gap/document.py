"""`gap.json`: the diagnosis as a document of schema narxcal.gap/1."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from eval.gap.claimed import claimed, is_offset, of_offsets, offset_leads
from eval.gap.evidence import Evidence, HeldOut
from eval.gap.rivals import contested
from eval.gap.side import Sides
from eval.gap.where import Row, Where
from narxcal.effects.library import LIBRARY, effect
from narxcal.effects.steady import UnloggedSwitch
from training.budget.result import Interval
from training.gap.finding import ChannelShrink, Finding, Tried

HIDDEN = UnloggedSwitch.id
SCHEMA = "narxcal.gap/1"
# Blind cases (docs/blind.md) say how far a claim can be relied on. Over four seeds firm ones were
# right 65 times in 67, the first of two rivals 44 times in 52, the first of more 9 times in 12; and
# where the weights of the models put it far ahead of its one rival, 19 times in 19. So a weight of
# 0 to 1 is a probability from here to there.
_FIRM, _DOUBTED, _ONE_OF_MANY = (0.80, 0.98), (0.52, 0.96), (0.50, 0.90)
_BESIDE = 0.75  # of it: further effects were right 32 times in 49, the first 118 times in 131
_LEFT = {"none": 0.02, "unknown": 0.3}  # of the probability, for what was not claimed
_LEADING = 0.9  # of it, for the leading one of offsets and what moves
_DOMINANT = 0.6  # of a bin's energy in one level: the level that stands for the bin


def document(evidence: Evidence) -> dict[str, Any]:
    """Put everything into plain values; numbers that are not finite are left to the writer."""
    finding, where = evidence.finding, evidence.where
    return {
        "schema": SCHEMA,
        "verdict": _verdict(finding),
        "effects": _with_windows(effect_rows(finding), evidence),
        "where": [_bin(row) for row in where.rows],
        "side": _side(finding, where)._asdict(),
        "theil": {name: split._asdict() for name, split in where.theil.items()},
        "shrink": _shrink(evidence),
        "emulator": {
            "used": bool(finding.emulator_rmse),
            "rmse": dict(finding.emulator_rmse),
            "rmse_heldout": dict(evidence.held_out.emulator_rmse) if evidence.held_out else {},
        },
        "quality": {**evidence.facts, **_measured(finding, where)},
        "tried": [_model(one) for one in finding.tried],
    }


def _verdict(finding: Finding) -> dict[str, Any]:
    return {
        "kind": finding.kind,
        "effects": list(finding.effects),
        "ambiguous_with": list(finding.ambiguous_with),
        "reason": finding.reason,
        "separating_manoeuvre": _separating(finding),
    }


def _separating(finding: Finding) -> str:
    """What to fly; of two claimed effects for the one that rivals would take the place of."""
    models = [one.effects for one in finding.tried]
    doubted = contested(finding.effects, finding.ambiguous_with, models)
    if len(finding.effects) < 2 or not doubted:
        return finding.separating_manoeuvre
    return effect(doubted[0]).manoeuvre


def effect_rows(finding: Finding) -> list[dict[str, Any]]:
    """Every effect that was tried, claimed ones first, then by probability.

    Its parameters and gain are those of the claimed model where it is in that, else its own.
    """
    models: dict[str, Tried] = {}
    alone = [one for one in finding.tried if len(one.effects) == 1]
    for one in (*_claimed_models(finding), *alone, *finding.tried):
        for name in one.effects:
            models.setdefault(name, one)
    chances = probabilities(finding)
    first = list(claimed(finding))
    others = sorted((n for n in models if n not in first), key=lambda n: -chances[n])
    return [_effect(name, models[name], chances[name]) for name in (*first, *others)]


def _with_windows(rows: list[dict[str, Any]], evidence: Evidence) -> list[dict[str, Any]]:
    """The rows, an unlogged load's with the windows in which it was on."""
    windows = [each.row() for each in evidence.windows]
    return [{**row, "windows": windows} if row["id"] == HIDDEN else row for row in rows]


def _claimed_models(finding: Finding) -> list[Tried]:
    """For each claimed effect the first model with it."""
    names = claimed(finding)
    return [next(one for one in finding.tried if name in one.effects) for name in names]


def probabilities(finding: Finding) -> dict[str, float]:
    """Probability of every effect that was tried.

    Among models with as many effects as the claimed one has (further effects have not earned
    their place), those with the effect in them; offsets and what moves are judged apart. A verdict
    without an effect leaves them only a small part, one that is firm at least 0.80.
    """
    left = _LEFT.get(finding.kind, 1.0)
    found: dict[str, float] = {}
    for group in (True, False):
        models = [one for one in finding.tried if of_offsets(one) == group]
        size = len([name for name in finding.effects if is_offset(name) == group])
        same = [one for one in models if len(one.effects) == max(size, 1)]
        whole = sum(one.probability for one in same) or 1.0
        part = left * _part(finding, offsets=group)
        for one in models:
            for name in one.effects:
                chance = part * one.probability / whole if one in same else 0.0
                found[name] = min(1.0, found.get(name, 0.0) + chance)
    return _relied_on(found, finding)


def _relied_on(found: dict[str, float], finding: Finding) -> dict[str, float]:
    """Probabilities as claims of their kind have been worth; the others share the rest."""
    if not finding.effects:
        return found
    low, high = _FIRM if finding.kind == "effects" else _DOUBTED
    if len(finding.ambiguous_with) > 1:
        low, high = _ONE_OF_MANY
    sure = {name: low + (high - low) * min(found[name], 1.0) for name in finding.effects}
    sure |= {name: _BESIDE * sure[name] for name in finding.effects[1:]}
    rest = 1.0 - min(sure.values())
    return {**{n: min(p, rest) for n, p in found.items() if n not in sure}, **sure}


def _part(finding: Finding, *, offsets: bool) -> float:
    """How much of the probability goes to offsets, or to what moves, where neither is claimed."""
    if finding.effects or not any(map(of_offsets, finding.tried)):
        return 1.0
    return _LEADING if offsets == offset_leads(finding) else 1.0 - _LEADING


def _effect(name: str, model: Tried, probability: float) -> dict[str, Any]:
    found = effect(name)
    row: dict[str, Any] = {"id": found.id}
    if found.channel is not None:
        row["channel"] = found.channel
    units = model.units.get(name, {})
    return {
        **row,
        "family": found.family,
        "side": found.side,
        "meaning": found.meaning,
        "probability": probability,
        "parameters": {
            key: {**asdict(value), "unit": units.get(key, "-")}
            for key, value in model.parameters[name].items()
        },
        "gain": _gain(model),
        "at_bound": [each for each in model.at_bound if each.startswith(name)],
        "with": [other for other in model.effects if other != name],
    }


def _gain(model: Tried) -> dict[str, float]:
    """Share of the gap that a model takes away, with its least and most over flights.

    No share is beyond all or the same again: where there is no gap, there is no sense in more.
    """
    found = [min(1.0, max(-1.0, gain)) for gain in (model.gain, *model.flights)]
    return {"value": found[0], "low": min(found), "high": max(found)}


def _side(finding: Finding, where: Where) -> Sides:
    if not claimed(finding):
        return where.side
    chances = probabilities(finding)
    votes = dict.fromkeys(Sides._fields, 0.0)
    for name, chance in chances.items():
        votes[LIBRARY[name.partition(":")[0]].side] += chance
    whole = max(sum(votes.values()), 1e-9)
    return Sides(**{side: vote / whole for side, vote in votes.items()})


def _bin(row: Row) -> dict[str, Any]:
    return {
        "channel": row.channel,
        "direction": row.direction,
        "phase": row.phase,
        "regime": {name: _dominant(levels) for name, levels in row.regimes.items()},
        **_ends("share", row.share),
        "core": row.core,
        "regime_shares": {name: dict(levels) for name, levels in row.regimes.items()},
        "explained": row.explained,
    }


def _ends(name: str, found: Interval) -> dict[str, float]:
    return {name: found.value, "low": found.low, "high": found.high}


def _dominant(levels: Mapping[str, float]) -> str:
    level = max(levels, key=lambda name: levels[name])
    return level if levels[level] >= _DOMINANT else "all"


def _shrink(evidence: Evidence) -> dict[str, Any]:
    held = evidence.held_out
    channels = evidence.channels if held is None else held.channels
    return {
        "predicted": _within_all(evidence.predicted),
        "realised": None if held is None else held.share,
        "channels": {name: asdict(found) for name, found in channels.items()},
        "shares": {name: _taken(found) for name, found in channels.items()},
        "times": {name: asdict(found) for name, found in evidence.times.items()},
        "predicted_beside_scatter": _within_all(evidence.finding.predicted),
        "on": "the flights of the diagnosis" if held is None else _flown(held),
    }


def _within_all(found: Interval) -> dict[str, float]:
    """A share from all to as much again; ends that one flight cannot know are as far as can be."""
    value = _clipped(found.value, 0.0)
    low, high = _clipped(found.low, -1.0), _clipped(found.high, 1.0)
    return {"value": value, "low": min(low, value), "high": max(high, value)}


def _clipped(share: float, unknown: float) -> float:
    return min(1.0, max(-1.0, share)) if math.isfinite(share) else unknown


def _taken(found: ChannelShrink) -> float:
    """Share of one channel's mean squared gap that is taken off."""
    return 1.0 - (found.after / found.before) ** 2 if found.before > 0.0 else 0.0


def _flown(held: HeldOut) -> str:
    count = len(held.data.names)
    return f"{count} flight{'' if count == 1 else 's'} that took no part"


def _measured(finding: Finding, where: Where) -> dict[str, Any]:
    return {
        "gap_share": finding.gap_share,
        "left_share": finding.left_share,
        "notes": list(finding.notes),
        "channels": {name: asdict(found) for name, found in where.channels.items()},
        "excess": dict(where.excess),
        "regimes": {
            name: {level: _ends("share", found) for level, found in levels.items()}
            for name, levels in where.regimes.items()
        },
        "bands": {name: [band._asdict() for band in bands] for name, bands in where.bands.items()},
        "Ti_Tt": {
            name: {
                direction: {
                    "events": found.count(direction),
                    "Ti_s": found.median("Ti_s", direction),
                    "Tt_s": found.median("Tt_s", direction),
                }
                for direction in ("push", "pull")
            }
            for name, found in where.times.items()
        },
        "pushes": sum(event.label == 0 for flight in where.events for event in flight),
        "pulls": sum(event.label == 1 for flight in where.events for event in flight),
    }


def _model(one: Tried) -> dict[str, Any]:
    return {
        "effects": list(one.effects),
        "family": one.family,
        "gain": _gain(one)["value"],
        "flights": [min(1.0, max(-1.0, gain)) for gain in one.flights],
        "probability": one.probability,
    }
