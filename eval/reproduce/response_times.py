"""Ti and Tt of the calibrated model, per test data set and class of event."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from eval.judged import LogEvaluation
from eval.report import event_figures
from eval.report.claims import Claim, Study, or_nan
from eval.report.evaluation import page_of
from eval.report.page import worst_events
from eval.report.svg import Picture
from eval.report.tables import NOTHING, Cell, Table, figure
from eval.reproduce.calibrated import PAPER_PCT, Classed, by
from eval.reproduce.data_sets import DataSets
from eval.reproduce.phases import PHASES, SPEEDS
from eval.tally import Tally, tally
from eval.transients import Assessment
from narxcal.bundle import Bundle


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
        pictures=_pictures(data, bundle, found),
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


def _pictures(data: DataSets, bundle: Bundle, found: Sequence[LogEvaluation]) -> list[Picture]:
    """The event nearest to its tolerance in the first test data set, as figure 12."""
    driver, inputs = data.config.events.driver, bundle.calibration.input_names
    traces = [trace for one in found[:1] for trace in worst_events(page_of(one, driver, inputs))]
    return [event_figures.large(trace, driver) for trace in traces[:1]]
