"""`narxcal crossval`: one calibration per division of the logs."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from collections.abc import Sequence

from data_prep.log import Log
from data_prep.prepare import cautions, prepare
from data_prep.reading import read_logs
from eval import terminal
from eval.crossval import SCHEMA, CrossValidation, cross_validate
from eval.report.page import RunHeader, crossval_page
from narxcal.cli.console import Console
from narxcal.cli.options import add_config, add_jobs, add_method
from narxcal.cli.results import data_files, now, read_config, with_method
from narxcal.support.files import Results, versions
from training.config import RunConfig
from training.pipeline import configured_files

PAGE = "crossval.html"
RESULTS = Results(SCHEMA, "crossval.json", (PAGE,))


def add_options(parser: ArgumentParser) -> None:
    """Add what the command takes to `parser`."""
    add_config(parser, "DIR", "folder for the tables and the page")
    add_method(parser)
    add_jobs(parser, "folds")


def run(options: Namespace, console: Console) -> int:
    """Cross-validate the configured logs; writes JSON and HTML, 1 where a tolerance was missed."""
    RESULTS.check(options.out)
    config, base = read_config(options.config, options.data)
    config = with_method(config, options.method)
    logs: list[Log] = []
    files = configured_files(config, base)
    with console.progress("Reading the logs") as advance:
        for number, file in enumerate(files):
            advance(number, len(files), file.name)
            logs += [one.log for one in prepare(read_logs(file, config.logs), config)]
    with console.progress("Calibrating the folds") as advance:
        found = cross_validate(config, base, logs, options.jobs, advance)
    document = found.document()
    warnings = cautions(logs, config, config.narx.outputs)
    RESULTS.save(options.out, document, crossval_page(_header(config, logs, warnings), found))
    _show(console, found)
    for text in warnings:
        console.warn(text)
    console.say(f"Page: {options.out / PAGE}")
    console.document(document)
    return found.outcome.exit_code


def _header(config: RunConfig, logs: Sequence[Log], warnings: Sequence[str]) -> RunHeader:
    return RunHeader(
        title=f"Cross-validation: {config.name}",
        created=now(),
        sources=data_files(log.source for log in logs),
        versions=versions(),
        config=config.model_dump_json(by_alias=True, indent=1),
        cautions=warnings,
    )


def _show(console: Console, found: CrossValidation) -> None:
    terminal.print_crossval(console.page, found)
    terminal.print_outcome(console.page, found.outcome)
    for scheme, reason in found.skipped.items():
        console.warn(f"{scheme} was left out: {reason}")
