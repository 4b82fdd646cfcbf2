"""`narxcal compare`: several runs in free run on the same held-out rows, in one table."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from collections.abc import Sequence
from pathlib import Path
from textwrap import wrap

from eval import terminal
from eval.judging.compare import SCHEMA, Comparison, Run, compare_runs
from eval.report.page import RunHeader, compare_page
from narxcal.calibration.bundle import Bundle, load_bundle
from narxcal.cli.console import Console
from narxcal.cli.options import add_data, add_logs, add_out, add_trust, path
from narxcal.cli.results import data_files, hash_words, logs_for
from narxcal.support.errors import ConfigError
from narxcal.support.files import Results

PAGE = "compare.html"
RESULTS = Results(SCHEMA, "compare.json", (PAGE,))


def add_options(parser: ArgumentParser) -> None:
    parser.add_argument(
        "runs", metavar="RUN", type=path, nargs="+", help="folders of train or identify"
    )
    add_trust(parser)
    add_logs(parser)
    add_out(parser)
    add_data(parser, "folder of the held-out logs, if they have moved")


def run(options: Namespace, console: Console) -> int:
    RESULTS.check(options.out)
    runs = [
        Run(name, bundle, tuple(logs_for(bundle, options.logs, options.data, console)))
        for name, bundle in _opened(options.runs, trust=options.trust).items()
    ]  # fmt: skip
    with console.progress("Comparing"):
        found = compare_runs(runs)
    document = found.document()
    RESULTS.save(options.out, document, compare_page(_header(runs), found))
    _show(console, found)
    console.finish(document, f"Page: {options.out / PAGE}")
    return 0


def _opened(folders: Sequence[Path], *, trust: bool) -> dict[str, Bundle]:
    """Bundles by the names of their folders, or by their paths where names are equal."""
    if len({folder.resolve() for folder in folders}) < len(folders):
        raise ConfigError("a run is named twice", hint="Name each once")
    names = [folder.resolve().name for folder in folders]
    return {
        name if names.count(name) == 1 else str(folder): load_bundle(folder, trust=trust)
        for folder, name in zip(folders, names, strict=True)
    }


def _header(runs: Sequence[Run]) -> RunHeader:
    return RunHeader(
        title=f"Comparison: {runs[0].tables[0].name}",
        sources=data_files(log.source for log in runs[0].logs),
        facts={one.name: f"{one.bundle.calibration.words}; {hash_words(one.bundle.sha256)}"
               for one in runs},
    )  # fmt: skip


def _show(console: Console, found: Comparison) -> None:
    terminal.print_comparison(console.page, found)
    for line in (*found.summary(), *found.remarks):
        console.say("\n".join(wrap(line, 79, subsequent_indent="  ")))
