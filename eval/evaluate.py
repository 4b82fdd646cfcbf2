"""Evaluate a calibration on logs: free-run errors, Ti and Tt of every event, one verdict.

`assess_log` makes a `LogEvaluation` of one log; an `Evaluation` pools them. `Evaluation.outcome`
is the only place where pass or fail is decided: terminal, page, JSON and exit code show it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Final

import numpy as np
from pydantic import Field

from data_prep.events import Event, find_events
from data_prep.grid import joined
from data_prep.identity import Identity, Shared, first_shared
from data_prep.log import Finding, Log, Source
from data_prep.plausibility import unchecked_air
from data_prep.prepare import prepare, with_outputs
from data_prep.reading import read_logs
from eval.evidence import (
    Count,
    ErrorCheck,
    contradictions,
    counts,
    error_checks,
    judged_shares,
    too_few,
    trained_words,
    why_not_judged,
)
from eval.free_run import (
    ARX,
    BASELINES,
    FIRST_ORDER,
    MODEL,
    NETWORK,
    STEADY_STATE,
    FreeRun,
    run_log,
    trimmed,
)
from eval.outcome import Outcome, plural
from eval.scores import ChannelScores, score
from eval.transients import (
    AssessedEvent,
    Assessment,
    Overlay,
    Tally,
    TransientsConfig,
    assess_events,
    assessed,
    not_assessable,
    tally,
)
from eval.trim import TrimConfig, rows_for_trim
from narxcal.calibration.bundle import Bundle
from narxcal.calibration.certificate import Certificate, certificate_of
from narxcal.channels import symbol
from narxcal.steady.model import Envelope, SteadyStateModel
from narxcal.support.errors import ConfigError, DataError, ModelError
from narxcal.support.files import finite
from narxcal.support.progress import Progress, silent
from narxcal.support.settings import Section
from training.config import RunConfig
from training.folds import CrossvalConfig
from training.levels import LEAST_LOGS, LevelCheck, checks, words
from training.records import split_logs
from training.redundancy import Bank
from training.screening import screened

SCHEMA = "narxcal.evaluate/1"
NEW = "new"
_MANY_OUTSIDE = 0.1  # share of a log's samples outside the envelope from which on it is reported


class EvaluateConfig(Section):
    """Table [evaluate]: how events are judged, what trim may assume, what has to be reached.

    `crossval` says which divisions cross-validation makes.

    `least_passed_pct` of the assessed events have to pass. `largest_rmse` (channel -> value in
    its unit) bounds the RMSE pooled over the logs; none is bounded by default. `least_events`
    pushes and pulls and `least_judged_pct` of each output are the least evidence of a pass
    (`eval.evidence`).
    """

    transients: TransientsConfig = TransientsConfig()
    trim: TrimConfig = TrimConfig()
    crossval: CrossvalConfig = CrossvalConfig()
    least_passed_pct: float = Field(default=95.0, ge=0.0, le=100.0)
    largest_rmse: Mapping[str, float] = Field(default_factory=dict)
    least_events: int = Field(default=3, ge=0)
    least_judged_pct: float = Field(default=90.0, ge=0.0, le=100.0)


@dataclass(frozen=True, eq=False)
class LogEvaluation:
    """One log: its free run, scores per channel, events with their assessments.

    `role` is what the bundle used the log for: train, validate, test, or new to it; `shared` says
    which of its logs this one holds samples of.
    `untrimmed` are the scores on the same rows before trim, where there was one. `baselines` are
    the baselines' Ti/Tt counts on the same events. `as_recorded` are the scores on the log before
    its faults were masked, where there are some, and `faulty` the share of each channel's samples
    that was masked so. `levels` compare level and lag of the free run with those of held-out logs,
    `errors` its RMSE. `judged` is the share of each output that the figures rest on.
    """

    run: FreeRun
    role: str
    scores: Mapping[str, ChannelScores]
    events: tuple[AssessedEvent, ...]
    baselines: Mapping[str, Tally]
    untrimmed: Mapping[str, ChannelScores] = field(default_factory=dict)
    as_recorded: Mapping[str, ChannelScores] = field(default_factory=dict)
    faulty: Mapping[str, float] = field(default_factory=dict)
    levels: tuple[LevelCheck, ...] = ()
    shared: Shared | None = None
    judged: Mapping[str, float] = field(default_factory=dict)
    errors: tuple[ErrorCheck, ...] = ()

    @property
    def log(self) -> Log:
        """The prepared log, masked samples still NaN."""
        return self.run.log

    @property
    def assessments(self) -> list[Assessment]:
        """Those of all events, event by event."""
        return [each for event in self.events for each in event.assessments]

    def row(self) -> dict[str, Any]:
        """One entry of `logs` in `evaluate.json`."""
        run, log = self.run, self.log
        channels = {name: figures.row() for name, figures in self.scores.items()}
        for name, before in self.untrimmed.items():
            channels[name]["untrimmed_rmse"] = before.rmse
        for name, with_faults in self.as_recorded.items():
            channels[name]["as_recorded_rmse"] = with_faults.rmse
        return {
            "log": log.name,
            "role": self.role,
            "file": log.source.file,
            "sha256": log.source.sha256,
            "samples": len(log),
            "dt_s": log.dt_s,
            "channels": channels,
            "events": [each.row() for each in self.assessments],
            "ti_tt": tally_row(self.assessments),
            "levels": [each.row() for each in self.levels],
            "errors": [{**asdict(each), "ok": each.ok} for each in self.errors],
            "judged_share": dict(self.judged),
            "holds": None if self.shared is None else _shared_row(self.shared),
            "baselines": {name: baseline.row() for name, baseline in self.baselines.items()},
            "masked": {
                channel: {"samples": sum(reasons.values()), "reasons": reasons}
                for channel, reasons in log.audit.masked().items()
            },
            "inputs": {
                "held_samples": int(np.count_nonzero(~run.inputs_known)),
                "faulty_share": dict(self.faulty),
                "unchecked": list(unchecked_air(log)),
                "outside_envelope_share": float(np.mean(~run.in_envelope)),
                "quasi_steady_share": float(np.mean(run.quasi_steady)),
            },
            "trim": self._trim_row(),
        }

    def _trim_row(self) -> dict[str, Any] | None:
        trim, names = self.run.trim, self.run.channels
        if trim is None:
            return None
        return {
            "scored_from_s": float(self.log.time_s[min(trim.until, len(self.log) - 1)]),
            "levels": trim.nodes.tolist(),
            "altitudes_ft": trim.altitudes_ft.tolist(),
            "offsets": dict(zip(names, np.moveaxis(trim.offsets, 2, 0).tolist(), strict=True)),
            "samples": dict(zip(names, trim.samples, strict=True)),
        }


def _shared_row(shared: Shared) -> dict[str, Any]:
    share, from_s, to_s = shared.overlap
    return {"log": shared.other, "share": share, "from_s": from_s, "to_s": to_s}


def tally_row(assessments: Sequence[Assessment]) -> dict[str, Any]:
    """Counts over all, then per channel and per direction, and why events were not assessed."""
    channels = dict.fromkeys(each.channel for each in assessments)
    return {
        **tally(assessments).row(),
        "channels": {
            name: tally([each for each in assessments if each.channel == name]).row()
            for name in channels
        },
        "push": tally([each for each in assessments if each.label == 0]).row(),
        "pull": tally([each for each in assessments if each.label == 1]).row(),
        "not_assessable_reasons": not_assessable(assessments),
    }


def assess_log(
    bundle: Bundle,
    log: Log,
    settings: EvaluateConfig,
    *,
    trim: float | None = None,
    events: Sequence[Event] | None = None,
) -> LogEvaluation:
    """Run and score one prepared log; `events` are those to judge where they are already found.

    An output that the log lacks has no figures, and no event waits for it to settle. Raises
    `DataError` as `eval.free_run.run_log`, `ConfigError` for a trim outside of 0 to 1.
    """
    config, _ = run_config(bundle)
    outputs = bundle.calibration.output_names
    recorded = with_outputs(log, outputs)
    log = recorded.without_faults()
    role, shared = role_of(bundle, recorded)
    run = run_log(bundle, config, log, recorded)
    if events is None:
        events = find_events(log, config.events.for_log(log, outputs))
    faulty = masked_shares(recorded, log, (*outputs, *bundle.calibration.input_names))
    untrimmed: Mapping[str, ChannelScores] = {}
    if trim is not None:
        until = rows_for_trim(trim, len(log))
        untrimmed = score([replace(run, scored_from=until)])
        run = trimmed(run, until, settings.trim)
        events = [event for event in events if event.start >= until]
    scores = score([run])
    return LogEvaluation(
        run=run,
        role=role,
        scores=scores,
        events=assessed(events, overlay_of(run, MODEL), settings.transients),
        baselines={
            name: tally(assess_events(events, overlay_of(run, name), settings.transients))
            for name in BASELINES
            if name in run.outputs
        },
        untrimmed=untrimmed,
        as_recorded=score([run_log(bundle, config, recorded)]) if faulty else {},
        faulty=faulty,
        levels=_levels(bundle, run),
        shared=shared,
        judged=judged_shares(run, outputs),
        errors=tuple(
            error_checks(bundle.record, run, {name: one.rmse for name, one in scores.items()})
        ),
    )


def _levels(bundle: Bundle, run: FreeRun) -> tuple[LevelCheck, ...]:
    """Level and lag of the scored rows, compared with training logs that were held out."""
    measured = np.where(run.scored[:, None], run.measured, np.nan)
    return checks(bundle.record.weighed.channels, run.channels, (run.model, measured), run.log.dt_s)


def overlay_of(run: FreeRun, name: str) -> Overlay:
    """Flight and one model of a free run, as events are judged on."""
    model = run.outputs[name]
    return Overlay(run.log.time_s, run.measured, model, run.channels, run.inputs_known)


def role_of(bundle: Bundle, log: Log) -> tuple[str, Shared | None]:
    """What the bundle did with a log of these samples, under whatever name."""
    known = {(one.log, one.engine): one for one in bundle.record.identities}
    others = (
        (one.log, Source(one.file, one.sha256, one.engine), Identity.from_json(one.model_dump()))
        for one in known.values()
    )
    shared = first_shared(log, others)
    if shared is not None:
        return next(one.role for one in known.values() if one.log == shared.other), shared
    if log.source.sha256 not in bundle.record.data.values():
        return NEW, None
    split = bundle.record.split
    named = next((role for role in split if log.name in split[role]), None)
    # Of an older run the bytes alone are known: whatever their name, they may have been learned.
    return named or (NEW if known else "train"), None


@dataclass(frozen=True, eq=False)
class Evaluation:
    """All logs and what they have to reach; `mixture` says of which models.

    `certificate` says whether the model settles at constant inputs.
    """

    logs: tuple[LogEvaluation, ...]
    config: EvaluateConfig
    trim: float | None = None
    mixture: tuple[str, ...] = ()
    certificate: Certificate | None = None

    @property
    def assessments(self) -> list[Assessment]:
        """Those of all logs."""
        return [each for log in self.logs for each in log.assessments]

    @property
    def tally(self) -> Tally:
        """Ti/Tt over all logs and channels."""
        return tally(self.assessments)

    @cached_property
    def pooled(self) -> dict[str, ChannelScores]:
        """Scores per channel over all logs as one recording."""
        return score([log.run for log in self.logs])

    def missed(self) -> list[str]:
        """Each requirement that is not met; empty if the evaluation is passed.

        Raises `ConfigError` for a bound on a channel that the model does not give.
        """
        return [*self.failed(), *self.lacking()]

    def failed(self) -> list[str]:
        """What is wrong with the model, as far as these logs tell."""
        return [
            *self._hunting(),
            *self._failed_times(),
            *self._wrong_levels(),
            *self._large_errors(),
            *self._unusual_errors(),
        ]

    def _hunting(self) -> list[str]:
        """Say that the model does not settle at constant inputs."""
        found = self.certificate
        return [] if found is None or found.settled else [f"The model {found.words}"]

    def lacking(self) -> list[str]:
        """What a verdict needs and these logs do not give."""
        return [
            *self._trained_on(),
            *self._contradictions(),
            *self._not_judged(),
            *self._too_few_events(),
        ]

    def _trained_on(self) -> list[str]:
        return [
            trained_words(one.log.name, one.role, one.shared)
            for one in self.logs
            if one.role in {"train", "validate"}
        ]

    def _contradictions(self) -> list[str]:
        return [text for one in self.logs for text in contradictions(one.log, one.run.channels)]

    def _not_judged(self) -> list[str]:
        """Outputs of which too little is judged, in one count over cleaning, faults and gaps."""
        least = self.config.least_judged_pct
        return [
            f"{one.log.name}: {name} is not assessable, {100.0 * share:.0f} % of it is judged "
            f"({why_not_judged(one.log, name)}), at least {least:g} % have to be"
            for one in self.logs
            for name, share in one.judged.items()
            if 100.0 * share < least
        ]

    def _unusual_errors(self) -> list[str]:
        """Outputs with a larger error than the held-out logs allow, unless a bound is set."""
        bounded = self.config.largest_rmse
        return [
            f"{one.log.name}: {each.words}"
            for one in self.logs
            for each in one.errors
            if each.ok is False and each.channel not in bounded
        ]

    def _too_few_events(self) -> list[str]:
        """Engines with fewer events than a verdict takes, or none with the reason.

        `least_passed_pct = 0` demands no transients where errors are bounded instead.
        """
        if self.config.least_passed_pct == 0.0 and self.config.largest_rmse:
            return []
        texts = []
        for engine in dict.fromkeys(one.log.source.engine for one in self.logs):
            own = [one for one in self.logs if one.log.source.engine == engine]
            found = [each for one in own for each in one.assessments]
            whose = f"Ti/Tt of engine {engine}" if engine else "Ti/Tt"
            if not any(each.verdict.ok is not None for each in found):
                reasons = not_assessable(found)
                most = max(reasons, key=lambda name: reasons[name], default="no event was found")
                texts.append(f"{whose}: no transient could be assessed ({most})")
                continue
            channels = [
                name for name in self.config.transients.channels if name in own[0].run.channels
            ]
            texts += too_few(counts(found, channels), self.config.least_events, whose)
        return texts

    @property
    def counts(self) -> list[Count]:
        """Transients by channel and direction."""
        channels = dict.fromkeys(name for one in self.logs for name in one.run.channels)
        judged = [name for name in self.config.transients.channels if name in channels]
        return counts(self.assessments, judged)

    @property
    def findings(self) -> list[Finding]:
        """Those of all logs."""
        return [each for log in self.logs for each in log.log.findings]

    def _failed_times(self) -> list[str]:
        found, least = self.tally, self.config.least_passed_pct
        if found.passed_pct is None or found.passed_pct >= least:
            return []
        share = f"({found.passed_pct:.1f} %), at least {least:g} % have to"
        return [f"Ti/Tt: {found.passed} of {found.assessed} transients pass {share}"]

    def _wrong_levels(self) -> list[str]:
        """Outputs whose level is beyond the spread of the held-out training logs."""
        return [
            f"{one.log.name}: level error of {words(each)}, {each.allowed:.3g} is the spread of "
            f"{each.held_out_logs} held-out training logs"
            for one in self.logs
            for each in one.levels
            if each.ok is False
        ]

    @property
    def level_cautions(self) -> list[str]:
        """Levels that can't be judged, with their sizes, and lags beyond the spread."""
        found = self._open_levels()
        for one in self.logs:
            found += [
                f"{one.log.name}: {each.channel} is {abs(each.lag_s):.2g} s "
                f"{'late' if each.lag_s > 0.0 else 'early'} over the whole log, "
                f"{each.allowed_lag_s:.2g} s is the spread of held-out training logs"
                for each in one.levels
                if each.late
            ]
        return found

    def _open_levels(self) -> list[str]:
        """Levels that can't be judged in one line: of several logs the largest of each output."""
        logs = [one for one in self.logs if any(each.open for each in one.levels)]
        if not logs:
            return []
        largest: dict[str, LevelCheck] = {}
        for each in (level for one in logs for level in one.levels if level.open):
            before = largest.get(each.channel, each)
            largest[each.channel] = max(before, each, key=lambda level: abs(level.error))
        more = f" and {len(logs) - 1} more" if len(logs) > 1 else ""
        size = f"of {'up to ' if more else ''}{', '.join(map(words, largest.values()))}"
        few = f"fewer than {LEAST_LOGS} training logs were held out"
        return [f"{logs[0].log.name}{more}: level error {size} is not judged: {few}"]

    def _large_errors(self) -> list[str]:
        texts = []
        for name, bound in self.config.largest_rmse.items():
            pooled = self.pooled
            if name not in pooled:
                raise ConfigError(
                    "[evaluate.largest_rmse] bounds a channel that the model does not give",
                    channel=name,
                    hint=f"It gives {', '.join(pooled)}",
                )
            if math.isnan(pooled[name].rmse):
                texts.append(f"{name}: no sample to judge by, at most RMSE {bound:g} allowed")
            elif not pooled[name].rmse <= bound:
                texts.append(f"{name}: RMSE {pooled[name].rmse:.3g}, at most {bound:g} allowed")
        return texts

    @property
    def outcome(self) -> Outcome:
        """The verdict: what is missed, then what was counted, then how the baselines do."""
        failed, lacking, found = self.failed(), self.lacking(), self.tally
        passed = False if failed else None if lacking else True
        baselines = tuple(_against_baselines(one) for one in self.logs)
        lines = tuple(f"{text.rstrip('.')}." for text in (*failed, *lacking))
        if not found.assessed:
            headline = "No event could be assessed for Ti and Tt"
            return Outcome(passed, headline, (*lines, *baselines))
        share = 100.0 * found.passed / found.assessed
        headline = (
            f"{found.passed} of {found.assessed} assessable transients ({share:.0f} %) meet the "
            f"'{self.config.transients.rules}' rules for Ti and Tt"
        )
        whole = [ok for log in self.logs for event in log.events if (ok := event.ok) is not None]
        said = [f"{sum(whole)} of {plural(len(whole), 'event')} pass in every channel."]
        if found.not_assessable:
            said.append(
                f"{plural(found.not_assessable, 'transient')} could not be assessed and count "
                "neither way."
            )
        return Outcome(passed, headline, (*lines, *said, *self._evidence_words(), *baselines))

    def _evidence_words(self) -> list[str]:
        """What the verdict rests on, in sentences."""
        each = ", ".join(
            f"{symbol(one.channel)} {one.passed} of {one.assessed} {one.direction}"
            f"{'es' if one.direction == 'push' else 's'}"
            for one in self.counts
        )
        share = min((share for one in self.logs for share in one.judged.values()), default=0.0)
        new = sum(one.role in {NEW, "test"} for one in self.logs)
        least = min((one.at_least_pct for one in self.counts), default=0.0)
        text = (
            f"Evidence: {plural(new, 'new log')}, {each}; with 90 % confidence at least "
            f"{least:.0f} % of such transients pass; at least {100.0 * share:.0f} % of each "
            "output of each log is judged."
        )
        return [text]

    def document(self) -> dict[str, Any]:
        """`evaluate.json`; None where a figure does not exist."""
        used, missed = self.config.transients.rule_set, self.missed()
        found: dict[str, Any] = finite(
            {
                "schema": SCHEMA,
                "ok": not missed,
                "missed": missed,
                "least_passed_pct": self.config.least_passed_pct,
                "evidence": {
                    "new_logs": sum(one.role in {NEW, "test"} for one in self.logs),
                    "least_events": self.config.least_events,
                    "least_judged_pct": self.config.least_judged_pct,
                    "transients": [each.row() for each in self.counts],
                    "lacking": self.lacking(),
                },
                "trim": self.trim,
                "findings": [each.row() for each in self.findings],
                "certificate": None if self.certificate is None else self.certificate.row(),
                "rules": {
                    "name": used.name,
                    "source": used.source,
                    "tt_origin": used.tt_origin,
                    "data_source": self.config.transients.data_source,
                },
                "logs": [log.row() for log in self.logs],
                "pooled": {
                    "channels": {name: one.row() for name, one in self.pooled.items()},
                    "ti_tt": tally_row(self.assessments),
                },
            }
        )
        return found


_MODELS: Final = {
    NETWORK: "lags with the network",
    "lags": "lags alone",
    STEADY_STATE: "the steady state",
    FIRST_ORDER: "a first-order lag",
    ARX: "an ARX model",
    "output_error": "an output-error model",
}


def mixture_sentences(bundle: Bundle) -> tuple[str, ...]:
    """Of which models the outputs are mixed, and the errors that their weights rest on."""
    found = []
    for name, stored in bundle.record.weighed.channels.items():
        if stored.ordered == [(NETWORK, 1.0)]:
            continue
        errors = stored.held_out_rmse
        parts = [
            f"{weight:.2f} {_MODELS.get(model, model)}"
            + (f" ({errors[model]:.3g} held out)" if errors.get(model) is not None else "")
            for model, weight in stored.ordered
        ]
        found.append(f"{symbol(name)} is {', '.join(parts)}.")
    return tuple(found)


def _against_baselines(one: LogEvaluation) -> str:
    """In which channels the model beats every baseline, and in which it does not."""
    best = {name: (found.rmse, found.best_rmse) for name, found in one.scores.items()}
    won = [symbol(name) for name, (own, least) in best.items() if own == least]
    lost = [symbol(name) for name, (own, least) in best.items() if own > least]
    text = f"{one.log.name}: lowest free-run RMSE of all models in {', '.join(won) or 'no channel'}"
    return f"{text}; a baseline does better in {', '.join(lost)}." if lost else f"{text}."


def run_config(bundle: Bundle) -> tuple[RunConfig, EvaluateConfig]:
    """The configuration stored in a bundle; `ModelError` where there is none."""
    stored = bundle.record.config
    if not stored:
        raise ModelError(
            "the bundle does not say how its logs were prepared", hint="Train it with narxcal train"
        )
    config = RunConfig.parse(stored, "bundle.json")
    return config, EvaluateConfig.parse(config.evaluate, "bundle.json, [evaluate]")


def evaluation_logs(bundle: Bundle, files: Sequence[Path] | None = None) -> list[Log]:
    """Read `files` with the column mapping of the bundle, cleaned and smoothed as for training.

    Without `files`, the configured test logs (all configured ones where the split leaves none).
    Masked inputs and outputs that a file lacks stay NaN. Raises `DataError` for a file without any
    output.
    """
    config, _ = run_config(bundle)
    return screened(bank_of(bundle), _prepared(bundle, config, files))


def recorded_logs(bundle: Bundle, files: Sequence[Path]) -> list[Log]:
    """As `evaluation_logs`, on the same rows, but not smoothed and not screened for faults."""
    config, _ = run_config(bundle)
    return _prepared(bundle, config.having(smooth={"window": 1}), files)


def _prepared(bundle: Bundle, config: RunConfig, files: Sequence[Path] | None) -> list[Log]:
    outputs = bundle.calibration.output_names
    reading = config.logs.for_inputs(bundle.calibration.input_names)
    reading = reading.every(bundle.calibration.dt_s)
    chosen: Sequence[Log]
    if files is not None:
        chosen = read_logs(list(files), reading)
    else:
        logs = read_logs(config.logs.resolve(Path(bundle.record.base)), reading)
        chosen = split_logs(logs, config.split).test or logs
    prepared = joined([one.log for one in prepare(chosen, config)])
    return [with_outputs(log, outputs) for log in prepared]


def file_findings(bundle: Bundle, file: Path) -> tuple[Finding, ...]:
    """What the logs in a file show; raises `DataError` as `evaluation_logs`.

    Raises `DataError`, too, for an input of the model that is at fault throughout.
    """
    logs = evaluation_logs(bundle, [file])
    found = tuple(each for log in logs for each in log.findings)
    for log in logs:
        after = log.without_faults()
        for name in bundle.calibration.input_names:
            if name in log.channels and log.recorded([name]) and not after.recorded([name]):
                why = next(each for each in log.findings if name in each.channels)
                raise DataError(
                    f"an input of the model is at fault throughout ({why.kind}: {why.evidence})",
                    file=log.name,
                    channel=name,
                    hint="Correct its column or unit under [logs.columns], or repair the log",
                )
    return found


def bank_of(bundle: Bundle) -> Bank | None:
    """The bank that the bundle's training logs taught; None for a bundle without one."""
    stored = bundle.record.redundancy
    return Bank.from_json(stored) if stored else None


def masked_shares(recorded: Log, log: Log, names: Sequence[str]) -> dict[str, float]:
    """Channel -> share of its recorded samples that are masked in `log`, where any are."""
    shares = {}
    for name in dict.fromkeys(names):
        before, after = (np.isfinite(one[name]).sum() for one in (recorded, log))
        if after < before:
            shares[name] = float(1.0 - after / before)
    return shares


def evaluate(
    bundle: Bundle,
    logs: Sequence[Log],
    trim: float | None = None,
    settings: EvaluateConfig | None = None,
    progress: Progress = silent,
) -> Evaluation:
    """Evaluate prepared logs; with `trim`, that share of each log is used up for offsets.

    Raises `DataError` for logs that the model cannot be run on, `ConfigError` for a trim
    outside of 0 to 1.
    """
    settings = settings or run_config(bundle)[1]
    found = []
    for number, log in enumerate(logs):
        progress(number, len(logs), log.name)
        found.append(assess_log(bundle, log, settings, trim=trim))
    return Evaluation(tuple(found), settings, trim, mixture_sentences(bundle), certificate(bundle))


def certificate(bundle: Bundle) -> Certificate:
    """Whether the model settles at constant inputs, as stored or as found now."""
    return certificate_of(bundle.calibration, bundle.record.certificate)


def outside_envelopes(bundle: Bundle, found: Evaluation) -> list[str]:
    """Warnings of logs outside the envelope of their engine's steady-state model."""
    own = (bundle.calibration.for_engine(one.log.source.engine, or_mean=True) for one in found.logs)
    pairs = zip(found.logs, own, strict=True)
    texts = (outside_envelope(one.run, calibration.steady) for one, calibration in pairs)
    return [text for text in texts if text]


def outside_envelope(run: FreeRun, steady: SteadyStateModel) -> str:
    """Warn of a log with more than 10 % of its samples outside the envelope of `steady`.

    `steady` is that of the log's engine. Names the inputs and their ranges where the envelope is
    a box; empty for a log that is inside.
    """
    outside, known = run.inputs_known & ~run.in_envelope, run.inputs_known
    if outside.sum() <= _MANY_OUTSIDE * known.sum():
        return ""
    return (
        f"{run.log.name}: {100.0 * outside.sum() / known.sum():.0f} % of the samples are outside "
        f"the envelope of the steady-state model{_by_inputs(run, steady)}"
    )


def _by_inputs(run: FreeRun, steady: SteadyStateModel) -> str:
    box = getattr(steady, "envelope", None)
    if not isinstance(box, Envelope):
        return ""
    ranges = []
    for name, low, high in zip(steady.input_names, box.low, box.high, strict=True):
        values = run.log[name][run.inputs_known]
        if np.mean((values < low) | (values > high)) > _MANY_OUTSIDE:
            ranges.append(
                f"{name} is {values.min():.5g} to {values.max():.5g}, "
                f"the envelope {low:.5g} to {high:.5g}"
            )
    return f" ({'; '.join(ranges)})" if ranges else ""
