"""Largest relative errors of the calibrated model, over the tests and per class of event.

The calibrated model over the test data sets, and every event of them with its class.

Ti and Tt of the calibrated model, per test data set and class of event.

Section 3.2 of the paper: ten random 7:3 divisions of the events.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from data_prep.events import PUSH, Event, find_events
from data_prep.log import Log
from eval.crossval import CrossValidation, FoldResult, judge_fold
from eval.evaluate import EvaluateConfig, LogEvaluation, Task, judge_log, run_config
from eval.free_run import MODEL
from eval.report import event_figures, figures, tables
from eval.report import figures as study_figures
from eval.report.content import Scheme
from eval.report.crossvalidation import schemes_of
from eval.report.evaluation import page_of
from eval.report.page import Claim, Study, or_nan, worst_events
from eval.report.style import Picture, unit
from eval.report.tables import NOTHING, Cell, Table, figure
from eval.reproduce.data import PHASES, SPEEDS, DataSets, Effort, phase_of, pieces, within
from eval.scores import max_relative_percent, score
from eval.tally import Tally, tally
from eval.transients import Assessment
from narxcal.calibration.bundle import Bundle
from narxcal.channels import symbol
from training.crossval import divide, run_plans

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


def accuracy(
    data: DataSets, bundle: Bundle, found: Sequence[LogEvaluation], events: Sequence[Classed]
) -> Study:
    """Say how far the free run is off, at worst."""
    pooled = {name: one.max_rel_pct for name, one in score([log.runs for log in found]).items()}
    classes = class_rows(events)
    return Study(
        key="accuracy",
        title="Accuracy of the calibrated model",
        source="section 3.2 and conclusion (1), figure 10",
        text=f"Free run of all outputs over whole test data sets {data.labels(data.tests)}, "
        "against the prepared measurement; temperatures count in °C. The classes are over "
        "the samples of their events; the phases that the paper left out, and slow and small "
        "movements, are in.",
        claims=_claims(pooled, classes),
        tables=[class_table(pooled, classes, PAPER_PCT)],
        pictures=_pictures(data, bundle, found),
        results={
            "max_rel_pct": pooled,
            "rmse": {name: one.rmse for name, one in score([x.runs for x in found]).items()},
            "classes": classes,
        },
    )


def class_rows(events: Sequence[Classed]) -> list[dict[str, Any]]:
    """One row per phase and direction, then per speed, with the worst of each channel."""
    groups = {
        **by(events, lambda one: f"{one.kind.phase}, {one.kind.direction}", _both(PHASES)),
        **by(events, lambda one: f"{one.kind.speed}, {one.kind.direction}", _both(SPEEDS)),
    }
    return [
        {"class": name, "events": len(group), "max_rel_pct": worst_relative_pct(group)}
        for name, group in groups.items()
    ]


def _both(names: Sequence[str]) -> list[str]:
    return [f"{name}, {direction}" for name in names for direction in ("push", "pull")]


def _claims(pooled: Mapping[str, float], classes: Sequence[dict[str, Any]]) -> list[Claim]:
    return [
        Claim(
            what=f"Largest relative error of {symbol(name)} in free run",
            claimed=f"< {PAPER_PCT:g} %",
            value=value,
            bound=PAPER_PCT,
            unit="%",
            remark="" if value < PAPER_PCT else worst_class(classes, name),
        )
        for name, value in pooled.items()
    ]


def worst_class(classes: Sequence[dict[str, Any]], name: str) -> str:
    """Say in which class of events a channel is worst."""
    if not classes:
        return ""
    worst = max(classes, key=lambda row: float(row["max_rel_pct"][name]))
    return f"worst in: {worst['class']} ({worst['max_rel_pct'][name]:.2g} %)"


def class_table(
    pooled: Mapping[str, float], classes: Sequence[dict[str, Any]], bound: float
) -> Table:
    """Tabulate the largest relative errors; those of `bound` percent or more are marked."""
    rows = [
        (
            Cell(row["class"], "head"),
            Cell(str(row["events"]), number=True),
            *(_percent(row["max_rel_pct"][name], bound) for name in pooled),
        )
        for row in classes
    ]
    every = (_percent(value, bound) for value in pooled.values())
    head = ("events", "number", *(f"{symbol(name)} [%]" for name in pooled))
    caption = f"Largest relative error; {bound:g} % or more is marked"
    return Table(caption, head, ((Cell("every sample", "head"), Cell(""), *every), *rows))


def _percent(value: float, bound: float) -> Cell:
    return figure(value, "bad" if value >= bound else "good")


def _pictures(data: DataSets, bundle: Bundle, found: Sequence[LogEvaluation]) -> list[Picture]:
    inputs, driver = bundle.calibration.input_names, data.config.events.driver
    return [figures.overlay(page_of(one, driver, inputs)) for one in found[:1]]


def response_times(
    data: DataSets, bundle: Bundle, found: Sequence[LogEvaluation], events: Sequence[Classed]
) -> Study:
    """Judge every event of the tests by the paper's rule: 10 % or 0.25 s."""
    groups = groups_of(data, events)
    every = figures_of([each for one in events for each in one.assessments])
    rows = [{"group": name, **figures_of(group)} for name, group in groups.items()]
    largest = [_largest_claim(every, name) for name in ("Ti", "Tt")]
    return Study(
        key="response_times",
        title="Ti and Tt",
        source="section 3.2 and conclusion (2), figures 11 and 12",
        text="Ti runs from the lever's movement to 10 % of the response, Tt from 10 to 90 %; both "
        "have to agree within 10 % or 0.25 s. Speeds are judged, in free run over whole data "
        "sets. A relative error is that of one reading; a Ti of half a second resolved by a "
        "raster of 1/32 s can hardly be read to 5 %.",
        claims=[passed_claim(every, "paper"), *largest],
        tables=[times_table(rows)],
        pictures=_time_pictures(data, bundle, found),
        results={"groups": rows, "all": every},
    )


def groups_of(data: DataSets, events: Sequence[Classed]) -> dict[str, list[Assessment]]:
    """Per test data set and direction, then per phase, then per speed of the lever."""
    sets = [f"data set {data.number(log.name)}" for log in data.tests]
    ways = [f"{name}, {way}" for name in sets for way in ("push", "pull")]
    split = {
        **by(events, lambda e: f"data set {data.number(e.log.log.name)}, {e.kind.direction}", ways),
        **by(events, lambda e: e.kind.phase, PHASES),
        **by(events, lambda e: f"{e.kind.speed} lever", [f"{name} lever" for name in SPEEDS]),
    }
    return {
        name: [each for one in group for each in one.assessments] for name, group in split.items()
    }


def figures_of(assessments: Sequence[Assessment]) -> dict[str, Any]:
    """Counts, mean and largest relative errors in percent; None where nothing was compared.

    The largest ones are over the events whose times could be compared at all.
    """
    counts: Tally = tally(assessments)
    return {
        "events": counts.events,
        "assessed": counts.assessed,
        "passed": counts.passed,
        "passed_pct": counts.passed_pct,
        "mean_Ti_pct": counts.mean_relative_Ti_pct,
        "mean_Tt_pct": counts.mean_relative_Tt_pct,
        "max_Ti_pct": _largest(assessments, "Ti"),
        "max_Tt_pct": _largest(assessments, "Tt"),
    }


def _largest(assessments: Sequence[Assessment], name: str) -> float | None:
    checks = [getattr(one.verdict, name) for one in assessments if one.verdict.ok is not None]
    known = [100.0 * check.relative for check in checks if check is not None]
    return max(known, default=None)


def passed_claim(every: dict[str, Any], origin: str) -> Claim:
    """Claim that all assessable events are within tolerance."""
    failed = every["assessed"] - every["passed"]
    share = f"{every['passed']} of {every['assessed']} readings"
    return Claim(
        what="Assessable events within 10 % or 0.25 s in Ti and Tt",
        origin=origin,
        claimed="100 %",
        value=or_nan(every["passed_pct"]),
        bound=100.0,
        unit="%",
        below=False,
        remark=f"{share}; the {failed} that fail stand in the table" if failed else share,
    )


def _largest_claim(every: dict[str, Any], name: str) -> Claim:
    mean = or_nan(every[f"mean_{name}_pct"])
    value = or_nan(every[f"max_{name}_pct"])
    return Claim(
        what=f"Largest relative error of {name}",
        claimed=f"< {PAPER_PCT:g} %",
        value=value,
        bound=PAPER_PCT,
        unit="%",
        remark=f"over all phases and speeds; on average {mean:.2g} %" if value >= PAPER_PCT else "",
    )


def times_table(rows: Sequence[dict[str, Any]]) -> Table:
    """Tabulate groups with their `figures_of`."""
    head = (
        "events", "readings", "assessed", "passed", "mean Ti [%]", "max Ti [%]", "mean Tt [%]",
        "max Tt [%]",
    )  # fmt: skip
    cells = [
        (
            Cell(row["group"], "head"),
            Cell(str(row["events"]), number=True),
            Cell(str(row["assessed"]), number=True),
            _passed(row),
            *(figure(row[key]) for key in ("mean_Ti_pct", "max_Ti_pct", "mean_Tt_pct")),
            figure(row["max_Tt_pct"]),
        )
        for row in rows
    ]
    return Table("Relative errors of Ti and Tt; a reading is one event of one speed", head,
                 tuple(cells))  # fmt: skip


def _passed(row: dict[str, Any]) -> Cell:
    if not row["assessed"]:
        return Cell(NOTHING, "none", number=True)
    whole = row["passed"] == row["assessed"]
    return Cell(str(row["passed"]), "good" if whole else "bad", number=True)


def _time_pictures(data: DataSets, bundle: Bundle, found: Sequence[LogEvaluation]) -> list[Picture]:
    """The event nearest to its tolerance in the first test data set, as figure 12."""
    driver, inputs = data.config.events.driver, bundle.calibration.input_names
    traces = [trace for one in found[:1] for trace in worst_events(page_of(one, driver, inputs))]
    return [event_figures.large(trace, driver) for trace in traces[:1]]


TIMES_PCT = 5.0


def splits(
    data: DataSets, effort: Effort, watch: Callable[[FoldResult, int, int], None] | None = None
) -> Study:
    """Calibrate once per division and judge the held-back events."""
    found = divided(data, effort, watch)
    worst = worst_of(found)
    scheme = schemes_of(found)[0]
    return Study(
        key="splits",
        title=f"{effort.splits} random 7:3 divisions",
        source="section 3.2",
        text="Whole events are held back, never parts of one; free run over each held-back event. "
        "The figures are the worst of all divisions, the times the mean over them.",
        claims=_split_claims(worst),
        tables=[tables.folds(scheme)],
        pictures=_split_pictures(scheme),
        results={"worst": worst, "folds": found.document()["schemes"][0]["folds"]},
    )


def divided(
    data: DataSets, effort: Effort, watch: Callable[[FoldResult, int, int], None] | None = None
) -> CrossValidation:
    """Draw the divisions, calibrate and judge: `narxcal crossval` on segments."""
    config = within(data.config, effort)
    settings = EvaluateConfig.parse(config.evaluate, "[evaluate]")
    segments = [part for log in data.logs for part in pieces(log, config.events)]
    wanted = settings.crossval.model_copy(update={"random_splits": effort.splits})
    plans, folds = divide(segments, wanted), []
    for fold in run_plans(plans, config, data.base, judge_fold, effort.jobs):
        folds.append(fold)
        if watch is not None:
            watch(fold, len(folds), len(plans))
    return CrossValidation(tuple(folds), settings)


def worst_of(found: CrossValidation) -> dict[str, Any]:
    """What the paper states: worst relative errors and RMSE, mean relative errors of Ti and Tt."""
    keys = dict.fromkeys(key for fold in found.folds for key in fold.values)
    given = {
        key: [value for fold in found.folds if (value := fold.values.get(key)) is not None]
        for key in keys
    }
    worst = {key: max(values, default=None) for key, values in given.items()}
    means = {
        key: sum(given[key]) / len(given[key]) if given.get(key) else None
        for key in ("mean_relative_Ti_pct", "mean_relative_Tt_pct")
    }
    kept = {key: value for key, value in worst.items() if key.startswith(("max_rel_pct.", "rmse."))}
    passed, assessed = (int(sum(given.get(key, []))) for key in ("passed", "assessed"))
    return {**kept, **means, "passed": passed, "assessed": assessed}


def _split_claims(worst: dict[str, Any]) -> list[Claim]:
    claims = []
    for key, value in worst.items():
        kind, _, channel = key.partition(".")
        if kind == "max_rel_pct":
            claims.append(
                Claim(
                    what=f"Largest relative error of {symbol(channel)} in any division",
                    claimed=f"< {PAPER_PCT:g} %",
                    value=or_nan(value),
                    bound=PAPER_PCT,
                    unit="%",
                    remark=f"largest RMSE {or_nan(worst[f'rmse.{channel}']):.3g} {unit(channel)}",
                )
            )
    return [*claims, *(_time(worst, name) for name in ("Ti", "Tt"))]


def _time(worst: dict[str, Any], name: str) -> Claim:
    return Claim(
        what=f"Mean relative error of {name} over the divisions",
        claimed=f"< {TIMES_PCT:g} %",
        value=or_nan(worst[f"mean_relative_{name}_pct"]),
        bound=TIMES_PCT,
        unit="%",
        remark=f"{worst['passed']} of {worst['assessed']} readings pass",
    )


def _split_pictures(scheme: Scheme) -> list[Picture]:
    return [study_figures.spread([scheme], list(scheme.measures))] if scheme.measures else []
