"""`narxcal prepare`: what is in the logs, before any model."""

from __future__ import annotations

import gzip
import re
from argparse import ArgumentParser, Namespace
from collections.abc import Sequence
from itertools import chain, count
from pathlib import Path
from typing import Any

import pandas as pd

from data_prep.equilibrium import while_running
from data_prep.log import Log
from data_prep.prepare import cautions
from data_prep.reading import read_logs
from data_prep.smooth import blurs
from data_prep.stamps import PRINTED
from eval.preparation import Prepared, events_table, pearson_table, study, windows_table
from eval.report.content import RunHeader
from eval.report.page import prepare_page, write_page
from narxcal.cli.console import Console
from narxcal.cli.options import add_config
from narxcal.cli.results import data_files, now, read_config
from narxcal.support.files import Results, to_json, versions
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
    studies = _studies(config.logs.resolve(base), config, console)
    names = file_names([one.log for one in studies])
    document = _document(config, studies, names)
    with RESULTS.writing(options.out) as folder:
        _write(folder, studies, names, document)
        write_page(folder / "prepare.html", _page(config, studies))
    _show(console, studies, options.out)
    for caution in document["cautions"]:
        console.warn(caution)
    console.document(document)
    return 0


def _studies(files: Sequence[Path], config: RunConfig, console: Console) -> list[Prepared]:
    studies = []
    with console.progress("Preparing") as advance:
        for number, file in enumerate(files):
            advance(number, len(files), file.name)
            runs = while_running(read_logs(file, config.logs), config.running)
            studies += [study(raw, config) for raw in runs]
    return studies


def _document(
    config: RunConfig, studies: Sequence[Prepared], names: Sequence[str]
) -> dict[str, Any]:
    prepared = zip(studies, names, strict=True)
    return {
        "schema": SCHEMA,
        "config": config.model_dump(mode="json", by_alias=True),
        "versions": versions(),
        "cautions": _cautions(config, studies),
        "logs": [{**one.to_dict(), "prepared": name} for one, name in prepared],
        "pearson": pearson_table(studies).to_dict(orient="records"),
        "windows": windows_table(studies).to_dict(orient="records"),
        "window": config.smooth.window_at(studies[0].log.dt_s),
    }


def _write(
    folder: Path, studies: Sequence[Prepared], names: Sequence[str], document: dict[str, Any]
) -> None:
    for one, name in zip(studies, names, strict=True):
        _write_log(folder / name, one.log)
    events = events_table(studies)
    events["start_s"] = events["start_s"].map(PRINTED.__mod__)
    for name, table in (
        ("events.csv", events),
        ("pearson.csv", pearson_table(studies)),
        ("windows.csv", windows_table(studies)),
    ):
        table.to_csv(folder / name, index=False, float_format="%.8g", lineterminator="\n")
    (folder / "prepare.json").write_text(to_json(document), encoding="utf-8")


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
    stamps = [PRINTED % stamp for stamp in log.time_s.tolist()]
    table = pd.DataFrame({"time_s": stamps, **log.channels})
    text = table.to_csv(index=False, float_format="%.9g", lineterminator="\n")
    path.write_bytes(gzip.compress(text.encode("utf-8"), compresslevel=6, mtime=0))


def _page(config: RunConfig, studies: Sequence[Prepared]) -> str:
    header = RunHeader(
        title=f"Prepared logs: {config.name}",
        created=now(),
        sources=data_files([one.log for one in studies]),
        versions=versions(),
        config=config.model_dump_json(by_alias=True, indent=1),
        cautions=_cautions(config, studies),
    )
    return prepare_page(header, [one.page() for one in studies], [one.trial for one in studies])


def _cautions(config: RunConfig, studies: Sequence[Prepared]) -> list[str]:
    logs = [one.log for one in studies]
    return list(
        filter(
            None,
            (
                *cautions(logs, config.events, config.narx.outputs, config.logs),
                blurs(config.smooth, logs),
            ),
        )
    )


def _show(console: Console, studies: Sequence[Prepared], out: Path) -> None:
    rows = []
    for one in studies:
        counts, masked = one.counts(), one.log.audit.masked()
        lost = sum(sum(reasons.values()) for reasons in masked.values())
        minutes = (one.log.time_s[-1] - one.log.time_s[0]) / 60.0
        rows.append(
            [one.log.name, f"{minutes:.1f}", str(counts["push"]), str(counts["pull"]), f"{lost}"]
        )
    console.table("Prepared logs", ["log", "minutes", "pushes", "pulls", "masked samples"], rows)
    console.say(f"Page: {out / 'prepare.html'}")
