"""A diagnosis in full, and as `gap.json` of schema narxcal.gap/2."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any, Final

import numpy as np

from data_prep.events import PULL, PUSH
from data_prep.sources.units import conversions, to_canonical
from eval.diagnosis.applied import GAP_SCHEMA, signals_to_json
from eval.diagnosis.expected import ChannelShrink, HeldOut, TimeShrink, Values
from eval.diagnosis.pairs import Pair
from eval.diagnosis.where import Row, Sides, Where
from eval.judging.outcome import plural
from narxcal.channels import SPOOLS
from narxcal.effects.base import unit
from narxcal.effects.library import effect
from narxcal.effects.running import emulates_input
from narxcal.effects.steady import TAKEN, UNLOGGED_SWITCH
from narxcal.support.arrays import FloatArray, spans
from narxcal.support.files import versions
from training.diagnosis.budget import UNEXPLAINED, Budget, Interval
from training.diagnosis.emulator import GreyBoxEmulator
from training.diagnosis.metric import Record
from training.diagnosis.nuisances import most_of_build

FEW: Final = 3  # flights: fewer say little of the spread between them
_UNKNOWN = 0.01  # of the samples
_COARSE, _LOUD = 0.5, 0.1  # an emulator's error against the gap, a channel's share of the gap
_FAR = 0.08  # of a speed: no deterioration and no sensor is that far off
_DOMINANT = 0.6  # of a bin's energy in one level: the level that stands for the bin


@dataclass(frozen=True, eq=False)
class Evidence:
    """A diagnosis in full.

    `after` (flights, time, outputs) is the simulator with the claimed effects, or as it was where
    nothing is claimed; `predicted` the share of the squared gap that they will take off other
    flights, `channels` the RMSE on these. `times` is how Ti and Tt errors shrink with them, per
    channel, on held-out flights where there are any. `emulator_rmse` is of the `emulator`'s free
    run; `facts` go into `quality` as they are.
    """

    data: Record
    budget: Budget
    where: Where
    after: FloatArray
    times: Mapping[str, TimeShrink]
    predicted: Interval
    channels: Mapping[str, ChannelShrink]
    emulator: GreyBoxEmulator
    emulator_rmse: Mapping[str, float]
    held_out: HeldOut | None = None
    facts: Mapping[str, object] = field(default_factory=dict)


def document(evidence: Evidence, pairs: Sequence[Pair]) -> dict[str, Any]:
    """Put everything into plain values; numbers that are not finite are left to the writer."""
    found, where, held = evidence.budget, evidence.where, evidence.held_out
    return {
        "schema": GAP_SCHEMA,
        "verdict": found.verdict_row(),
        "effects": _effect_rows(found, pairs, evidence.data.flights.signals.dt_s),
        "where": [_bin(row) for row in where.rows],
        "side": _side(found, where)._asdict(),
        "theil": {name: split._asdict() for name, split in where.theil.items()},
        "shrink": _shrink(evidence),
        "emulator": {
            "used": bool(evidence.emulator_rmse),
            "rmse": dict(evidence.emulator_rmse),
            "rmse_heldout": {} if held is None else dict(held.emulator_rmse),
        },
        "quality": {**evidence.facts, **_measured(found, where)},
        "budget": found.rows(),
    }


def _effect_rows(found: Budget, pairs: Sequence[Pair], dt_s: float) -> list[dict[str, Any]]:
    """Rows of the effects, a claimed load's with the windows in which it was on."""
    rows = found.effect_rows()
    if found.on is None:
        return rows
    windows = [
        {
            "log": pair.name,
            "log_start_s": (began := float(pair.time_s[0])),
            "start_s": began + start * dt_s,
            "end_s": began + stop * dt_s,
            "start_span_s": [began + step * dt_s for step in edges[2 * k]],
            "end_span_s": [
                began + step * dt_s
                for step in (edges[2 * k + 1] if 2 * k + 1 < len(edges) else (stop, stop))
            ],
        }
        for pair, on, edges in zip(pairs, found.on, found.edges, strict=True)
        for k, (start, stop) in enumerate(spans(on))
    ]
    return [row | {"windows": windows} if row["id"] == UNLOGGED_SWITCH.id else row for row in rows]


def _side(found: Budget, where: Where) -> Sides:
    """Input, process or sensor: by the effects' probabilities where one is claimed."""
    if not found.verdict.effects:
        return where.side
    votes = dict.fromkeys(Sides._fields, 0.0)
    for one in found.effects:
        votes[effect(one.name).side] += one.probability
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
    held, channels, on = evidence.held_out, evidence.channels, "the flights of the diagnosis"
    if held is not None:
        channels, on = held.channels, f"{plural(len(held.data.names), 'flight')} that took no part"
    return {
        "predicted": _within_all(evidence.predicted),
        "realised": None if held is None else held.share,
        "channels": {name: asdict(found) for name, found in channels.items()},
        "shares": {name: _taken(found) for name, found in channels.items()},
        "times": {name: asdict(found) for name, found in evidence.times.items()},
        "on": on,
    }


def _within_all(found: Interval) -> dict[str, float]:
    """A share from all to as much again; ends that one flight cannot know are as far as can be."""
    value = _clipped(found.value, 0.0)
    low, high = _clipped(found.low, -1.0), _clipped(found.high, 1.0)
    return {"value": value, "low": min(low, value), "high": max(high, value)}


def _clipped(share: float, unknown: float) -> float:
    return min(1.0, max(-1.0, share)) if math.isfinite(share) else unknown


def _taken(found: ChannelShrink) -> float:
    return 1.0 - (found.after / found.before) ** 2 if found.before > 0.0 else 0.0


def _measured(found: Budget, where: Where) -> dict[str, Any]:
    return {
        "gap_share": found.gap_share,
        "left_share": next(c.share for c in found.causes if c.cause == UNEXPLAINED),
        "channels": {name: asdict(part) for name, part in where.channels.items()},
        "excess": dict(where.excess),
        "regimes": {
            name: {level: _ends("share", part) for level, part in levels.items()}
            for name, levels in where.regimes.items()
        },
        "bands": {name: [band._asdict() for band in bands] for name, bands in where.bands.items()},
        "Ti_Tt": {
            name: {
                direction: {
                    "events": len(some),
                    "Ti_s": float(some["Ti_s"].median()),
                    "Tt_s": float(some["Tt_s"].median()),
                }
                for direction in ("push", "pull")
                for some in [times[times["direction"] == direction]]
            }
            for name, times in where.times.items()
        },
        "pushes": sum(event.label == PUSH for flight in where.events for event in flight),
        "pulls": sum(event.label == PULL for flight in where.events for event in flight),
    }


def cautions(pairs: Sequence[Pair], data: Record) -> list[str]:
    found = []
    if len(pairs) < FEW:
        found.append(f"{plural(len(pairs), 'flight')}: the uncertainty is wider")
    alone = dict.fromkeys(item for pair in pairs for item in pair.lone.items())
    found += [f"{name} is {why}: it is left out" for name, why in alone]
    unknown = 1.0 - float(np.mean([np.isfinite(v).mean() for p in pairs for v in p.real.values()]))
    if unknown > _UNKNOWN:
        found.append(f"{100.0 * unknown:.1f} % of the recorded samples are unknown")
    cut = sum(pair.counts.get("cut at the end", 0) for pair in pairs)
    if cut:
        found.append(f"{cut} samples at the ends of flights have no partner and are cut")
    return [*found, *implausible(data)]


def coarse_emulator(evidence: Evidence, *, again: bool) -> list[str]:
    """Say so where the emulator's own error is no match for the gap that it has to explain.

    That matters where a claimed effect acts inside the engine, or before it and the simulator
    cannot be run `again`, on channels that hold a tenth of the gap or more.
    """
    if not rests_on_emulator(evidence.budget.claimed, again=again):
        return []
    gap = np.sqrt(np.nanmean(evidence.data.difference**2, axis=(0, 1)))
    own = evidence.emulator_rmse
    coarse = [
        f"{name} ({own[name]:.3g} of {size:.3g})"
        for name, size in zip(evidence.data.flights.signals.outputs, gap.tolist(), strict=True)
        if own[name] > _COARSE * size and evidence.where.channels[name].value >= _LOUD
    ]
    if not coarse:
        return []
    words = (
        f"the emulator's own error is more than half of the gap in {', '.join(coarse)}: sizes of "
        "effects inside the engine are less sure than their intervals say"
    )
    return [words]


def rests_on_emulator(values: Values, *, again: bool) -> bool:
    """Whether effects rest on the emulator: of loads and heat what they take of the core does."""
    return any(
        kind.on_rates or kind.settled or takes or (emulates_input(kind) and not again)
        for name, own in values.items()
        for kind, takes in [(effect(name), own.get(TAKEN.name, 0.0) > 0.0)]
    )


def implausible(data: Record) -> list[str]:
    """What no engine and no sensor of the library does: another unit, another speed for 100 %.

    A channel is in another unit where recorded and simulated differ by more than builds can, on
    the median, and by less once either is converted.
    """
    found, most = [], most_of_build(data.flights)
    for k, name in enumerate(data.flights.signals.outputs):
        real = data.real[..., k]
        sim = np.where(np.isfinite(real), data.flights.y[..., k], np.nan)
        apart, level = np.nanmedian(real - sim), np.nanmedian(sim)
        if np.nanmedian(np.abs(real - sim)) <= most[k]:
            continue
        units = [
            f"the {side} {name} looks like {word}"
            for word, other in conversions(name).items()
            for side, gap in (
                ("recorded", to_canonical(real, other) - sim),
                ("simulated", real - to_canonical(sim, other)),
            )
            if np.nanmedian(np.abs(gap)) <= most[k]
        ]
        if units:
            found.append(f"{units[0]}: it is {apart:+.4g} {unit(name)} off the other throughout")
        elif name in SPOOLS and abs(apart) > _FAR * abs(level):
            found.append(
                f"recorded {name} is {100.0 * apart / level:+.0f} % of its level off the "
                "simulated one throughout: another engine, or another speed for 100 %?"
            )
    return found


def facts_of(pairs: Sequence[Pair], data: Record, held: Sequence[Pair]) -> dict[str, Any]:
    """`quality` of `gap.json`, as far as it is of the logs."""
    return {
        "flights": [pair.name for pair in pairs],
        "held_out": [pair.name for pair in held],
        "duration_s": round(sum(len(pair.time_s) * pair.dt_s for pair in pairs), 6),
        "rate_hz": round(1.0 / pairs[0].dt_s, 6),
        "worked_at_hz": round(1.0 / data.flights.signals.dt_s, 6),
        "driver": data.flights.signals.driver,
        "noise": dict(zip(data.flights.signals.outputs, data.noise.tolist(), strict=True)),
        "compared": _compared(pairs),
        "changed": {pair.name: dict(pair.counts) for pair in pairs if pair.counts},
        "warnings": cautions(pairs, data),
        "signals": signals_to_json(data.flights.signals),
        "versions": versions(),
    }


def _compared(pairs: Sequence[Pair]) -> dict[str, float]:
    """RMSE of the outputs that are recorded on both sides but not diagnosed."""
    squares: dict[str, list[FloatArray]] = {}
    for pair in pairs:
        for name, both in pair.others.items():
            squares.setdefault(name, []).append((both[:, 0] - both[:, 1]) ** 2)
    return {n: float(np.sqrt(np.nanmean(np.concatenate(v)))) for n, v in squares.items()}
