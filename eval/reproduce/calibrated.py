"""The calibrated model over the test data sets, and every event of them with its class."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from data_prep.events import PUSH, Event, find_events
from data_prep.log import Log
from eval.evaluate import run_config
from eval.judged import LogEvaluation, Task, judge_log
from eval.metrics import max_relative_percent
from eval.reproduce.phases import phase_of
from eval.runs import MODEL
from eval.transients import Assessment
from narxcal.bundle import Bundle

PAPER_PCT = 5.0  # below which the paper finds all its largest errors


class EventClass(NamedTuple):
    """Phase of the flight, direction and speed of a lever movement."""

    phase: str
    direction: str
    speed: str


@dataclass(frozen=True, eq=False)
class Classed:
    """One event, its log, its class and its Ti/Tt assessments (one per judged channel)."""

    log: LogEvaluation
    event: Event
    kind: EventClass
    assessments: tuple[Assessment, ...]


def judged(bundle: Bundle, logs: Sequence[Log]) -> list[LogEvaluation]:
    """Evaluate `logs`; events on the ground are judged too, whatever [events] says of them."""
    config, settings = run_config(bundle)
    wider = config.events.model_copy(update={"condition": ""})
    return [
        judge_log(bundle, config, log, Task(settings, events=find_events(log, wider)))
        for log in logs
    ]


def classed(driver: str, found: Sequence[LogEvaluation]) -> list[Classed]:
    """Sort every event of the lever `driver` into its class."""
    return [
        Classed(one, event, _kind(one, event, driver), _own(one, event))
        for one in found
        for event in one.events
    ]


def _kind(one: LogEvaluation, event: Event, driver: str) -> EventClass:
    direction = "push" if event.label == PUSH else "pull"
    return EventClass(phase_of(one.log, event, driver), direction, event.speed)


def _own(one: LogEvaluation, event: Event) -> tuple[Assessment, ...]:
    near = 0.5 * one.log.dt_s
    return tuple(each for each in one.assessments if abs(each.start_s - event.start_s) < near)


def by(
    events: Sequence[Classed], key: Callable[[Classed], str], order: Sequence[str]
) -> dict[str, list[Classed]]:
    """Group events by what `key` makes of them, groups in `order`, empty ones left out."""
    found: dict[str, list[Classed]] = {name: [] for name in order}
    for one in events:
        found.setdefault(key(one), []).append(one)
    return {name: group for name, group in found.items() if group}


def worst_relative_pct(events: Sequence[Classed]) -> dict[str, float]:
    """Largest relative error per channel over the samples of these events, in percent."""
    channels = events[0].log.runs.channels
    measured, model, scored = [], [], []
    for one in events:
        rows = slice(one.event.start, one.event.stop)
        runs = one.log.runs
        measured.append(runs.measured[rows])
        model.append(runs.outputs[MODEL][rows])
        scored.append(runs.scored[rows])
    worst = max_relative_percent(
        np.concatenate(measured), np.concatenate(model), np.concatenate(scored)
    )
    return {name: float(value) for name, value in zip(channels, worst, strict=True)}
