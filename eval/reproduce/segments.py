"""Sections 2.5 and 3.1 of the paper: pushes and pulls cut out of the flights."""

from __future__ import annotations

from typing import Any

from data_prep.events import PULL, PUSH
from data_prep.log import Log
from eval.preparation import Prepared
from eval.report import paper_figures
from eval.report.claims import Claim, Study
from eval.report.svg import Picture
from eval.report.tables import Cell, Table
from eval.reproduce.data_sets import DataSets

PAPER_SEGMENTS = 152
PAPER_SETS = 10


def segments(data: DataSets) -> Study:
    """Count the events, and draw every one of them."""
    pushes = sum(event.label == PUSH for one in data.prepared for event in one.events)
    return Study(
        key="segments",
        title="Segments cut at the lever's movements",
        source="sections 2.5 and 3.1, figures 6 to 9",
        text="Each event runs from the last sample before the lever moves to where lever and "
        "speeds have settled. Label 0 is a push, 1 a pull.",
        claims=[
            Claim(
                what="Data sets",
                claimed=f"{PAPER_SETS}",
                value=float(len(data.logs)),
                bound=float(PAPER_SETS),
                below=False,
                remark="the user's own data" if len(data.logs) < PAPER_SETS else "",
            ),
            Claim(
                what="Segments in which the lever is pushed",
                claimed=f"{PAPER_SEGMENTS}",
                value=float(pushes),
                bound=float(PAPER_SEGMENTS),
                below=False,
                remark="more or fewer than the paper's is no merit; every one is used"
                if pushes != PAPER_SEGMENTS
                else "",
            ),
        ],
        tables=[_table(data)],
        pictures=_firsts(data),
        sheets=[one.page() for one in data.prepared],
        results={"pushes": pushes, "data_sets": [_row(data, one) for one in data.prepared]},
    )


def _row(data: DataSets, one: Prepared) -> dict[str, Any]:
    return {"data_set": data.number(one.log.name), "log": one.log.name, **one.counts()}


def _table(data: DataSets) -> Table:
    keys = ("found", "push", "pull", "fast", "slow", "small", "settled", "interrupted")
    rows = [
        (
            Cell(str(data.number(one.log.name)), "head"),
            Cell(_role(data, one.log)),
            *(Cell(str(one.counts()[key]), number=True) for key in keys),
        )
        for one in data.prepared
    ]
    total = [sum(one.counts()[key] for one in data.prepared) for key in keys]
    rows.append(
        (Cell("all", "strong"), Cell(""), *(Cell(str(n), "strong", number=True) for n in total))
    )
    return Table("Events per data set", ("data set", "role", *keys), tuple(rows))


def _role(data: DataSets, log: Log) -> str:
    parts = {"train": data.split.train, "validate": data.split.validate, "test": data.split.test}
    return next((name for name, logs in parts.items() if log.name in {x.name for x in logs}), "")


def _firsts(data: DataSets) -> list[Picture]:
    """The first fast push and the first fast pull of the first data set that has one."""
    drawn = []
    for label in (PUSH, PULL):
        for one in data.prepared:
            fast = [each for each in one.events if each.label == label and each.speed == "fast"]
            if fast:
                names = (one.driver, *data.speeds)
                what = f"First {'push' if label == PUSH else 'pull'}, data set "
                title = what + str(data.number(one.log.name))
                drawn.append(paper_figures.segment(one.log, fast[0], names, title))
                break
    return drawn
