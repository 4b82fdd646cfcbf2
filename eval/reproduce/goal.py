"""Our own goal, which takes in what the paper left open: take-off, approach, throttle rate."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from data_prep.log import Log
from eval.judged import LogEvaluation
from eval.report.claims import Claim, Study, or_nan
from eval.report.style import symbol
from eval.reproduce.accuracy import class_rows, class_table, worst_class
from eval.reproduce.calibrated import Classed, classed, judged
from eval.reproduce.data_sets import FAMILIES, DataSets
from eval.reproduce.response_times import figures_of, passed_claim, times_table
from eval.scores import score
from narxcal.bundle import Bundle

ERROR_PCT, TIMES_PCT = 2.0, 3.0
_PAPER_FAMILY = "the paper's data sets"


def goal(data: DataSets, bundle: Bundle) -> Study:
    """Judge the calibration of all records on every record held out."""
    tests = [*data.tests, *data.further_tests]
    found = judged(bundle, tests)
    events = classed(data.config.events.driver, found)
    pooled = {name: one.max_rel_pct for name, one in score([one.runs for one in found]).items()}
    classes = class_rows(events)
    rows = _families(found, events)
    every = figures_of([each for one in events for each in one.assessments])
    return Study(
        key="goal",
        title="Our own goal: every phase and every throttle rate",
        source="section 4, where the paper names both as future work",
        text="A calibration from the training part of all records, judged in free run on whole "
        f"records that it has not seen: {_tested(data, tests)}. Pushes and pulls, fast, slow and "
        "small, on the ground and in the air.",
        claims=[*_errors(pooled, classes), passed_claim(every, "our goal"), *_times(every)],
        tables=[times_table(rows), class_table(pooled, classes, ERROR_PCT)],
        results={"families": rows, "max_rel_pct": pooled, "classes": classes, "all": every},
    )


def family_of(name: str) -> str:
    """Which family of records a log belongs to, in words."""
    return FAMILIES.get(name.partition("/")[0], _PAPER_FAMILY)


def _families(found: Sequence[LogEvaluation], events: Sequence[Classed]) -> list[dict[str, Any]]:
    rows = []
    for family in dict.fromkeys(family_of(one.log.name) for one in found):
        own = [one for one in events if family_of(one.log.log.name) == family]
        times = figures_of([each for one in own for each in one.assessments])
        runs = [one.runs for one in found if family_of(one.log.name) == family]
        worst = {name: one.max_rel_pct for name, one in score(runs).items()}
        rows.append({"group": family, **times, "max_rel_pct": worst})
    return rows


def _tested(data: DataSets, tests: Sequence[Log]) -> str:
    parts = [f"data sets {data.labels(data.tests)}"]
    for family in dict.fromkeys(family_of(log.name) for log in tests):
        if family != _PAPER_FAMILY:
            count = sum(family_of(log.name) == family for log in tests)
            parts.append(f"{count} of {family}")
    return "; ".join(parts)


def _errors(pooled: dict[str, float], classes: Sequence[dict[str, Any]]) -> list[Claim]:
    return [
        Claim(
            what=f"Largest relative error of {symbol(name)} in free run",
            origin="our goal",
            claimed=f"< {ERROR_PCT:g} %",
            value=value,
            bound=ERROR_PCT,
            unit="%",
            remark="" if value < ERROR_PCT else worst_class(classes, name),
        )
        for name, value in pooled.items()
    ]


def _times(every: dict[str, Any]) -> list[Claim]:
    return [
        Claim(
            what=f"Mean relative error of {name}",
            origin="our goal",
            claimed=f"< {TIMES_PCT:g} %",
            value=or_nan(every[f"mean_{name}_pct"]),
            bound=TIMES_PCT,
            unit="%",
        )
        for name in ("Ti", "Tt")
    ]
