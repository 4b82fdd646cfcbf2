"""The whole diagnosis: read pairs, fit the emulator, ask which effect, say where, check how far."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from eval.gap.blocks import batch, block_size
from eval.gap.cautions import cautions, coarse_emulator, rests_on_emulator
from eval.gap.claimed import Values, claimed, offset_leads, with_effects
from eval.gap.data import GapData, Pair
from eval.gap.document import document, probabilities
from eval.gap.evidence import Evidence, HeldOut
from eval.gap.excitation import check_excitation, events_of
from eval.gap.expected import expected, seen, unseen
from eval.gap.held_flights import in_terms_of, together
from eval.gap.hidden_load import look_again, look_beside, look_for_load, spells
from eval.gap.pairs import check_apart, read_pairs
from eval.gap.parts import enough
from eval.gap.realised import channel_shrink, held_out, time_shrink
from eval.gap.records import phases_of, record_of
from eval.gap.rerun import Rerun
from eval.gap.simulators import Simulate, open_simulator
from eval.gap.stored_emulator import signals_to_json
from eval.gap.where import locate
from narxcal.effects.running import Emulator
from narxcal.effects.steady import UnloggedSwitch
from narxcal.support.arrays import FloatArray
from narxcal.support.errors import DataError
from narxcal.support.files import versions
from training.budget.diagnosis import shares_of
from training.budget.result import Interval, cause_row
from training.config import RunConfig
from training.gap.control import suited
from training.gap.diagnosis import diagnose
from training.gap.emulator import GreyBoxEmulator, fit_emulators, widened
from training.gap.finding import Finding
from training.gap.unlogged import Load
from training.gap.work import Simulators, Watch

_SAME = 1e-9  # of a channel's range
_NOTHING = Interval(0.0, 0.0, 0.0)


class Request(NamedTuple):
    """Where the logs are; `sim` may name any simulator, `held_sim` left out means the same one."""

    real: Path
    sim: str
    config: RunConfig | None = None
    held_real: Path | None = None
    held_sim: str | None = None
    trust: bool = False  # of a run folder whose steady-state model runs code


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """The document of schema narxcal.gap/1, what it rests on, and the emulator that was used."""

    document: dict[str, Any]
    evidence: Evidence
    emulator: GreyBoxEmulator


def diagnose_folders(request: Request, watch: Watch | None = None) -> Diagnosis:
    """Read the logs and diagnose; raises `DataError`, `ConfigError` and `ModelError`."""
    began = time.perf_counter()
    watch = watch or _unwatched
    watch("reading", 0, 1)
    simulator = open_simulator(request.sim, trust=request.trust)
    pairs = read_pairs(request.real, simulator.how, request.config)
    held = _held_pairs(request)
    check_apart(pairs, held)
    again = None if isinstance(simulator.how, Path) else simulator.how
    found = diagnose_pairs(pairs, held, watch, again)
    facts = {"simulator": simulator.kind, "wall_s": round(time.perf_counter() - began, 1)}
    quality = {**facts, **found.document["quality"]}
    return replace(found, document={**found.document, "quality": quality})


def diagnose_pairs(
    pairs: Sequence[Pair],
    held: Sequence[Pair] = (),
    watch: Watch | None = None,
    again: Simulate | None = None,
) -> Diagnosis:
    """Diagnose pairs that are already read; `held` are flights that take no part.

    A simulator that can be run `again` says itself what claimed effects on its inputs do.
    """
    watch = watch or _unwatched
    parts = enough(pairs)
    data = batch(parts)
    events = events_of(data)
    check_excitation(data, events)
    other = in_terms_of(data, batch(held)) if held else None
    watch("emulator", 0, 1)
    emulator = suited(fit_emulators(data.flights), data.flights, (data.real, data.noise))
    own = emulator.errors(data.flights).tolist()
    itself = None if again is None else Rerun(emulator, again, block_size(parts[0].dt_s))
    flown = data.flights
    data, load, found = _found(data, Simulators(emulator, itself), watch)
    errors = dict(zip(data.flights.signals.outputs, own, strict=True))
    finding = _bounded(replace(found, emulator_rmse=errors), pairs)
    values = claimed(finding)
    wider = rests_on_emulator(values, again=again is not None)
    if other is not None and wider:
        # Effects were found without them; what they do there, the simulator's own logs know best.
        watch("emulator of the held-out flights too", 0, 1)
        emulator = widened(emulator, together(flown, other.flights))
        itself = itself and replace(itself, emulator=emulator)
    watch("where", 0, 1)
    stand_in: Emulator = itself or emulator
    evidence = _evidence(data, finding, values, stand_in)
    evidence = replace(evidence, windows=spells(load, data, parts))
    if other is not None:
        evidence = _with_held_out(evidence, values, (held, other), stand_in)
    if wider:
        evidence = _with_errors(evidence, emulator)
    facts = {**facts_of(pairs, data, held), "unlogged_load": load.reason or "found"}
    facts["warnings"] += coarse_emulator(evidence, again=again is not None)
    evidence = replace(evidence, facts=facts)
    told = document(evidence)
    told["budget"] = _budget(data, values, stand_in, probabilities(finding))
    return Diagnosis(told, evidence, emulator)


def _budget(
    data: GapData, values: Values, emulator: Emulator, known: Mapping[str, float]
) -> list[dict[str, Any]]:
    """What share of the gap the claimed effects take, and what else takes the rest."""
    responses, done = {}, data.flights.y
    for k, name in enumerate(values):
        some = {each: values[each] for each in list(values)[: k + 1]}
        after = with_effects(some, data.flights, emulator)
        responses[name], done = after - done, after
    found = {name: known[name] for name in values}
    causes = shares_of(record_of(data), responses, phases_of(data), found)
    return [cause_row(one) for one in causes]


def _found(data: GapData, simulators: Simulators, watch: Watch) -> tuple[GapData, Load, Finding]:
    """The finding, with an unlogged load among the candidates if there are windows of one.

    Where the gap shows none, what the best model leaves of it is searched, and with windows there
    the question is asked anew. Nothing is asked of logs that are the same.
    """
    if not np.nanmax(np.abs(data.gap) / data.span, initial=0.0) > _SAME:
        return data, *_nothing(data)
    watch("windows of an unlogged load", 0, 1)
    told, load = look_for_load(data)
    finding = _asked(told, simulators, watch)
    if load.windows:
        return told, load, finding
    told, beside = look_beside(finding, data, simulators.emulator)
    if not beside.windows:
        return data, load, finding
    return told, beside, _asked(told, simulators, watch)


def _nothing(data: GapData) -> tuple[Load, Finding]:
    reason, none = "recorded and simulated logs are the same", _NOTHING
    count, steps = data.gap.shape[:2]
    channels = channel_shrink(data, data.flights.y)
    finding = Finding("none", (), (), reason, "", (), none, channels, 0.0, 0.0)
    return Load(np.zeros((count, steps)), (), np.zeros(count), reason), finding


def _asked(data: GapData, simulators: Simulators, watch: Watch) -> Finding:
    return diagnose(data.flights, (data.real, data.noise), simulators, watch=watch)


def _evidence(data: GapData, finding: Finding, values: Values, emulator: Emulator) -> Evidence:
    after = with_effects(values, data.flights, emulator)
    # An offset within build scatter that is most of the gap is no claim, but it is the gap.
    where = locate(data, None if offset_leads(finding) else after - data.flights.y)
    return Evidence(
        data=data,
        finding=finding,
        where=where,
        after=after,
        times=time_shrink(data, after, where.events),
        predicted=expected(seen(data, after, finding.by_others)) if values else _NOTHING,
        channels=channel_shrink(data, after),
    )


def _with_held_out(
    evidence: Evidence, values: Values, flown: tuple[Sequence[Pair], GapData], emulator: Emulator
) -> Evidence:
    pairs, other = flown
    data = in_terms_of(evidence.data, other)
    windows = evidence.windows
    if UnloggedSwitch.id in values:
        data, load = look_again(values, data, emulator)
        windows += spells(load, data, pairs, held_out=True)
    found = held_out(values, data, emulator)
    times = time_shrink(data, found.after, events_of(data))
    evidence = replace(evidence, held_out=found, times=times, windows=windows)
    # When a load is on there is told by what was recorded alone.
    told = values and UnloggedSwitch.id not in values
    return replace(evidence, predicted=_on_these(evidence, found)) if told else evidence


def _with_errors(evidence: Evidence, emulator: GreyBoxEmulator) -> Evidence:
    """With those of the emulator's free run on held-out flights, if there are any."""
    held = evidence.held_out
    if held is None:
        return evidence
    flights = held.data.flights
    errors = dict(zip(flights.signals.outputs, emulator.errors(flights).tolist(), strict=True))
    return replace(evidence, held_out=replace(held, emulator_rmse=errors))


def _on_these(evidence: Evidence, held: HeldOut) -> Interval:
    """How far the gap of held-out flights is expected to shrink, by what the effects do there."""
    here = seen(evidence.data, evidence.after, evidence.finding.by_others)
    return expected(here, unseen(held.data, held.after))


def _held_pairs(request: Request) -> list[Pair]:
    if request.held_real is None:
        return []
    source = request.sim if request.held_sim is None else request.held_sim
    simulator = open_simulator(source, trust=request.trust)
    if request.held_sim is None and isinstance(simulator.how, Path):
        raise DataError(
            "held-out flights need their simulated logs", hint="Name them by --heldout-sim"
        )
    return read_pairs(request.held_real, simulator.how, request.config)


def _bounded(finding: Finding, pairs: Sequence[Pair]) -> Finding:
    """No firm word on one short flight: nothing could be checked on another."""
    if len(pairs) > 1 or len(enough(pairs)) > 1 or finding.kind == "none":
        return finding
    reason = (
        "one flight is no evidence: an effect has to hold in others too; the best candidate is "
        f"{' and '.join(finding.tried[0].effects) if finding.tried else 'none'}"
    )
    silent = replace(finding, kind="unknown", effects=(), ambiguous_with=())
    return replace(silent, reason=reason)


def facts_of(pairs: Sequence[Pair], data: GapData, held: Sequence[Pair]) -> dict[str, Any]:
    """`quality` of `gap.json`, as far as it is of the logs."""
    return {
        "flights": [pair.name for pair in pairs],
        "parts": list(data.names) if len(data.names) > len(pairs) else [],
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


def _unwatched(step: str, done: int, total: int) -> None:
    """Nobody is watching."""
