"""`narxcal prepare`: show what is in the logs, before any model."""

from __future__ import annotations

import gzip
import re
from argparse import ArgumentParser, Namespace
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain, count
from pathlib import Path
from typing import Any

import pandas as pd

from data_prep.reading import read_logs
from data_prep.sources.binary_source import arrow, write_parquet
from eval.preparation import (
    LogReport,
    cautions_about,
    events_table,
    most_to_show,
    pearson_table,
    reports,
    windows_table,
)
from eval.report.page import PreparedLog, prepare_page
from narxcal.cli.console import Console
from narxcal.cli.options import add_config, add_jobs
from narxcal.cli.results import config_header, read_config
from narxcal.support.arrays import FloatArray
from narxcal.support.csv_text import TIME_FORMAT, csv_blocks, text_cell
from narxcal.support.errors import NarxcalError
from narxcal.support.files import Results, versions
from narxcal.support.parallel import in_processes
from training.config import RunConfig

SCHEMA = "narxcal.prepare/1"
RESULTS = Results(
    SCHEMA,
    "prepare.json",
    ("prepare.html", "events.csv", "pearson.csv", "windows.csv", "logs"),
)
_UNNAMED = "unnamed"  # folder of the logs until all of them are known
_LEVEL = 4  # of gzip: a third of the time of level 6, 15 % more bytes
# Logs with pictures on the page: each takes a quarter of a second, the tables of one a fortieth.
MOST_DRAWN = 8
# A process starts in the time in which about this much CSV is prepared, 1.5 s.
_BYTES_PER_PROCESS = 10_000_000


def add_options(parser: ArgumentParser) -> None:
    add_config(parser, "DIR", "folder for the prepared logs, tables and page")
    parser.add_argument(
        "--parquet", action="store_true", help="write each prepared log as Parquet, too"
    )
    add_jobs(parser, "files")


def run(options: Namespace, console: Console) -> int:
    RESULTS.check(options.out)
    config, base = read_config(options.config, options.data)
    files = config.logs.resolve(base)
    forms = (CSV, PARQUET) if options.parquet else (CSV,)
    if options.parquet:
        arrow(options.out)
    with RESULTS.writing(options.out) as folder:
        logs = _prepared(files, _Work(config, folder / _UNNAMED, forms), options.jobs, console)
        names = file_names([one.report.log.name for one in logs])
        _name(folder, logs, names, forms)
        document = _document(config, logs, names, forms)
        _write_tables(folder, [one.report for one in logs])
        RESULTS.write(folder, document)
        title, sources = f"Prepared logs: {config.name}", [one.report.log.source for one in logs]
        header = config_header(title, config, sources, document["cautions"])
        with (folder / RESULTS.others[0]).open("w", encoding="utf-8") as page:
            page.writelines(prepare_page(header, [one.page for one in logs]))
    _show(console, logs)
    console.finish(document, f"Page: {options.out / 'prepare.html'}", document["cautions"])
    return 0


@dataclass(frozen=True, eq=False)
class _Written:
    """A log that is written: the report of it, its part of the document, and of the page."""

    report: LogReport
    document: dict[str, Any]
    page: PreparedLog


@dataclass(frozen=True)
class _Work:
    """What is done to one file after the other, and the folder where their logs are written."""

    config: RunConfig
    folder: Path
    forms: tuple[str, ...]

    def of_file(self, numbered: tuple[int, Path]) -> list[_Written] | NarxcalError:
        """Prepare and write the logs of one file; an error is returned, as the first one counts."""
        number, file = numbered
        try:
            found = reports(read_logs(file, self.config.logs), self.config)
            return [self._written(one, f"{number}-{part}") for part, one in enumerate(found, 1)]
        except NarxcalError as error:
            return error

    def _written(self, report: LogReport, number: str) -> _Written:
        columns = {"time_s": report.log.time_s, **report.log.channels}
        for form in self.forms:
            _WRITERS[form](self.folder / f"{number}{form}", columns)
        page = PreparedLog.of(report.view(), report.trial, number)
        return _Written(report.without_samples(), report.to_dict(), page)

    def drawn(self, one: _Written) -> PreparedLog:
        """Draw a log from the file it was written to."""
        table = pd.read_csv(self.folder / f"{one.page.number}{CSV}")
        channels = {str(name): table[name].to_numpy(dtype=float) for name in table}
        log = replace(one.report.log, time_s=channels.pop("time_s"), channels=channels)
        return one.page.with_pictures(replace(one.report, log=log).view())


def _prepared(files: Sequence[Path], work: _Work, jobs: int, console: Console) -> list[_Written]:
    work.folder.mkdir()
    size = sum(file.stat().st_size for file in files if file.is_file())
    jobs = max(1, min(jobs, len(files), size // _BYTES_PER_PROCESS))
    logs: list[_Written] = []
    with console.progress("Preparing") as advance:
        found = in_processes(work.of_file, enumerate(files, 1), jobs)
        for done, (file, one) in enumerate(zip(files, found, strict=True), 1):
            if isinstance(one, NarxcalError):
                raise one
            logs += one
            advance(done, len(files), file.name)
    chosen = most_to_show([one.report for one in logs], MOST_DRAWN)
    with console.progress("Drawing the page"):
        jobs = max(1, min(jobs, len(chosen)))
        pages = list(in_processes(work.drawn, [logs[k] for k in chosen], jobs))
    for k, page in zip(chosen, pages, strict=True):
        logs[k] = replace(logs[k], page=page)
    return logs


def _write_csv(path: Path, columns: Mapping[str, FloatArray]) -> None:
    """Write a canonical log that `read_logs` reads back; no time stamp, so the bytes repeat."""
    with (
        path.open("wb") as raw,
        gzip.GzipFile("", "wb", compresslevel=_LEVEL, fileobj=raw, mtime=0) as packed,
    ):
        for block in csv_blocks(columns):
            packed.write(block.encode("utf-8"))


CSV, PARQUET = ".csv.gz", ".parquet"
_WRITERS = {CSV: _write_csv, PARQUET: write_parquet}


def _name(
    folder: Path, logs: Sequence[_Written], names: Sequence[str], forms: Sequence[str]
) -> None:
    """Give the files of the logs their names, which all logs together decide."""
    (folder / "logs").mkdir()
    for one, name in zip(logs, names, strict=True):
        for form in forms:
            (folder / _UNNAMED / f"{one.page.number}{form}").rename(folder / f"{name}{form}")
    (folder / _UNNAMED).rmdir()


def _document(
    config: RunConfig, logs: Sequence[_Written], names: Sequence[str], forms: Sequence[str]
) -> dict[str, Any]:
    reports = [one.report for one in logs]
    keys = {CSV: "prepared", PARQUET: "parquet"}
    return {
        "schema": SCHEMA,
        "config": config.model_dump(mode="json", by_alias=True),
        "versions": versions(),
        "cautions": cautions_about(reports),
        "logs": [
            {**one.document, **{keys[form]: f"{name}{form}" for form in forms}}
            for one, name in zip(logs, names, strict=True)
        ],
        "pearson": pearson_table(reports).to_dict(orient="records"),
        "windows": windows_table(reports).to_dict(orient="records"),
        "window": config.smooth.window_at(logs[0].document["dt_s"]),
    }


def _write_tables(folder: Path, logs: Sequence[LogReport]) -> None:
    events = events_table(logs)
    events["start_s"] = events["start_s"].map(TIME_FORMAT.__mod__)
    for name, table in (
        ("events.csv", events),
        ("pearson.csv", pearson_table(logs)),
        ("windows.csv", windows_table(logs)),
    ):
        table["log"] = table["log"].map(text_cell)
        table.to_csv(folder / name, index=False, float_format="%.8g", lineterminator="\n")


def file_names(logs: Sequence[str]) -> list[str]:
    """Choose a file for each log by its name, with a number where two would share one.

    Without ending, as a log may be written in several forms.
    """
    found: dict[str, None] = {}
    for log in logs:
        plain = re.sub(r"\.(csv|parquet|txt)(\.gz)?", "", log)
        stem = re.sub(r"[^A-Za-z0-9._-]+", "_", plain)
        tries = (f"logs/{stem}{tail}" for tail in chain([""], map("({})".format, count(2))))
        found[next(name for name in tries if name not in found)] = None
    return list(found)


def _show(console: Console, logs: Sequence[_Written]) -> None:
    rows = []
    for one in logs:
        found = one.document
        lost = sum(sum(reasons.values()) for reasons in found["masked"].values())
        pushes, pulls = found["events"]["push"], found["events"]["pull"]
        minutes = f"{found['duration_s'] / 60.0:.1f}"
        rows.append([found["log"], minutes, str(pushes), str(pulls), str(lost)])
    console.table("Prepared logs", ["log", "minutes", "pushes", "pulls", "masked samples"], rows)
