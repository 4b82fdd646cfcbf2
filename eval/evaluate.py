"""`narxcal evaluate`: free-run errors, Ti and Tt of every event, baselines on the same rows.

One log under judgement: its runs, its figures and its events, with what they are judged by.

Rows of `evaluate.json`: values that JSON can hold, None where a figure does not exist.

What to say of a log that the steady-state model was not made for.
"""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import Field

from data_prep.events import Event, find_events
from data_prep.log import Log
from data_prep.prepare import prepare, with_outputs
from data_prep.reading import read_logs
from eval.free_run import BASELINES, MODEL, Runs, run_log, trimmed
from eval.rules import rules as rules_of
from eval.scores import ChannelScores, score
from eval.tally import Tally, tally
from eval.transients import Assessment, Overlay, TransientsConfig, assess_events
from eval.trim import Trim, TrimConfig, rows_for_trim
from narxcal.calibration.bundle import Bundle
from narxcal.steady.model import Envelope, SteadyStateModel
from narxcal.support.errors import ConfigError, ModelError
from narxcal.support.settings import Section
from training.config import RunConfig
from training.crossval import CrossvalConfig
from training.records import split_logs

NEW = "new"


class EvaluateConfig(Section):
    """Table [evaluate]: how events are judged, what trim may assume, what has to be reached.

    `crossval` says which divisions cross-validation makes.

    `least_passed_pct` of the assessed events have to pass. `largest_rmse` (channel -> value in
    its unit) bounds the RMSE pooled over the logs; none is bounded by default.
    """

    transients: TransientsConfig = TransientsConfig()
    trim: TrimConfig = TrimConfig()
    crossval: CrossvalConfig = CrossvalConfig()
    least_passed_pct: float = Field(default=95.0, ge=0.0, le=100.0)
    largest_rmse: Mapping[str, float] = Field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class LogEvaluation:
    """One log: its runs, scores per channel, events with their assessments.

    `role` says what the bundle did with the log: train, validate, test, or new to it.
    `untrimmed` are the scores on the same rows before trim, where there was one. `rivals` are
    the baselines' Ti/Tt counts on the same events.
    """

    runs: Runs
    role: str
    scores: Mapping[str, ChannelScores]
    events: tuple[Event, ...]
    assessments: tuple[Assessment, ...]
    rivals: Mapping[str, Tally]
    untrimmed: Mapping[str, ChannelScores]

    @property
    def log(self) -> Log:
        """The prepared log, masked samples still NaN."""
        return self.runs.log


@dataclass(frozen=True)
class Task:
    """How one log is judged; `events` are those to judge where they are already found."""

    settings: EvaluateConfig
    trim: float | None = None
    events: Sequence[Event] | None = None


def judge_log(bundle: Bundle, config: RunConfig, log: Log, task: Task) -> LogEvaluation:
    """Run and score one prepared log; raises `DataError` as `eval.free_run.run_log`.

    An output that the log lacks has no figures, and no event waits for it to settle.
    """
    settings, outputs = task.settings, bundle.calibration.output_names
    log = with_outputs(log, outputs)
    runs, untrimmed = run_log(bundle, config, log), {}
    responses = config.events.for_log(log, outputs)
    events = find_events(log, responses) if task.events is None else task.events
    if task.trim is not None:
        until = rows_for_trim(task.trim, len(log))
        runs, as_is = trimmed(runs, until, settings.trim), runs
        untrimmed = score([_from_row(as_is, until)])
        events = [event for event in events if event.start >= until]
    return LogEvaluation(
        runs=runs,
        role=_role(bundle, log),
        scores=score([runs]),
        events=tuple(events),
        assessments=tuple(_assess(runs, MODEL, events, settings)),
        rivals={
            name: tally(_assess(runs, name, events, settings))
            for name in BASELINES
            if name in runs.outputs
        },
        untrimmed=untrimmed,
    )


def _from_row(runs: Runs, until: int) -> Runs:
    return Runs(
        runs.log,
        runs.channels,
        runs.measured,
        runs.outputs,
        runs.known,
        runs.still,
        runs.inside,
        runs.level,
        until,
    )


def _assess(
    runs: Runs, name: str, events: Sequence[Event], settings: EvaluateConfig
) -> list[Assessment]:
    overlay = Overlay(
        time_s=runs.log.time_s,
        flight=runs.measured,
        model=runs.outputs[name],
        channels=runs.channels,
        inputs_known=runs.known,
    )
    return assess_events(events, overlay, settings.transients)


def _role(bundle: Bundle, log: Log) -> str:
    """What the bundle did with a log of these bytes and this name."""
    if log.source.sha256 not in dict(bundle.meta.get("data", {})).values():
        return NEW
    split = bundle.meta.get("split", {})
    return next((role for role in split if log.name in split[role]), NEW)


# What was measured in one event; reasons that differ in nothing else are counted together.
_MEASURED = re.compile(r"-?\d+(\.\d+)?(e[+-]?\d+)?")


def log_row(one: LogEvaluation) -> dict[str, Any]:
    """One entry of `logs`."""
    runs = one.runs
    channels = {}
    for name, figures in one.scores.items():
        channels[name] = figures.row()
        if name in one.untrimmed:
            channels[name]["untrimmed_rmse"] = one.untrimmed[name].row()["rmse"]
    return {
        "log": one.log.name,
        "role": one.role,
        "file": one.log.source.file,
        "sha256": one.log.source.sha256,
        "samples": len(one.log),
        "dt_s": one.log.dt_s,
        "channels": channels,
        "events": [each.row() for each in one.assessments],
        "ti_tt": tally_rows(one.assessments),
        "baselines": {name: rival.row() for name, rival in one.rivals.items()},
        "masked": _masked_rows(one.log),
        "inputs": {
            "held_samples": int(np.count_nonzero(~runs.known)),
            "outside_envelope_share": float(np.mean(~runs.inside)),
            "quasi_steady_share": float(np.mean(runs.still)),
        },
        "trim": _trim_row(runs, one.log),
    }


def tally_rows(assessments: Sequence[Assessment]) -> dict[str, Any]:
    """Counts over all, then per channel and per direction, and why events were not assessed."""
    channels = list(dict.fromkeys(each.channel for each in assessments))
    reasons = Counter(
        _MEASURED.sub("..", str(each.verdict.reason), count=1)
        for each in assessments
        if each.verdict.ok is None
    )
    return {
        **tally(assessments).row(),
        "channels": {
            name: tally([each for each in assessments if each.channel == name]).row()
            for name in channels
        },
        "push": tally([each for each in assessments if each.label == 0]).row(),
        "pull": tally([each for each in assessments if each.label == 1]).row(),
        "not_assessable_reasons": dict(sorted(reasons.items())),
    }


def _masked_rows(log: Log) -> dict[str, Any]:
    return {
        channel: {"samples": sum(reasons.values()), "reasons": reasons}
        for channel, reasons in log.audit.masked().items()
    }


def _trim_row(runs: Runs, log: Log) -> dict[str, Any] | None:
    trim: Trim | None = (runs.trims or {}).get(MODEL)
    if trim is None:
        return None
    return {
        "scored_from_s": float(log.time_s[min(trim.until, len(log) - 1)]),
        "levels": trim.nodes.tolist(),
        "offsets": dict(zip(runs.channels, trim.offsets.T.tolist(), strict=True)),
        "samples": dict(zip(runs.channels, trim.samples, strict=True)),
    }


__all__ = [
    "EvaluateConfig",
    "Evaluation",
    "LogEvaluation",
    "evaluate",
    "evaluation_logs",
    "run_config",
]

SCHEMA = "narxcal.evaluate/1"


@dataclass(frozen=True, eq=False)
class Evaluation:
    """All logs and what they have to reach; `document` is `evaluate.json`."""

    logs: tuple[LogEvaluation, ...]
    config: EvaluateConfig
    trim: float | None = None

    @property
    def tally(self) -> Tally:
        """Ti/Tt over all logs and channels."""
        return tally([each for log in self.logs for each in log.assessments])

    @property
    def pooled(self) -> dict[str, ChannelScores]:
        """Scores per channel over all logs as one recording."""
        return score([log.runs for log in self.logs])

    def missed(self) -> list[str]:
        """Say each tolerance that was missed; empty if the evaluation is passed."""
        found, texts = self.tally, []
        least = self.config.least_passed_pct
        if found.passed_pct is not None and found.passed_pct < least:
            texts.append(
                f"Ti/Tt: {found.passed} of {found.assessed} transients pass "
                f"({found.passed_pct:.1f} %), at least {least:g} % have to"
            )
        pooled = self.pooled
        for name, bound in self.config.largest_rmse.items():
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

    def document(self) -> dict[str, Any]:
        """Everything as JSON-able values; None where a figure does not exist."""
        rules = rules_of(self.config.transients.rules)
        missed = self.missed()
        return {
            "schema": SCHEMA,
            "ok": not missed,
            "missed": missed,
            "trim": self.trim,
            "rules": {"name": rules.name, "source": rules.source, "tt_origin": rules.tt_origin},
            "logs": [log_row(log) for log in self.logs],
            "pooled": {
                "channels": {name: one.row() for name, one in self.pooled.items()},
                "ti_tt": tally_rows([each for log in self.logs for each in log.assessments]),
            },
        }


def run_config(bundle: Bundle) -> tuple[RunConfig, EvaluateConfig]:
    """The configuration stored in a bundle; `ModelError` where there is none."""
    stored = bundle.meta.get("config")
    if not isinstance(stored, Mapping):
        raise ModelError(
            "the bundle does not say how its logs were prepared", hint="Train it with narxcal train"
        )
    config = RunConfig.parse(stored, "bundle.json")
    return config, EvaluateConfig.parse(config.evaluate, "bundle.json, [evaluate]")


def evaluation_logs(bundle: Bundle, files: Sequence[Path] | None = None) -> list[Log]:
    """Read `files` with the column mapping of the bundle, cleaned and smoothed as for training.

    Without `files`, the configured test logs (all configured ones where the split leaves none).
    Masked inputs stay NaN here, so that the evaluation knows them; so are outputs that a file
    lacks. Raises `DataError` for a file without any output.
    """
    config, _ = run_config(bundle)
    outputs = bundle.calibration.output_names
    lacking_some = config.logs.sparing(set(outputs) - set(bundle.calibration.input_names))
    reading = lacking_some.model_copy(update={"raster_hz": 1.0 / bundle.calibration.dt_s})
    chosen: Sequence[Log]
    if files is not None:
        chosen = read_logs(list(files), reading)
    else:
        logs = read_logs(config.logs.resolve(Path(str(bundle.meta.get("base", ".")))), reading)
        chosen = split_logs(logs, config.split).test or logs
    return [with_outputs(one.log, outputs) for one in prepare(chosen, config)]


def evaluate(
    bundle: Bundle,
    logs: Sequence[Log],
    trim: float | None = None,
    settings: EvaluateConfig | None = None,
) -> Evaluation:
    """Evaluate prepared logs; with `trim`, that share of each log is used up for offsets.

    Raises `DataError` for logs that the model cannot be run on, `ConfigError` for a trim
    outside of 0 to 1.
    """
    config, stored = run_config(bundle)
    settings = settings or stored
    task = Task(settings, trim)
    return Evaluation(tuple(judge_log(bundle, config, log, task) for log in logs), settings, trim)


_MANY = 0.1  # share of a log's samples


def outside_envelope(runs: Runs, steady: SteadyStateModel) -> str:
    """How much of a log lies outside the model's envelope, and by which inputs; empty for little.

    `steady` is that of the log's engine. There the model stays bounded, but does not know the
    engine.
    """
    out = runs.known & ~runs.inside
    if out.sum() <= _MANY * runs.known.sum():
        return ""
    return (
        f"{runs.log.name}: {100.0 * out.sum() / runs.known.sum():.0f} % of the samples are outside "
        f"what the steady-state model knows{_by_what(runs, steady)}"
    )


def _by_what(runs: Runs, steady: SteadyStateModel) -> str:
    """Ranges of the inputs that leave the envelope, where it is a box."""
    box = getattr(steady, "envelope", None)
    if not isinstance(box, Envelope):
        return ""
    told = []
    for name, low, high in zip(steady.input_names, box.low, box.high, strict=True):
        values = runs.log[name][runs.known]
        if np.mean((values < low) | (values > high)) > _MANY:
            told.append(
                f"{name} is {values.min():.5g} to {values.max():.5g}, known {low:.5g} to {high:.5g}"
            )
    return f" ({'; '.join(told)})" if told else ""
