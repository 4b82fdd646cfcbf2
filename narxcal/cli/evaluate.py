"""`narxcal evaluate`: a model in free run over whole logs, and its Ti and Tt."""

from __future__ import annotations

import ctypes
import sys
from argparse import ArgumentParser, Namespace
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from data_prep.log import Log
from eval import terminal
from eval.judging.evaluate import SCHEMA
from eval.report.page import evaluate_page
from eval.results import Judgement, changed, judge
from eval.run_logs import run_config
from narxcal.calibration.bundle import Bundle, load_bundle, read_document
from narxcal.cli.console import Console
from narxcal.cli.options import add_data, add_logs, add_run, fraction, path
from narxcal.cli.results import header_of, logs_for
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
    """Where the results go without --out."""
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
) -> tuple[Judgement, dict[str, Any], str]:
    """Evaluate log by log; returns also document and page. `how`: the bundle's folder, the trim."""
    folder, trim = how
    _release_memory()  # that reading took
    with console.progress("Evaluating") as advance:
        found = judge(bundle, logs, trim, advance)
    config, settings = run_config(bundle)
    rules = settings.transients.rule_set
    header = header_of(f"Evaluation: {config.name}", folder, bundle, logs, rules)
    facts = {**header.facts, "Constant inputs": bundle.certificate.words}
    with console.progress("Drawing the page"):
        header = replace(header, facts=facts, cautions=found.cautions)
        page = evaluate_page(header, found.views, found.outcome)
    document = {
        **found.evaluation.document(),
        "run": str(folder),
        "weights_sha256": str(read_document(folder)["weights"]["sha256"]),
        "verified": bool(bundle.sha256),
        "changed": changed(bundle, logs),
        "cautions": list(found.cautions),
    }
    return found, document, page


def _release_memory() -> None:
    """Give freed memory back to the system, where its C library (glibc) would keep it.

    It holds arrays of one size as scraps between those that stay: half a gigabyte after reading a
    flight of fifty hours.
    """
    if sys.platform != "win32" and hasattr(libc := ctypes.CDLL(None), "malloc_trim"):
        libc.malloc_trim(0)


def show(console: Console, found: Judgement) -> None:
    terminal.print_transients(console.page, found.evaluation.logs)
    terminal.print_scores(console.page, found.evaluation.logs)
    terminal.print_interval(console.page, found.evaluation.pooled)
    terminal.print_levels(console.page, found.evaluation.logs)
    terminal.print_outcome(console.page, found.outcome)
    for caution in found.cautions:
        console.warn(caution)
