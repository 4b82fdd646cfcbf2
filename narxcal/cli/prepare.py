"""`narxcal prepare`: show what is in the logs, before any model."""

from __future__ import annotations

import gzip
import re
from argparse import ArgumentParser, Namespace
from collections.abc import Sequence
from itertools import chain, count
from pathlib import Path
from typing import Any

from data_prep.equilibrium import while_running
from data_prep.log import Log
from data_prep.prepare import cautions
from data_prep.reading import read_logs
from eval.preparation import LogReport, events_table, examine, pearson_table, windows_table
from eval.report.page import RunHeader, prepare_page
from narxcal.cli.console import Console
from narxcal.cli.options import add_config
from narxcal.cli.results import data_files, now, read_config
from narxcal.support.files import TIME_FORMAT, Results, log_csv, text_cell, versions
from training.config import RunConfig

SCHEMA = "narxcal.prepare/1"
RESULTS = Results(
    SCHEMA,
    "prepare.json",
    ("prepare.html", "events.csv", "pearson.csv", "windows.csv", "logs"),
)


def add_options(parser: ArgumentParser) -> None:
    """Add what the command takes to `parser`."""
    add_config(parser, "DIR", "folder for the prepared logs, tables and page")


def run(options: Namespace, console: Console) -> int:
    """Prepare the logs of a configuration; writes tables, prepared logs, JSON and HTML."""
    RESULTS.check(options.out)
    config, base = read_config(options.config, options.data)
    reports = _reports(config.logs.resolve(base), config, console)
    names = file_names([one.log for one in reports])
    document = _document(config, reports, names)
    with RESULTS.writing(options.out) as folder:
        _write(folder, reports, names)
        RESULTS.write(folder, document, _page(config, reports))
    _show(console, reports, options.out)
    for caution in document["cautions"]:
        console.warn(caution)
    console.document(document)
    return 0


def _reports(files: Sequence[Path], config: RunConfig, console: Console) -> list[LogReport]:
    reports = []
    with console.progress("Preparing") as advance:
        for number, file in enumerate(files):
            advance(number, len(files), file.name)
            running = while_running(read_logs(file, config.logs), config.running)
            reports += [examine(raw, config) for raw in running]
    return reports


def _document(
    config: RunConfig, reports: Sequence[LogReport], names: Sequence[str]
) -> dict[str, Any]:
    prepared = zip(reports, names, strict=True)
    return {
        "schema": SCHEMA,
        "config": config.model_dump(mode="json", by_alias=True),
        "versions": versions(),
        "cautions": _cautions(config, reports),
        "logs": [{**one.to_dict(), "prepared": name} for one, name in prepared],
        "pearson": pearson_table(reports).to_dict(orient="records"),
        "windows": windows_table(reports).to_dict(orient="records"),
        "window": config.smooth.window_at(reports[0].log.dt_s),
    }


def _write(folder: Path, reports: Sequence[LogReport], names: Sequence[str]) -> None:
    for one, name in zip(reports, names, strict=True):
        _write_log(folder / name, one.log)
    events = events_table(reports)
    events["start_s"] = events["start_s"].map(TIME_FORMAT.__mod__)
    for name, table in (
        ("events.csv", events),
        ("pearson.csv", pearson_table(reports)),
        ("windows.csv", windows_table(reports)),
    ):
        table["log"] = table["log"].map(text_cell)
        table.to_csv(folder / name, index=False, float_format="%.8g", lineterminator="\n")


def file_names(logs: Sequence[Log]) -> list[str]:
    """Choose a file for each log by its name, with a number where two would share one."""
    found: list[str] = []
    for log in logs:
        plain = re.sub(r"\.(csv|parquet|txt)(\.gz)?", "", log.name)
        stem = re.sub(r"[^A-Za-z0-9._-]+", "_", plain)
        tries = (f"logs/{stem}{tail}.csv.gz" for tail in chain([""], map("({})".format, count(2))))
        found.append(next(name for name in tries if name not in found))
    return found


def _write_log(path: Path, log: Log) -> None:
    """Write a canonical log that `read_logs` reads back; no time stamp, so the bytes repeat."""
    path.parent.mkdir(exist_ok=True)
    text = log_csv({"time_s": log.time_s, **log.channels})
    path.write_bytes(gzip.compress(text.encode("utf-8"), compresslevel=6, mtime=0))


def _page(config: RunConfig, reports: Sequence[LogReport]) -> str:
    header = RunHeader(
        title=f"Prepared logs: {config.name}",
        created=now(),
        sources=data_files([one.log for one in reports]),
        versions=versions(),
        config=config.model_dump_json(by_alias=True, indent=1),
        cautions=_cautions(config, reports),
    )
    return prepare_page(header, [one.view() for one in reports], [one.trial for one in reports])


def _cautions(config: RunConfig, reports: Sequence[LogReport]) -> list[str]:
    return cautions([one.log for one in reports], config, config.narx.outputs)


def _show(console: Console, reports: Sequence[LogReport], out: Path) -> None:
    rows = []
    for one in reports:
        counts, masked = one.counts(), one.log.audit.masked()
        lost = sum(sum(reasons.values()) for reasons in masked.values())
        minutes = (one.log.time_s[-1] - one.log.time_s[0]) / 60.0
        rows.append(
            [one.log.name, f"{minutes:.1f}", str(counts["push"]), str(counts["pull"]), f"{lost}"]
        )
    console.table("Prepared logs", ["log", "minutes", "pushes", "pulls", "masked samples"], rows)
    console.say(f"Page: {out / 'prepare.html'}")
