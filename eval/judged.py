"""One log under judgement: its runs, its figures and its events, with what they are judged by."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from pydantic import Field

from data_prep.events import Event, find_events
from data_prep.log import Log
from data_prep.recorded import events_config, with_outputs
from eval.runs import BASELINES, MODEL, Runs, run_log, trimmed
from eval.scores import ChannelScores, score
from eval.tally import Tally, tally
from eval.transients import Assessment, Overlay, TransientsConfig, assess_events
from eval.trim import TrimConfig, rows_for_trim
from narxcal.bundle import Bundle
from narxcal.settings import Section
from training.config import RunConfig
from training.crossval import CrossvalConfig

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
    """Run and score one prepared log; raises `DataError` as `eval.runs.run_log`.

    An output that the log lacks has no figures, and no event waits for it to settle.
    """
    settings, outputs = task.settings, bundle.calibration.output_names
    log = with_outputs(log, outputs)
    runs, untrimmed = run_log(bundle, config, log), {}
    responses = events_config(log, config.events, outputs)
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
