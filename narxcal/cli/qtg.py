"""`narxcal qtg`: the qualification test guide of a run, as a PDF and a JSON document."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from data_prep.log import Log
from data_prep.prepare import cautions
from eval.qtg import (
    WORDS,
    Guide,
    evaluate_events,
    guide_of,
    read_master,
    read_tests,
    start_file,
)
from eval.report.qtg_pages import guide_pdf
from eval.run_logs import recorded_logs, run_config
from narxcal.calibration.bundle import Bundle, load_bundle
from narxcal.cli.console import Console
from narxcal.cli.options import add_data, add_logs, add_out_file, add_run, path
from narxcal.cli.results import check_pair, logs_for
from narxcal.support.files import atomic_write_bytes, atomic_write_text, check_file, to_json
from training.responses.rules import RULES, TOLERANCE_SHARE
from training.responses.transients import TransientsConfig


def add_options(parser: ArgumentParser) -> None:
    add_run(parser)
    add_logs(parser)
    parser.add_argument("--rules", choices=tuple(RULES), help="default: those of the run")
    parser.add_argument(
        "--data-source",
        choices=tuple(TOLERANCE_SHARE),
        help="of the validation data; default: that of the run",
    )
    add_out_file(parser, "FILE.pdf", "and FILE.json next to it")
    parser.add_argument(
        "--tests", metavar="FILE", type=path, help=".toml or .csv: tests, titles, rationales"
    )
    parser.add_argument(
        "--write-tests", metavar="FILE", type=path, help="write such a file of all events"
    )
    parser.add_argument(
        "--master", metavar="FILE.json", type=path, help="draw over the curves of an earlier guide"
    )
    add_data(parser, "folder of the held-out logs, if they have moved")


def run(options: Namespace, console: Console) -> int:
    """Write the guide; returns 1 where a test does not pass."""
    document = _check(options)
    listed = read_tests(options.tests) if options.tests else None
    master = read_master(options.master) if options.master else None
    bundle = load_bundle(options.bundle, trust=options.trust)
    logs = logs_for(bundle, options.logs, options.data, console)
    with console.progress("Evaluating"):
        recorded = recorded_logs(bundle, list(dict.fromkeys(Path(log.source.file) for log in logs)))
        events = evaluate_events(bundle, logs, _settings(bundle, options), recorded)
    if options.write_tests:
        atomic_write_text(options.write_tests, start_file(events, options.write_tests))
        console.say(f"Tests: {options.write_tests}")
    guide = guide_of(events, options.bundle.resolve().name, listed, options.tests, master)
    guide = replace(guide, cautions=_cautions(bundle, logs))
    with console.progress("Drawing the pages"):
        pages = guide_pdf(guide)
    found = guide.document()
    atomic_write_text(document, to_json(found))
    atomic_write_bytes(options.out, pages)
    _show(console, guide)
    console.finish(found, f"Guide: {options.out} and {document.name}")
    return 0 if guide.ok else 1


def _check(options: Namespace) -> Path:
    """Refuse, before any work is done, what cannot be written; returns the JSON file's path."""
    given = (options.bundle, options.tests, options.master, *(options.logs or ()))
    read = [each for each in given if each]
    document = check_pair(options, "the guide", (".pdf", ".json"), *read)
    if options.write_tests:
        check_file(options.write_tests, *read, overwrite=options.overwrite)
    return document


def _settings(bundle: Bundle, options: Namespace) -> TransientsConfig:
    given = {"rules": options.rules, "data_source": options.data_source}
    return run_config(bundle)[1].transients.model_copy(
        update={name: value for name, value in given.items() if value}
    )


def _cautions(bundle: Bundle, logs: Sequence[Log]) -> tuple[str, ...]:
    found = cautions(logs, run_config(bundle)[0], bundle.calibration.output_names)
    faults = [each.caution for log in logs for each in log.findings]
    return (*bundle.record.doubtful_logs, *found, *faults)


def _show(console: Console, guide: Guide) -> None:
    rows = [[test.number, test.one.event.log, test.view.when(test.one.event), WORDS[test.result]]
            for test in guide.tests]  # fmt: skip
    console.table(f"Tests by {guide.rules.source}", ["test", "log", "at", "result"], rows)
    counts = ", ".join(f"{number} {word}" for word, number in guide.counts.items() if number)
    console.say(f"{counts}; {len(guide.left_out)} other events are listed in the guide")
    for text in guide.cautions:
        console.warn(text)
