"""`narxcal crossval`: one calibration per division of the logs."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace

from data_prep.log import Log
from data_prep.prepare import cautions, prepare
from data_prep.reading import read_logs
from eval import terminal
from eval.judging.crossval import SCHEMA, CrossValidation, cross_validate
from eval.report.page import crossval_page
from narxcal.cli.console import Console
from narxcal.cli.options import add_config, add_jobs, add_method
from narxcal.cli.results import config_header, read_config
from narxcal.support.files import Results
from training.pipeline import configured_files

PAGE = "crossval.html"
RESULTS = Results(SCHEMA, "crossval.json", (PAGE,))


def add_options(parser: ArgumentParser) -> None:
    add_config(parser, "DIR", "folder for the tables and the page")
    add_method(parser)
    add_jobs(parser, "folds")


def run(options: Namespace, console: Console) -> int:
    """Cross-validate the configured logs; writes JSON and HTML, 1 where a tolerance was missed."""
    RESULTS.check(options.out)
    config, base = read_config(options.config, options.data, options.method)
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
    sources = [log.source for log in logs]
    header = config_header(f"Cross-validation: {config.name}", config, sources, warnings)
    RESULTS.save(options.out, document, crossval_page(header, found))
    _show(console, found)
    console.finish(document, f"Page: {options.out / PAGE}", warnings)
    return found.outcome.exit_code


def _show(console: Console, found: CrossValidation) -> None:
    terminal.print_crossval(console.page, found)
    terminal.print_outcome(console.page, found.outcome)
    for scheme, reason in found.skipped.items():
        console.warn(f"{scheme} was left out: {reason}")
