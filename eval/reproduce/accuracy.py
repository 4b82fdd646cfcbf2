"""Largest relative errors of the calibrated model, over the tests and per class of event."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from eval.judged import LogEvaluation
from eval.report import figures
from eval.report.claims import Claim, Study
from eval.report.evaluation import page_of
from eval.report.style import symbol
from eval.report.svg import Picture
from eval.report.tables import Cell, Table, figure
from eval.reproduce.calibrated import PAPER_PCT, Classed, by, worst_relative_pct
from eval.reproduce.data_sets import DataSets
from eval.reproduce.phases import PHASES, SPEEDS
from eval.scores import score
from narxcal.bundle import Bundle


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
