"""Sections 3.2 of the paper: accuracy and Ti/Tt of the calibrated model, by class of event.

`accuracy`: largest relative errors over whole test data sets and per class. `response_times`: Ti
and Tt per data set and class. `splits`: ten random 7:3 divisions of the events.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from data_prep.events import find_events
from data_prep.log import Log
from eval.judging.crossval import CrossValidation, judge_fold, total
from eval.judging.crossval import spread as spread_of
from eval.judging.log_evaluation import LogEvaluation, assess_log
from eval.judging.scores import max_relative_percent, score
from eval.report import event_figures, figures, tables
from eval.report.page import worst_events
from eval.report.style import NOTHING, unit
from eval.report.tables import Cell, Table, figure
from eval.report.view import LogView, view_of
from eval.reproduce.data import PHASES, SPEEDS, DataSets, Effort, phase_of, pieces, within
from eval.reproduce.study import Claim, Study, claim, or_nan, table_of
from eval.run_logs import EvaluateConfig, run_config
from narxcal.calibration.bundle import Bundle
from narxcal.channels import symbol
from narxcal.support.progress import Progress, silent
from training.folds import divide
from training.pipeline import run_plans
from training.responses.transients import AssessedEvent, Assessment, tally

_TIMES = ("Ti", "Tt")
PAPER_PCT = 5.0  # below which the paper finds all its largest errors


@dataclass(frozen=True, eq=False)
class Classed:
    """One event of an evaluated log, with its class: phase, direction and speed of the lever."""

    log: LogEvaluation
    event: AssessedEvent
    phase: str

    @property
    def direction(self) -> str:
        return ("push", "pull")[self.event.event.label]

    @property
    def speed(self) -> str:
        return self.event.event.speed


def judged(bundle: Bundle, logs: Sequence[Log]) -> list[LogEvaluation]:
    """Evaluate `logs`; events on the ground are judged too, whatever [events] says of them."""
    config, settings = run_config(bundle)
    wider = config.events.model_copy(update={"condition": ""})
    return [assess_log(bundle, log, settings, events=find_events(log, wider)) for log in logs]


def classed(driver: str, found: Sequence[LogEvaluation]) -> list[Classed]:
    """Sort every event of the lever `driver` into its class."""
    return [
        Classed(one, event, phase_of(one.log, event.event, driver))
        for one in found
        for event in one.events
    ]


def assessments_of(events: Sequence[Classed]) -> list[Assessment]:
    """The Ti/Tt assessments of these events, one per judged channel."""
    return [each for one in events for each in one.event.assessments]


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
    pairs = [(one.log.run, slice(one.event.event.start, one.event.event.stop)) for one in events]
    worst = max_relative_percent(
        *(
            np.concatenate([getattr(run, name)[rows] for run, rows in pairs])
            for name in ("measured", "model", "scored")
        )
    )
    return dict(zip(pairs[0][0].channels, worst.tolist(), strict=True))


def accuracy(
    data: DataSets, bundle: Bundle, found: Sequence[LogEvaluation], events: Sequence[Classed]
) -> Study:
    """Say how far the free run is off, at worst."""
    scores = score([log.run for log in found])
    pooled = {name: one.max_rel_pct for name, one in scores.items()}
    classes = class_rows(events)
    return Study(
        key="accuracy",
        title="Accuracy of the calibrated model",
        source="section 3.2 and conclusion (1), figure 10",
        text=f"Free run of all outputs over whole test data sets {data.labels(data.tests)}, "
        "against the prepared measurement; temperatures count in °C. The classes are over "
        "the samples of their events; the phases that the paper left out, and slow and small "
        "movements, are in.",
        claims=error_claims(pooled, classes),
        tables=[class_table(pooled, classes, PAPER_PCT)],
        pictures=[figures.overlay(_first_view(data, bundle, found))],
        results={
            "max_rel_pct": pooled,
            "rmse": {name: one.rmse for name, one in scores.items()},
            "classes": classes,
        },
    )


def worst_pct(found: Sequence[LogEvaluation]) -> dict[str, float]:
    """Largest relative error per channel over whole logs, in percent."""
    return {name: one.max_rel_pct for name, one in score([log.run for log in found]).items()}


def class_rows(events: Sequence[Classed]) -> list[dict[str, Any]]:
    """One row per phase and direction, then per speed, with the worst of each channel."""
    groups = {
        **by(events, lambda one: f"{one.phase}, {one.direction}", _both(PHASES)),
        **by(events, lambda one: f"{one.speed}, {one.direction}", _both(SPEEDS)),
    }
    return [
        {"class": name, "events": len(group), "max_rel_pct": worst_relative_pct(group)}
        for name, group in groups.items()
    ]


def _both(names: Sequence[str]) -> list[str]:
    return [f"{name}, {direction}" for name in names for direction in ("push", "pull")]


def error_claims(
    pooled: Mapping[str, float], classes: Sequence[dict[str, Any]], key: str = "largest"
) -> list[Claim]:
    """One claim per channel about its largest relative error, with its worst class if missed."""
    found = []
    for name, value in pooled.items():
        one = claim("narx-paper", key, value, name=symbol(name), remark="")
        found.append(one if one.met else replace(one, remark=worst_class(classes, name)))
    return found


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
    groups = [("every sample", "", pooled)]
    groups += [(row["class"], row["events"], row["max_rel_pct"]) for row in classes]
    rows = [
        (
            name,
            count,
            *(figure(each, "bad" if each >= bound else "good") for each in worst.values()),
        )
        for name, count, worst in groups
    ]
    head = ("events", "number", *(f"{symbol(name)} [%]" for name in pooled))
    return table_of(f"Largest relative error; {bound:g} % or more is marked", head, rows)


def _first_view(data: DataSets, bundle: Bundle, found: Sequence[LogEvaluation]) -> LogView:
    return view_of(found[0], data.config.events.driver, bundle.calibration.input_names)


def response_times(
    data: DataSets, bundle: Bundle, found: Sequence[LogEvaluation], events: Sequence[Classed]
) -> Study:
    """Judge every event of the tests by the paper's rule: 10 % or 0.25 s."""
    groups = groups_of(data, events)
    every = figures_of(assessments_of(events))
    rows = [{"group": name, **figures_of(group)} for name, group in groups.items()]
    view = _first_view(data, bundle, found)
    largest = [_largest_claim(every, name) for name in _TIMES]
    return Study(
        key="response_times",
        title="Ti and Tt",
        source="section 3.2 and conclusion (2), figures 11 and 12",
        text="Ti runs from the lever's movement to 10 % of the response, Tt from 10 to 90 %; both "
        "have to agree within 10 % or 0.25 s. Speeds are judged, in free run over whole data "
        "sets. A relative error is that of one reading; a Ti of half a second resolved by a "
        "sampling interval of 1/32 s can hardly be read to 5 %.",
        claims=[passed_claim(every), *largest],
        tables=[times_table(rows)],
        pictures=[  # figure 12: the event nearest to its tolerance
            event_figures.large(view, event) for event in worst_events(view)[:1]
        ],
        results={"groups": rows, "all": every},
    )


def groups_of(data: DataSets, events: Sequence[Classed]) -> dict[str, list[Assessment]]:
    """Per test data set and direction, then per phase, then per speed of the lever."""
    sets = [f"data set {data.number(log.name)}" for log in data.tests]
    split = {
        **by(
            events, lambda e: f"data set {data.number(e.log.log.name)}, {e.direction}", _both(sets)
        ),
        **by(events, lambda e: e.phase, PHASES),
        **by(events, lambda e: f"{e.speed} lever", [f"{name} lever" for name in SPEEDS]),
    }
    return {name: assessments_of(group) for name, group in split.items()}


def figures_of(assessments: Sequence[Assessment]) -> dict[str, Any]:
    """Counts, mean and largest relative errors in percent; None where nothing was compared.

    The largest ones are over the events whose times could be compared at all.
    """
    counts = tally(assessments)
    found = {n: getattr(counts, n) for n in ("events", "assessed", "passed", "passed_pct")}
    found |= {f"mean_{n}_pct": getattr(counts, f"mean_relative_{n}_pct") for n in _TIMES}
    judged = [one.verdict for one in assessments if one.verdict.ok is not None]
    for name in _TIMES:
        checks = [check for each in judged if (check := getattr(each, name)) is not None]
        found[f"max_{name}_pct"] = max((100.0 * one.relative for one in checks), default=None)
    return found


def passed_claim(every: dict[str, Any], key: str = "passed") -> Claim:
    """Claim that all assessable events are within tolerance."""
    failed = every["assessed"] - every["passed"]
    share = f"{every['passed']} of {every['assessed']} readings"
    remark = f"{share}; the {failed} that fail stand in the table" if failed else share
    return claim("narx-paper", key, or_nan(every["passed_pct"]), remark=remark)


def _largest_claim(every: dict[str, Any], name: str) -> Claim:
    mean, value = or_nan(every[f"mean_{name}_pct"]), or_nan(every[f"max_{name}_pct"])
    remark = f"over all phases and speeds; on average {mean:.2g} %" if value >= PAPER_PCT else ""
    return claim("narx-paper", "time", value, name=name, remark=remark)


def times_table(rows: Sequence[dict[str, Any]]) -> Table:
    """Tabulate groups with their `figures_of`."""
    head = (
        "events", "readings", "assessed", "passed", "mean Ti [%]", "max Ti [%]", "mean Tt [%]",
        "max Tt [%]",
    )  # fmt: skip
    cells = []
    for row in rows:
        passed = Cell(NOTHING, "none", number=True)
        if row["assessed"]:
            whole = row["passed"] == row["assessed"]
            passed = Cell(str(row["passed"]), "good" if whole else "bad", number=True)
        times = [row[f"{how}_{name}_pct"] for name in _TIMES for how in ("mean", "max")]
        cells.append((row["group"], row["events"], row["assessed"], passed, *times))
    caption = "Relative errors of Ti and Tt; a reading is one event of one speed"
    return table_of(caption, head, cells)


def splits(data: DataSets, effort: Effort, progress: Progress = silent) -> Study:
    """Calibrate once per division and judge the held-back events."""
    found = divided(data, effort, progress)
    worst = worst_of(found)
    [scheme] = found.schemes
    spread = figures.spread(found)
    return Study(
        key="splits",
        title=f"{effort.splits} random 7:3 divisions",
        source="section 3.2",
        text="Whole events are held back, never parts of one; free run over each held-back event. "
        "The figures are the worst of all divisions, the times the mean over them.",
        claims=list(_split_claims(worst)),
        tables=[tables.folds(found, scheme)],
        pictures=[] if spread is None else [spread],
        results={"worst": worst, "folds": found.document()["schemes"][0]["folds"]},
    )


def divided(data: DataSets, effort: Effort, progress: Progress = silent) -> CrossValidation:
    """Draw the divisions, calibrate and judge: `narxcal crossval` on segments."""
    config = within(data.config, effort)
    settings = EvaluateConfig.parse(config.evaluate, "[evaluate]")
    segments = [part for log in data.logs for part in pieces(log, config.events)]
    wanted = settings.crossval.model_copy(update={"random_splits": effort.splits})
    plans, folds = divide(segments, wanted), []
    for fold in run_plans(plans, config, data.base, judge_fold, effort.jobs):
        folds.append(fold)
        progress(len(folds), len(plans), fold.scheme)
    return CrossValidation(tuple(folds), settings)


def worst_of(found: CrossValidation) -> dict[str, Any]:
    """What the paper states: worst relative errors and RMSE, mean relative errors of Ti and Tt."""
    over = spread_of(found.folds)
    worst = {
        key: part["max"] for key, part in over.items() if key.startswith(("max_rel_pct.", "rmse."))
    }
    times = [f"mean_relative_{name}_pct" for name in _TIMES]
    means = {key: over[key]["mean"] if key in over else None for key in times}
    counts = {key: total(found.folds, key) for key in ("passed", "assessed")}
    return {**worst, **means, **counts}


def _split_claims(worst: dict[str, Any]) -> Iterator[Claim]:
    for key, value in worst.items():
        kind, _, name = key.partition(".")
        if kind == "max_rel_pct":
            rmse = or_nan(worst[f"rmse.{name}"])
            fills = {"name": symbol(name), "rmse": rmse, "unit": unit(name)}
            yield claim("narx-paper", "split", or_nan(value), **fills)
    for name in _TIMES:
        fills = {"name": name, "passed": worst["passed"], "assessed": worst["assessed"]}
        mean = or_nan(worst[f"mean_relative_{name}_pct"])
        yield claim("narx-paper", "split_time", mean, **fills)
