"""`narxcal evaluate`: a model in free run over whole logs, and its Ti and Tt."""

from __future__ import annotations

import ctypes
import json
import sys
from argparse import ArgumentParser, Namespace
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from data_prep.log import Log
from eval import terminal
from eval.judging.evaluate import SCHEMA, Evaluation, evaluate
from eval.report.page import RunHeader, evaluate_page
from eval.report.view import view_of
from eval.run_logs import changed_files, run_config
from narxcal.calibration.bundle import Bundle, load_bundle, read_document
from narxcal.cli.console import Console
from narxcal.cli.options import add_data, add_logs, add_run, fraction, path
from narxcal.cli.results import (
    data_files,
    hash_words,
    interval_words,
    lag_words,
    logs_for,
    steady_words,
)
from narxcal.support.files import Results

PAGE = "evaluate.html"
RESULTS = Results(SCHEMA, "evaluate.json", (PAGE,))


def add_options(parser: ArgumentParser) -> None:
    add_run(parser)
    add_logs(parser)
    parser.add_argument(
        "--trim",
        metavar="FRACTION",
        type=fraction,
        help="estimate offsets from this first part of each log, score the rest",
    )
    parser.add_argument("--out", metavar="DIR", type=path, help="folder (default RUN/evaluate)")
    add_data(parser, "folder of the held-out logs, if they have moved")


def default_output(options: Namespace) -> Path:
    folder: Path = options.bundle / "evaluate"
    return folder


def run(options: Namespace, console: Console) -> int:
    out = options.out or default_output(options)
    RESULTS.check(out)
    bundle = load_bundle(options.bundle, trust=options.trust)
    logs = logs_for(bundle, options.logs, options.data, console)
    found, document, page = report(bundle, logs, (options.bundle, options.trim), console)
    RESULTS.save(out, document, page)
    show(console, found)
    console.finish(document, f"Page: {out / PAGE}")
    return found.outcome.exit_code


def report(
    bundle: Bundle, logs: Sequence[Log], how: tuple[Path, float | None], console: Console
) -> tuple[Evaluation, dict[str, Any], str]:
    """Evaluate log by log; returns also document and page. `how`: the bundle's folder, the trim."""
    folder, trim = how
    _release_memory()  # that reading took
    with console.progress("Evaluating") as advance:
        found = evaluate(bundle, logs, trim or None, progress=advance)
    config, stored = run_config(bundle)[0], read_document(folder)
    with console.progress("Drawing the page"):
        header = _header(f"Evaluation: {config.name}", bundle, found, stored["sha256"])
        inputs = bundle.calibration.input_names
        views = [view_of(one, config.events.driver, inputs) for one in found.logs]
        page = evaluate_page(replace(header, run=str(folder)), views, found.outcome)
    document = {
        **found.document(),
        "run": str(folder),
        "weights_sha256": str(stored["weights"]["sha256"]),
        "verified": bool(bundle.sha256),
        "changed": changed_files(bundle, logs),
        "cautions": list(found.cautions),
    }
    return found, document, page


def _header(title: str, bundle: Bundle, found: Evaluation, sha256: str) -> RunHeader:
    record, rules = bundle.record, found.config.transients.rule_set
    calibration = bundle.calibration
    split = {f"{part.capitalize()} logs": logs for part, logs in record.split.items()}
    facts = {
        "Bundle": hash_words(sha256),
        "Interval": interval_words(calibration.interval, names=calibration.output_names),
        **{part: ", ".join(logs) for part, logs in split.items()},
        "Steady state": steady_words(record),
        "Lags": lag_words(record),
        "Seeds": ", ".join(map(str, record.seeds)),
        "Training": f"{record.training.status}, {record.training.wall_s:.0f} s",
        "Hardware": ", ".join(map(str, record.hardware.values())),
        "Constant inputs": bundle.certificate.words,
    }
    if not record.training.status:
        del facts["Training"]
    return RunHeader(
        title=title,
        model=f"{calibration.words}, over {', '.join(calibration.input_names)}",
        rules=rules.name,
        tolerances=f"Ti {rules.Ti}; Tt {rules.Tt} ({rules.source})",
        sources=data_files(one.log.source for one in found.logs),
        versions=record.versions,
        facts={label: text for label, text in facts.items() if text},
        config=json.dumps(record.config, indent=1),
        cautions=found.cautions,
    )


def _release_memory() -> None:
    """Give freed memory back to the system, where its C library (glibc) would keep it.

    It holds arrays of one size as scraps between those that stay: half a gigabyte after reading a
    flight of fifty hours.
    """
    if sys.platform != "win32" and hasattr(libc := ctypes.CDLL(None), "malloc_trim"):
        libc.malloc_trim(0)


def show(console: Console, found: Evaluation) -> None:
    terminal.print_transients(console.page, found.logs)
    terminal.print_scores(console.page, found.logs)
    terminal.print_interval(console.page, found.pooled)
    terminal.print_levels(console.page, found.logs)
    terminal.print_outcome(console.page, found.outcome)
    for caution in found.cautions:
        console.warn(caution)
