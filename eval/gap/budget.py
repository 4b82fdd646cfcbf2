"""The diagnosis by the budget core: from pairs of logs to `gap.json` of schema narxcal.gap/2."""

from __future__ import annotations

import json
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from os import PathLike, fspath
from pathlib import Path
from typing import Any, Final

import pandas as pd
from matplotlib.figure import Figure

from eval.evaluate import run_config
from eval.gap.blocks import batch, block_size
from eval.gap.budget_page import budget_figure
from eval.gap.claimed import Values, with_effects
from eval.gap.data import GapData, Pair
from eval.gap.diagnose import Request, facts_of
from eval.gap.document import document
from eval.gap.evidence import Evidence
from eval.gap.excitation import check_excitation, events_of
from eval.gap.expected import expected, seen, unseen
from eval.gap.held_flights import in_terms_of
from eval.gap.hidden_load import shift_of
from eval.gap.left_out import left_out_pairs
from eval.gap.pairs import check_apart, read_pairs
from eval.gap.realised import channel_shrink, held_out, time_shrink
from eval.gap.records import phases_of, record_of
from eval.gap.rerun import Rerun
from eval.gap.simulators import Simulate, open_simulator
from eval.gap.where import locate
from narxcal.calibration.bundle import DOCUMENT, load_bundle, seal
from narxcal.effects.library import hypotheses
from narxcal.effects.running import Emulator, with_load
from narxcal.effects.steady import UnloggedSwitch
from narxcal.support.arrays import spans
from narxcal.support.errors import DataError, ModelError, NarxcalError
from narxcal.support.files import atomic_write_text, sha256_of, to_json
from training.budget.control import suited
from training.budget.diagnosis import Engines
from training.budget.diagnosis import diagnose as weighed
from training.budget.dictionary import Dictionary
from training.budget.discrepancy import Discrepancy, learn, read
from training.budget.fitting import Frame
from training.budget.load import windows_of
from training.budget.metric import Metric, assumed_variance
from training.budget.nuisances import nuisances
from training.budget.odds import Odds
from training.budget.result import Budget, Interval
from training.config import RunConfig
from training.gap import finding as old
from training.gap.emulator import GreyBoxEmulator, fit_emulators

SCHEMA: Final = "narxcal.gap/2"
LEARNED: Final = "discrepancy.json"  # in a run folder
RATE_HZ = 4.0
KEEP_HZ = 5.0  # slower logs are taken as they are


@dataclass(frozen=True, eq=False)
class Answer:
    """The document of schema narxcal.gap/2, the budget it states, and what both rest on."""

    document: dict[str, Any]
    budget: Budget
    evidence: Evidence
    emulator: GreyBoxEmulator

    @property
    def table(self) -> pd.DataFrame:
        """The budget: a row per cause, its share, low, high, probability and channels' shares."""
        rows = [
            {key: row[key] for key in ("cause", "share", "low", "high", "probability")}
            | row["channels"]
            for row in self.budget.rows()
        ]
        return pd.DataFrame(rows).set_index("cause")

    def plot(self) -> Figure:
        """Draw the budget as bars: the whole gap, each channel, each phase."""
        return budget_figure(self.budget.rows())


def diagnose(
    real: str | PathLike[str],
    sim: str | PathLike[str],
    *,
    heldout: tuple[str | PathLike[str], str | PathLike[str] | None] | None = None,
    config: RunConfig | None = None,
    trust: bool = False,
) -> Answer:
    """Say which unmodelled effects make flights and a simulator differ, and by what shares.

    `real` is a folder of the flights' logs; `sim` a folder of simulated logs of the same names, a
    run folder, an FMU, `module:function` or a virtual engine's name; `heldout` the same two of
    flights to check on, None for the same simulator. Without `config` columns are mapped as the run
    folder does, else they bear canonical names. Raises `DataError`, `ConfigError`, `ModelError`.
    """
    config = config or mapping_of(fspath(sim), trust=trust)
    held_real, held_sim = (None, None) if heldout is None else heldout
    request = Request(
        Path(real),
        fspath(sim),
        config,
        None if held_real is None else Path(held_real),
        None if held_sim is None else fspath(held_sim),
        trust,
    )
    return diagnose_folders(request)


def mapping_of(sim: str, *, trust: bool = False) -> RunConfig | None:
    """The configuration of a run folder, which maps the columns of its logs; None of others."""
    if not (Path(sim or "nothing") / DOCUMENT).is_file():
        return None
    return run_config(load_bundle(Path(sim), trust=trust))[0]


def diagnose_folders(request: Request) -> Answer:
    """Read the logs of a `Request` and diagnose; raises as `eval.gap.diagnose`."""
    began = time.perf_counter()
    simulator = open_simulator(request.sim, trust=request.trust)
    pairs = read_pairs(request.real, simulator.how, request.config)
    held: list[Pair] = []
    if request.held_real is not None:
        source = request.sim if request.held_sim is None else request.held_sim
        other = open_simulator(source, trust=request.trust)
        if request.held_sim is None and isinstance(other.how, Path):
            raise DataError(
                "held-out flights need their simulated logs", hint="Name them by --heldout-sim"
            )
        held = read_pairs(request.held_real, other.how, request.config)
    check_apart(pairs, held)
    again = None if isinstance(simulator.how, Path) else simulator.how
    run = Path(request.sim) if simulator.kind == "bundle" else None
    learned, warnings = (None, []) if run is None else _learned_of(run, trust=request.trust)
    answer = diagnose_pairs(pairs, held, again, learned)
    facts = {"simulator": simulator.kind, "wall_s": round(time.perf_counter() - began, 1)}
    quality = {**facts, **answer.document["quality"]}
    quality["warnings"] = [*warnings, *quality["warnings"]]
    return replace(answer, document={**answer.document, "quality": quality})


def _learned_of(run: Path, *, trust: bool) -> tuple[Discrepancy | None, list[str]]:
    """What a run gets wrong by itself, learned now where nobody did, and what to say without it."""
    found = learned_by(run)
    if found is not None:
        return found, []
    try:
        return learn_left_out(run, trust=trust), []
    except NarxcalError as error:
        text = f"what {run} gets wrong by itself is not known ({error}): tolerances are assumed"
        return None, [text]


def learn_folders(request: Request, run: Path) -> Discrepancy:
    """Learn what a simulator gets wrong by itself, and keep it in the folder of a run.

    `request` names flights and a simulator that was identified without them; `run` is a run of the
    same kind that is to be diagnosed with, on further flights. Raises as `diagnose_folders`.
    """
    simulator = open_simulator(request.sim, trust=request.trust)
    found = learned_from(read_pairs(request.real, simulator.how, request.config))
    keep_learned(found, run)
    return found


def learn_left_out(run: Path, *, trust: bool = False, jobs: int = -1) -> Discrepancy:
    """Learn from a run's own training flights by models without them, and keep it in the folder.

    Of a single flight halves stand for flights, and count as one. Raises `DataError` where the
    training logs are not at hand, and as the training.
    """
    pairs = left_out_pairs(load_bundle(run, trust=trust), jobs)
    found = learned_from(pairs)
    if len({pair.name.partition("[")[0].partition(":")[0] for pair in pairs}) == 1:
        found = replace(found, flights=1)
    keep_learned(found, run)
    return found


def learned_from(pairs: Sequence[Pair]) -> Discrepancy:
    """What a simulator gets wrong in flights that it was not identified on."""
    data = batched(pairs)
    record = record_of(data)
    emulator = suited(fit_emulators(data.flights), record)
    return learn(record, Dictionary(hypotheses(data.flights.signals), data.flights, emulator))


def keep_learned(found: Discrepancy, run: Path) -> None:
    """Write what was learned into the folder of a run, with its own hash and that of the bundle."""
    told = {**found.document(), "bundle_sha256": sha256_of(run / DOCUMENT)}
    with suppress(PermissionError):  # another's run: learned again at every diagnosis
        atomic_write_text(run / LEARNED, to_json({**told, "sha256": seal(told)}))


def learned_by(run: Path) -> Discrepancy | None:
    """What was learned of a run and kept in its folder; None where nothing was.

    Raises `ModelError` for a file that was altered, or was learned for another run.
    """
    file = run / LEARNED
    if not file.is_file():
        return None
    again = "Learn it again by diagnose --learn"
    try:
        told = json.loads(file.read_text(encoding="utf-8"))
        intact = told.pop("sha256") == seal(told)
        if intact and told["bundle_sha256"] == sha256_of(file.with_name(DOCUMENT)):
            return read(told)
    except (AttributeError, ValueError, KeyError, TypeError, RecursionError) as error:
        raise ModelError(f"is unusable: {error!r}", file=file, hint=again) from None
    what = "was learned for another model" if intact else "was altered: its hash is another"
    raise ModelError(what, file=file, hint=again)


def diagnose_pairs(
    pairs: Sequence[Pair],
    held: Sequence[Pair] = (),
    again: Simulate | None = None,
    learned: Discrepancy | None = None,
    odds: Odds | None = None,
) -> Answer:
    """Diagnose pairs that are already read; `held` are flights that take no part."""
    data = batched(pairs)
    check_excitation(data, events_of(data))
    record = record_of(data)
    emulator = suited(fit_emulators(data.flights), record)
    itself = None if again is None else Rerun(emulator, again, _block(pairs))
    found = weighed(record, Engines(emulator, itself), phases_of(data), learned, odds)
    stand_in: Emulator = itself or emulator
    there = in_terms_of(data, batched(held)) if held else None
    if found.on is not None:
        data = replace(data, flights=with_load(data.flights, found.on.astype(float)))
    evidence = _evidence(data, found, emulator, stand_in)
    if there is not None:
        evidence = _with_held_out(evidence, found, there, stand_in)
    facts = {**facts_of(pairs, data, held), "core": dict(found.facts)}
    evidence = replace(evidence, facts=facts)
    told = document(evidence) | {
        "schema": SCHEMA,
        "verdict": found.verdict_row(),
        "budget": found.rows(),
        "effects": _effect_rows(found, pairs, data.flights.signals.dt_s),
    }
    return Answer(told, found, evidence, emulator)


def batched(pairs: Sequence[Pair]) -> GapData:
    """All pairs on one raster of about 4 Hz."""
    return batch(pairs, RATE_HZ, KEEP_HZ)


def _block(pairs: Sequence[Pair]) -> int:
    return block_size(pairs[0].dt_s, RATE_HZ, KEEP_HZ)


def _evidence(
    data: GapData, found: Budget, emulator: GreyBoxEmulator, stand_in: Emulator
) -> Evidence:
    values = found.claimed
    after = with_effects(values, data.flights, stand_in)
    none = Interval(0.0, 0.0, 0.0)
    predicted = expected(seen(data, after, found.by_others)) if values else none
    errors = dict(
        zip(data.flights.signals.outputs, emulator.errors(data.flights).tolist(), strict=True)
    )
    channels = channel_shrink(data, after)
    verdict = found.verdict
    finding = old.Finding(
        verdict.kind,
        verdict.effects,
        verdict.ambiguous_with,
        verdict.reason,
        verdict.separating_manoeuvre,
        tuple(_tried(found)),
        predicted,
        channels,
        found.gap_share,
        next(one.share for one in found.causes if one.cause == "unexplained"),
        errors,
        by_others=found.by_others,
    )
    where = locate(data, after - data.flights.y)
    times = time_shrink(data, after, where.events)
    return Evidence(data, finding, where, after, times, predicted, channels)


def _tried(found: Budget) -> list[old.Tried]:
    """Effects in the form of the document of the rules."""
    return [
        old.Tried(
            (one.name,), "", one.gain, one.flights, one.probability,
            {one.name: dict(one.parameters)}, {one.name: dict(one.units)}, one.at_bound,
        )
        for one in found.effects
    ]  # fmt: skip


def _with_held_out(
    evidence: Evidence, found: Budget, data: GapData, stand_in: Emulator
) -> Evidence:
    if UnloggedSwitch.id in found.claimed:
        data = _with_windows(found.claimed, data, stand_in)
    there = held_out(found.claimed, data, stand_in)
    evidence = replace(
        evidence, held_out=there, times=time_shrink(data, there.after, events_of(data))
    )
    # Only what was recorded tells when a load was on in further flights: that predicts nothing.
    if not found.claimed or UnloggedSwitch.id in found.claimed:
        return evidence
    here = seen(evidence.data, evidence.after, found.by_others)
    return replace(evidence, predicted=expected(here, unseen(data, there.after)))


def _with_windows(values: Values, data: GapData, emulator: Emulator) -> GapData:
    """Further flights with the windows in which the claimed load was on there.

    Their own gap tells when, the claim how large.
    """
    others = {name: each for name, each in values.items() if name != UnloggedSwitch.id}
    y = with_effects(others, data.flights, emulator)
    record = record_of(replace(data, flights=replace(data.flights, y=y)))
    metric = Metric(record, assumed_variance(record))
    frame = Frame(record, metric, record.gap, nuisances(record, None, 0.0))
    on = windows_of(frame, shift_of(values, data.flights.signals)).astype(float)
    return replace(data, flights=with_load(data.flights, on, always=True))


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
        }
        for pair, on in zip(pairs, found.on, strict=True)
        for start, stop in spans(on)
    ]
    return [row | {"windows": windows} if row["id"] == UnloggedSwitch.id else row for row in rows]
