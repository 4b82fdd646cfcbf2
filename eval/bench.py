"""Our own figures and their targets: `make bench`, or `python -m eval.bench`.

Speed is given as ratios measured in one run, since a busy machine slows both sides. Nothing is
taken from a file: every figure is measured when the command runs.
"""

from __future__ import annotations

import argparse
import os
import platform
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table
from rich.text import Text

from eval.benchmarks import Row, flights, public_sets, recorders, speed, untuned
from eval.terminal import plain_table
from narxcal.support.files import to_json, versions

SCHEMA = "narxcal.bench/1"
_SHARED = Path(__file__).resolve().parents[2] / "shared" / "data"
_VERDICTS = {True: ("yes", "green"), False: ("no", "red"), None: ("", "")}


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure, print a table or JSON; always 0, since a missed target is a figure, no failure."""
    options = _parser().parse_args(arguments)
    options.data = options.data.resolve()
    began = time.perf_counter()
    found = list(_measured(options))
    document = describe(found, time.perf_counter() - began)
    if options.json:
        sys.stdout.write(to_json(document))
    else:
        show(Console(), found, document)
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m eval.bench", description=__doc__)
    which = parser.add_mutually_exclusive_group()
    for name, words in (
        ("--flights", "leave one flight out instead"),
        ("--untuned", "instead, configurations of columns and split on many engines and recorders"),
    ):
        which.add_argument(name, action="store_true", help=words)
    which.add_argument(
        "--recorders",
        nargs="?",
        type=Path,
        const=_SHARED,
        metavar="DIR",
        help="instead, columns and split alone on every real recording in DIR",
    )
    parser.add_argument(
        "--sets",
        type=recorders.options_of,
        default=recorders.SETS,
        help=f"of --recorders, comma-separated: {','.join(recorders.SETS)}",
    )
    for name, words in (
        ("--screening-only", "of --recorders: faults alone, no training"),
        ("--json", "print one JSON document"),
    ):
        parser.add_argument(name, action="store_true", help=words)
    parser.add_argument("--seed", type=int, default=0, help="of flights that are flown")
    parser.add_argument(
        "--data", type=Path, default=_SHARED, help="folder that holds bench, flights, agtf30"
    )
    return parser


def _measured(options: argparse.Namespace) -> Iterator[Row]:
    data, seed = options.data, options.seed
    if options.untuned:
        yield from untuned.rows(data, seed)
    elif options.recorders:
        yield from recorders.rows(
            options.recorders.resolve(), options.sets, screening_only=options.screening_only
        )
    elif options.flights:
        for campaign, name in zip(flights.CAMPAIGNS, ("flights", "agtf30"), strict=True):
            yield from flights.rows(data / name, (campaign,))
    else:
        yield from speed.rows()
        yield from public_sets.rows(data / "bench")


def describe(found: Sequence[Row], wall_s: float) -> dict[str, Any]:
    """All rows, the machine and the versions that made them."""
    return {
        "schema": SCHEMA,
        "rows": [row.document() for row in found],
        "wall_s": wall_s,
        "machine": {
            "processor": platform.machine(),
            "system": platform.system(),
            "cores": os.cpu_count(),
            "load": os.getloadavg()[0] if hasattr(os, "getloadavg") else None,
        },
        "versions": versions(),
    }


def show(console: Console, found: Sequence[Row], document: dict[str, Any]) -> None:
    """One table per group; where targets come from and how figures were measured below it."""
    for group in dict.fromkeys(row.group for row in found):
        own = [row for row in found if row.group == group]
        console.print(_table(group, own))
        notes = {row.note: row.name for row in reversed(own) if row.note}
        for note, name in reversed(notes.items()):
            console.print(Text(f"  {name}: {note}", style="dim"))
        for source in dict.fromkeys(row.source for row in own if row.source):
            console.print(Text(f"  target: {source}", style="dim"))
    machine = document["machine"]
    load = "" if machine["load"] is None else f", load {machine['load']:.1f}"
    console.print(Text(f"{document['wall_s']:.0f} s on {machine['cores']} cores{load}"))


def _table(group: str, own: Sequence[Row]) -> Table:
    table = plain_table(group, "figure", ("measured", "target", "reached"), fold=True)
    for row in own:
        word, look = _VERDICTS[row.reached]
        table.add_row(
            Text(row.name), _number(row.value, row.unit), _target(row), Text(word, style=look)
        )
    return table


def _number(value: float, unit: str) -> Text:
    if value != value:  # noqa: PLR0124 (NaN)
        return Text("-")
    return Text(f"{value:.4g} {unit}".rstrip())


def _target(row: Row) -> Text:
    if not row.bound:
        return Text("")
    sign = "<=" if row.bound == "at most" else ">="
    return Text(f"{sign} {row.target:g} {row.unit}".rstrip())


if __name__ == "__main__":
    sys.exit(main())
