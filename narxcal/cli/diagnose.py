"""`narxcal diagnose`: where a simulator and flights differ, which effect it is, how far it shrinks.

OUT holds `gap.json`, `gap.html` and, for `simulate --effects`, the emulator of the simulator.
"""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from eval.diagnosis.applied import EMULATOR, write_emulator
from eval.diagnosis.diagnose import Answer, Request, diagnose_folders, learn_folders
from eval.diagnosis.learned import LEARNED, keep_learned, learn_left_out
from eval.diagnosis.page import budget_page, console_tables
from eval.diagnosis.words import outcome
from eval.judging.outcome import plural
from eval.report.page import now
from narxcal.calibration.bundle import DOCUMENT as BUNDLE
from narxcal.cli.console import Console
from narxcal.cli.options import SIMULATOR, add_mapping, add_out, add_trust, path
from narxcal.cli.results import read_config
from narxcal.support.errors import ConfigError
from narxcal.support.files import Results

DOCUMENT, PAGE = "gap.json", "gap.html"
RESULTS = Results("narxcal.gap/", DOCUMENT, (PAGE, EMULATOR))


def add_options(parser: ArgumentParser) -> None:
    parser.add_argument("--real", metavar="DIR", type=path, help="folder of the flights' logs")
    parser.add_argument("--sim", metavar="SIM", help=f"{SIMULATOR}; logs are paired by file name")
    add_out(parser)
    add_mapping(parser)
    add_trust(parser)
    parser.add_argument(
        "--heldout-real", metavar="DIR", type=path, help="flights to check the shrinkage on"
    )
    parser.add_argument("--heldout-sim", metavar="SIM", help="their simulated logs")
    parser.add_argument(
        "--build",
        choices=("type", "same"),
        default="type",
        help="the simulator is of an engine of the same type (default), whose builds differ, or of "
        "this very engine: steady shifts are then effects",
    )
    parser.add_argument(
        "--build-tolerance",
        metavar="SHARE",
        type=float,
        help="with --build same: share of the differences of type that may be left, default 0",
    )
    parser.add_argument(
        "--learn",
        action="store_true",
        help="diagnose nothing: learn what the run OUT gets wrong by itself and keep it there, "
        "from its training flights by models without them, or from flights of --real that SIM was "
        "not fitted to",
    )


def run(options: Namespace, console: Console) -> int:
    """Diagnose and write document, page and emulator; 0 whatever the verdict."""
    if options.learn:
        return _learn(options, console)
    request = _request(options)
    RESULTS.check(options.out)
    with console.progress("Diagnosing") as advance:
        found = diagnose_folders(request, advance)
    with RESULTS.writing(options.out) as folder:
        document = write(folder, found)
    show(console, document)
    console.finish(document, f"Page: {options.out / PAGE}")
    return 0


def _learn(options: Namespace, console: Console) -> int:
    """Keep in a run folder what it gets wrong by itself."""
    if not (options.out / BUNDLE).is_file():
        raise ConfigError("--learn needs a run folder as --out", file=options.out)
    with console.progress("Learning") as advance:
        advance(0, 1, "")
        if options.real is None and options.sim is None:
            found = learn_left_out(options.out, trust=options.trust)
            keep_learned(found, options.out)
        else:
            found = learn_folders(_request(options), options.out)
    flights = plural(found.flights, "flight")
    console.finish(found.document(), f"Learned from {flights}: {options.out / LEARNED}")
    return 0


def write(folder: Path, found: Answer) -> dict[str, Any]:
    """Write document, page and emulator into a folder; returns the document as it is written.

    Pictures that could not be drawn are among its warnings.
    """
    page = budget_page(found.document, found.evidence, now())
    quality = found.document["quality"]
    quality = {**quality, "warnings": [*quality["warnings"], *page.failed]}
    document = {**found.document, "quality": quality}
    RESULTS.write(folder, document, page.html)
    (folder / EMULATOR).mkdir()
    write_emulator(folder / EMULATOR, found.evidence.emulator)
    return document


def show(console: Console, document: Mapping[str, Any]) -> None:
    answer = outcome(document)
    for text in (answer.headline, *answer.lines):
        console.say(text)
    for title, head, rows in console_tables(document):
        console.table(title, head, rows)
    for text in document["quality"]["warnings"]:
        console.warn(text)


def _request(options: Namespace) -> Request:
    for name in ("real", "sim"):
        if getattr(options, name) is None:
            raise ConfigError(f"--{name} is required", hint="Name recorded and simulated flights")
    if options.heldout_sim is not None and options.heldout_real is None:
        raise ConfigError("--heldout-sim needs --heldout-real")
    config = None if options.config is None else read_config(options.config, None)[0]
    if options.build_tolerance is not None and options.build != "same":
        raise ConfigError("--build-tolerance needs --build same")
    build = 1.0 if options.build == "type" else options.build_tolerance or 0.0
    if not 0.0 <= build <= 1.0:
        raise ConfigError(f"--build-tolerance: expected a share from 0 to 1, found {build:g}")
    return Request(
        options.real,
        options.sim,
        config,
        options.heldout_real,
        options.heldout_sim,
        options.trust,
        build,
    )
