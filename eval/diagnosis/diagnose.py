"""The diagnosis: read pairs of logs, fit the emulator, weigh effects, say where and how far.

`narxcal.diagnose` is public. The result is a document of schema narxcal.gap/2.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from os import PathLike, fspath
from pathlib import Path
from typing import Any, Final, NamedTuple

import pandas as pd
from matplotlib.figure import Figure

from data_prep.log import Finding
from eval.diagnosis.document import (
    Evidence,
    coarse_emulator,
    document,
    facts_of,
    implausible,
    rests_on_emulator,
)
from eval.diagnosis.expected import (
    Values,
    channel_shrink,
    expected,
    held_out,
    seen,
    shift_of,
    taken_off,
    time_errors,
    time_shrink,
    unseen,
    with_effects,
)
from eval.diagnosis.flights import (
    batch,
    block_size,
    check_excitation,
    events_of,
    in_terms_of,
    phases_of,
    together,
)
from eval.diagnosis.learned import keep_learned, learn_left_out, learned_by, learned_from
from eval.diagnosis.pairs import Pair, check_apart, files_in, log_name, read_pairs
from eval.diagnosis.simulators import Rerun, Simulate, Simulator, open_simulator
from eval.diagnosis.where import locate
from eval.diagnosis.words import in_words, listed, outcome, percent
from eval.judging.log_evaluation import role_of
from eval.report import plot
from eval.report.tables import Shown, Summary
from eval.run_logs import evaluation_logs, run_config
from narxcal.calibration.bundle import Bundle
from narxcal.effects.running import Emulator, with_load
from narxcal.effects.steady import UNLOGGED_SWITCH
from narxcal.support.errors import ConfigError, DataError, NarxcalError
from narxcal.support.progress import Progress, silent
from training.config import RunConfig
from training.diagnosis.budget import Budget, Interval
from training.diagnosis.discrepancy import Discrepancy
from training.diagnosis.emulator import (
    GreyBoxEmulator,
    choose_control,
    fit_emulators,
    widened,
)
from training.diagnosis.fit import Frame
from training.diagnosis.load import windows_of
from training.diagnosis.metric import Metric, Record, assumed_variance
from training.diagnosis.nuisances import nuisances
from training.diagnosis.verdict import ASSUMED, Engines, NullModel, concluded, weigh

_NOTHING: Final = Interval(0.0, 0.0, 0.0)
_STEPS: Final = 4
_MISREAD: Final = ("unit", "exchanged", "stretched")  # findings about columns and clock of a log


class Request(NamedTuple):
    """Where the logs are; `sim` may name any simulator, `held_sim` left out means the same one."""

    real: Path
    sim: str
    config: RunConfig | None = None
    held_real: Path | None = None
    held_sim: str | None = None
    trust: bool = False  # of a run folder whose steady-state model runs code
    build: float = 1.0  # share of what engines of one type differ by: 0 for this very engine


@dataclass(frozen=True, eq=False, repr=False)
class Answer(Shown):
    """The document of schema narxcal.gap/2, and what it rests on."""

    document: dict[str, Any]
    evidence: Evidence

    @property
    def table(self) -> pd.DataFrame:
        """The budget: a row per cause, its share, low, high, probability and channels' shares."""
        rows = [
            {key: row[key] for key in ("cause", "share", "low", "high", "probability")}
            | row["channels"]
            for row in self.evidence.budget.rows()
        ]
        return pd.DataFrame(rows).set_index("cause")

    def plot(self) -> Figure:
        figure: Any = plot.gap(self).figure
        drawn: Figure = figure
        return drawn

    @property
    def summary(self) -> Summary:
        said = outcome(self.document)
        warnings = self.document["quality"]["warnings"]
        return Summary(said.headline, [*said.lines, *warnings], self.table)


def diagnose(  # noqa: PLR0913 - each is one option of the command
    real: str | PathLike[str],
    sim: str | PathLike[str],
    *,
    heldout: tuple[str | PathLike[str], str | PathLike[str] | None] | None = None,
    config: RunConfig | None = None,
    trust: bool = False,
    build: float = 1.0,
) -> Answer:
    """Say which unmodelled effects make flights and a simulator differ, and by what shares.

    `real` is a folder of the flights' logs; `sim` a folder of simulated logs of the same names, a
    run folder, an FMU, `module:function` or a virtual engine's name; `heldout` the same two of
    flights to check on, None for the same simulator. Without `config` columns are mapped as the run
    folder does, else they bear canonical names. `build` is the share of what engines of one type
    differ by that is taken for no effect: 0 where the simulator is of this very engine. Raises
    `DataError`, `ConfigError`, `ModelError`.
    """
    held_real, held_sim = heldout or (None, None)
    request = Request(
        Path(real),
        fspath(sim),
        config,
        None if held_real is None else Path(held_real),
        None if held_sim is None else fspath(held_sim),
        trust,
        build,
    )
    return diagnose_folders(request)


def diagnose_folders(request: Request, progress: Progress = silent) -> Answer:
    """Read the logs of a `Request` and diagnose; raises as `diagnose`."""
    began = time.perf_counter()
    progress(0, _STEPS, "reading")
    simulator, config = _opened(request)
    screening = screening_by(simulator.bundle, request.real)
    pairs = read_pairs(request.real, simulator.how, config, screening.faults)
    held = _held_pairs(request, simulator, config)
    check_apart(pairs, held)
    learned, warnings = _learned_of(request, simulator, progress)
    if learned is not None and request.build != 1.0:
        warnings.append("what the run gets wrong by itself is learned: --build has no effect")
    differences = NullModel(learned, request.build)
    answer = diagnose_pairs(
        pairs, held, simulator.again, differences, progress, doubts=screening.doubts
    )
    facts = {"simulator": simulator.kind, "wall_s": round(time.perf_counter() - began, 1)}
    quality = {**facts, **answer.document["quality"]}
    quality["warnings"] = [*warnings, *quality["warnings"]]
    return replace(answer, document={**answer.document, "quality": quality})


def _opened(request: Request) -> tuple[Simulator, RunConfig | None]:
    """The simulator, and how columns are mapped: as asked, else as a run folder does."""
    simulator = open_simulator(request.sim, trust=request.trust)
    if request.config is not None or simulator.bundle is None:
        return simulator, request.config
    return simulator, run_config(simulator.bundle)[0]


class Screening(NamedTuple):
    """What flights show to a run before any effect is weighed.

    `doubts`: the run learned from their samples, so that its errors there are not the engine's gap;
    or their columns or clock are not those of its training logs, which no effect of the library
    mends. `faults` are stretches of channels, by the names of logs (`pairs.log_name`).
    """

    doubts: Sequence[str] = ()
    faults: Mapping[str, Sequence[Finding]] = {}


def screening_by(bundle: Bundle | None, folder: Path) -> Screening:
    """What the logs of a folder show to a run; nothing without one."""
    if bundle is None or not bundle.record.config:
        return Screening()
    try:
        logs = evaluation_logs(bundle, files_in(folder))
    except NarxcalError:  # not in the form of the run's own logs
        return Screening()
    roles = {log.name: role_of(bundle, log)[0] for log in logs}
    known = ", ".join(name for name, role in roles.items() if role in ("train", "validate"))
    trained = f"the run was trained on samples of {known}: its errors there are no gap of an engine"
    misread = {  # of a file once: its engines have columns and clock in common
        (log.source.file, each.kind, each.channel): each.caution
        for log in reversed(logs)
        for each in log.findings
        if each.kind in _MISREAD and not each.local
    }
    faults: dict[str, list[Finding]] = {}
    for log in logs:
        name = log_name(Path(log.source.file), log.source.engine)
        faults.setdefault(name, []).extend(log.findings)
    return Screening([*([trained] if known else []), *reversed(misread.values())], faults)


def _held_pairs(request: Request, simulator: Simulator, config: RunConfig | None) -> list[Pair]:
    if request.held_real is None:
        return []
    if request.held_sim is not None:
        simulator = open_simulator(request.held_sim, trust=request.trust)
    elif isinstance(simulator.how, Path):
        raise DataError(
            "held-out flights need their simulated logs", hint="Name them by --heldout-sim"
        )
    faults = screening_by(simulator.bundle, request.held_real).faults
    return read_pairs(request.held_real, simulator.how, config, faults)


def _learned_of(
    request: Request, simulator: Simulator, progress: Progress
) -> tuple[Discrepancy | None, list[str]]:
    """What a run gets wrong by itself, learned now where nobody did, and what to say without it."""
    if simulator.bundle is None:
        return None, []
    run = Path(request.sim)
    found = learned_by(run)
    if found is not None:
        return found, []
    progress(1, _STEPS, "once per run: models without some of its flights")
    try:
        found = learn_left_out(run, trust=request.trust)
    except NarxcalError as error:
        text = f"what {run} gets wrong by itself is not known ({error}): tolerances are assumed"
        return None, [text]
    try:
        keep_learned(found, run)
    except ConfigError as error:
        return found, [f"what {run} gets wrong by itself is learned anew each time: {error}"]
    return found, []


def diagnose_pairs(  # noqa: PLR0913 - what is known of the pairs, each part by itself
    pairs: Sequence[Pair],
    held: Sequence[Pair] = (),
    again: Simulate | None = None,
    differences: NullModel = ASSUMED,
    progress: Progress = silent,
    *,
    doubts: Sequence[str] = (),
) -> Answer:
    """Diagnose pairs that are already read; `held` are flights that take no part.

    With `doubts` of the flights the answer is undetermined, and they are its reason.
    """
    data = batch(pairs)
    check_excitation(data, events_of(data))
    there = in_terms_of(data, batch(held)) if held else None
    progress(1, _STEPS, "emulator")
    emulator = choose_control(fit_emulators(data.flights), data)
    itself = None if again is None else Rerun(emulator, again, block_size(pairs[0].dt_s))
    progress(2, _STEPS, "effects")
    weights, phases = weigh(data, Engines(emulator, itself), differences), phases_of(data)
    found = concluded(weights, phases, [*doubts, *implausible(data)])
    progress(3, _STEPS, "where, and how far the gap shrinks")
    stand_in: Emulator = itself or emulator
    flown = data.flights
    evidence = _evidence(data, found, emulator, stand_in)
    if found.claimed and (refused := _refused(evidence, weights.frame)):
        found = concluded(weights, phases, refused=refused)
        evidence = _evidence(data, found, emulator, stand_in)
    data = evidence.data
    if there is not None and rests_on_emulator(found.claimed, again=again is not None):
        # What the effects do in these flights, the simulator's own logs of them know best.
        emulator = widened(emulator, together(flown, there.flights))
        itself = itself and replace(itself, emulator=emulator)
        evidence = _with_held_out(evidence, there, itself or emulator, emulator)
    elif there is not None:
        evidence = _with_held_out(evidence, there, stand_in)
    facts = facts_of(pairs, data, held)
    facts["warnings"] = [*doubts, *facts["warnings"]]
    facts["warnings"] += coarse_emulator(evidence, again=again is not None)
    evidence = replace(evidence, facts=facts, emulator=emulator)
    return Answer(document(evidence, pairs), evidence)


def _refused(evidence: Evidence, frame: Frame) -> str:
    """Why effects are no answer that take nothing off flights, or parts of few, that did not fit.

    The lower end of what they take has to be more than what is left in one independent sample.
    """
    found = evidence.budget
    change = evidence.after - evidence.data.flights.y
    taken = taken_off(frame, change if found.by_others is None else change + found.by_others)
    if taken.low * frame.whole > frame.none.tau:
        return ""
    names = listed([in_words(name) for name in found.claimed])
    ends = f"{percent(taken.low)} to {percent(taken.high)}"
    return f"the best candidate is {names}, which takes {ends} off what did not fit it"


def _evidence(
    data: Record, found: Budget, emulator: GreyBoxEmulator, stand_in: Emulator
) -> Evidence:
    if found.on is not None:
        data = replace(data, flights=with_load(data.flights, found.on.astype(float)))
    values = found.claimed
    after = with_effects(values, data.flights, stand_in)
    where = locate(data, after - data.flights.y)
    then = time_errors(data, after, where.events) if values else where.times
    return Evidence(
        data,
        found,
        where,
        after,
        time_shrink(where.times, then),
        expected(seen(data, after, found.by_others)) if values else _NOTHING,
        channel_shrink(data, after),
        emulator,
        _errors(emulator, data),
    )


def _errors(emulator: GreyBoxEmulator, data: Record) -> dict[str, float]:
    errors = emulator.errors(data.flights).tolist()
    return dict(zip(data.flights.signals.outputs, errors, strict=True))


def _with_held_out(
    evidence: Evidence,
    data: Record,
    stand_in: Emulator,
    checked: GreyBoxEmulator | None = None,
) -> Evidence:
    """Add what the effects do in further flights, and errors there of an emulator `checked`."""
    found = evidence.budget
    if UNLOGGED_SWITCH.id in found.claimed:
        data = _with_windows(found.claimed, data, stand_in)
    there = held_out(found.claimed, data, stand_in)
    if checked is not None:
        there = replace(there, emulator_rmse=_errors(checked, data))
    events = events_of(data)
    before = time_errors(data, data.flights.y, events)
    after = time_errors(data, there.after, events) if found.claimed else before
    evidence = replace(evidence, held_out=there, times=time_shrink(before, after))
    # Windows of a load in further flights are found in what was recorded: no prediction.
    if not found.claimed or UNLOGGED_SWITCH.id in found.claimed:
        return evidence
    here = seen(evidence.data, evidence.after, found.by_others)
    return replace(evidence, predicted=expected(here, unseen(data, there.after)))


def _with_windows(values: Values, data: Record, emulator: Emulator) -> Record:
    """Further flights with the windows in which the claimed load was on there.

    The gap of these flights gives the windows, the claim the size.
    """
    others = {name: each for name, each in values.items() if name != UNLOGGED_SWITCH.id}
    y = with_effects(others, data.flights, emulator)
    record = replace(data, flights=replace(data.flights, y=y))
    metric = Metric(record, assumed_variance(record))
    frame = Frame(record, metric, record.gap, nuisances(record))
    on = windows_of(frame, shift_of(values, data.flights.signals)).astype(float)
    return replace(data, flights=with_load(data.flights, on, always=True))


def learn_folders(request: Request, run: Path) -> Discrepancy:
    """Learn what a simulator gets wrong by itself, and keep it in the folder of a run.

    `request` names flights and a simulator that was identified without them; `run` is a run of the
    same kind that is to be diagnosed with, on further flights. Raises as `diagnose_folders`.
    """
    simulator, config = _opened(request)
    found = learned_from(read_pairs(request.real, simulator.how, config))
    keep_learned(found, run)
    return found
