"""`narxcal fleet`: evaluate many logs into a dataset that can be interrupted and can grow."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from collections import Counter
from typing import Any

from eval.fleets.fleet import SCHEMA, Fleet, load_fleet, read_table
from eval.fleets.fleet_rows import DUPLICATE, FAILED, GOOD
from narxcal.cli.console import Console
from narxcal.cli.options import add_jobs, add_trust, address, path
from narxcal.support.addresses import Folder

_MOST_SHOWN = 5
_SHOWN = ["tail", "file", "status", "reason", "hours", "assessed", "passed", "digest"]


def add_options(parser: ArgumentParser) -> None:
    parser.add_argument("config", metavar="CONFIG", type=path, help="TOML file of the fleet")
    parser.add_argument(
        "--out",
        metavar="FLEET",
        type=address,
        required=True,
        help="folder or fsspec address of the dataset; an existing one is continued",
    )
    add_jobs(parser, "batches of logs")
    add_trust(parser)


def run(options: Namespace, console: Console) -> int:
    """Evaluate the logs that are not in the dataset yet; writes Parquet."""
    config = load_fleet(options.config)
    fleet = Fleet(Folder(str(options.out)), config, options.jobs, options.trust)
    try:
        with console.progress("Listing the files") as advance:
            rows = fleet.list_files(advance)
    except KeyboardInterrupt:
        raise KeyboardInterrupt("what was listed is kept; the same command goes on") from None
    batches = fleet.batches(rows)
    left = sum(len(batch.files) for batch in batches)
    if left < len(rows):
        console.say(f"{len(rows) - left} of {len(rows)} files are in {options.out} already")
    try:
        with console.progress("Evaluating") as advance:
            fleet.grow(batches, advance)
    except KeyboardInterrupt:
        there = len(rows) - sum(len(batch.files) for batch in fleet.batches(rows))
        raise KeyboardInterrupt(
            f"{there} of {len(rows)} files are in {options.out}; the same command goes on"
        ) from None
    logs = read_table(fleet.out, "logs").select(_SHOWN).to_pylist()
    _show(console, logs)
    _warn(console, logs)
    console.document({"schema": SCHEMA, "out": str(options.out), **_summary(logs)})
    return 0


def _summary(logs: list[dict[str, Any]]) -> dict[str, Any]:
    good = [row for row in logs if row["status"] == GOOD]
    counts = Counter(row["status"] for row in logs)
    return {
        "files": len({row["file"] for row in logs}),
        "logs": len(good),
        "hours": sum(row["hours"] for row in good),
        "assessed": sum(row["assessed"] for row in good),
        "passed": sum(row["passed"] for row in good),
        "failed_files": counts[FAILED],
        "duplicates": counts[DUPLICATE],
        "same_samples": _same_samples(good),
    }


def _same_samples(good: list[dict[str, Any]]) -> list[list[str]]:
    """Files, in pairs or more, that hold the same samples in other bytes."""
    found: dict[str, dict[str, None]] = {}
    for row in good:
        found.setdefault(row["digest"], {})[row["file"]] = None
    return [list(files) for files in found.values() if len(files) > 1]


def _show(console: Console, logs: list[dict[str, Any]]) -> None:
    tails: dict[str, list[dict[str, Any]]] = {}
    for row in logs:
        tails.setdefault(row["tail"], []).append(row)
    rows = []
    for tail in sorted(tails):
        own = _summary(tails[tail])
        passed = f"{own['passed']} of {own['assessed']}"
        counts = [str(own[name]) for name in ("logs", "failed_files", "duplicates")]
        rows.append([tail, *counts, f"{own['hours']:.1f}", passed])
    head = ["tail", "logs", "failed", "twice", "hours", "Ti/Tt passed"]
    console.table("Fleet", head, rows)


def _warn(console: Console, logs: list[dict[str, Any]]) -> None:
    for status, what in ((FAILED, "could not be evaluated"), (DUPLICATE, "are there twice")):
        found = [row for row in logs if row["status"] == status]
        for row in found[:_MOST_SHOWN]:
            console.warn(f"{row['file']}: {row['reason']}")
        if len(found) > _MOST_SHOWN:
            console.warn(f"{len(found)} files {what}; the table logs has them all")
    for files in _same_samples([row for row in logs if row["status"] == GOOD])[:_MOST_SHOWN]:
        console.warn(f"{' and '.join(files)} hold the same samples in other bytes; both count")
