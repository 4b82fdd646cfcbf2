"""`narxcal diagnose`: where a simulator and flights differ, which effect it is, how far it shrinks.

OUT holds `gap.json`, `gap.html` and, for `simulate --effects`, the emulator of the simulator.
"""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from eval.gap import budget
from eval.gap.budget_page import budget_page, console_tables, outcome
from eval.gap.diagnose import Diagnosis, Request, diagnose_folders
from eval.gap.page import gap_page
from eval.gap.stored_emulator import write_emulator
from eval.gap.summary import (
    EMULATOR,
    effect_table,
    no_load,
    sentence,
    shrink_table,
    to_tell,
    where_table,
    window_table,
)
from eval.report.page import write_page
from narxcal.calibration.bundle import DOCUMENT as BUNDLE
from narxcal.cli.console import Console
from narxcal.cli.options import SIMULATOR, add_mapping, add_out, add_trust, path
from narxcal.cli.results import now, read_config
from narxcal.support.errors import ConfigError
from narxcal.support.files import Results, to_json

DOCUMENT, PAGE = "gap.json", "gap.html"
RESULTS = Results("narxcal.gap/", DOCUMENT, (PAGE, EMULATOR))


def add_options(parser: ArgumentParser) -> None:
    """Add what the command takes to `parser`."""
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
        "--core",
        choices=("auto", "rules", "budget"),
        default="auto",
        help="decide by rules (narxcal.gap/1) or by the budget of the gap (narxcal.gap/2); auto: "
        "by the budget where the simulator is a run, which knows what it gets wrong by itself",
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

        def watch(step: str, done: int, total: int) -> None:
            advance(done, total, f"({step})")

        of_run = options.core == "auto" and (Path(options.sim) / BUNDLE).is_file()
        if of_run or options.core == "budget":
            new = of_run and budget.learned_by(Path(options.sim)) is None
            advance(0, 1, "(once per run: models without some of its flights)" if new else "")
            return _budget(options, console, budget.diagnose_folders(request))
        found = diagnose_folders(request, watch)
    with RESULTS.writing(options.out) as folder:
        write(folder, found)
    show(console, found.document)
    console.say(f"Page: {options.out / PAGE}")
    console.document(found.document)
    return 0


def _learn(options: Namespace, console: Console) -> int:
    """Keep in a run folder what it gets wrong by itself."""
    if not (options.out / BUNDLE).is_file():
        raise ConfigError("--learn needs a run folder as --out", file=options.out)
    with console.progress("Learning") as advance:
        advance(0, 1, "")
        if options.real is None and options.sim is None:
            found = budget.learn_left_out(options.out, trust=options.trust)
        else:
            found = budget.learn_folders(_request(options), options.out)
    flights = "1 flight" if found.flights == 1 else f"{found.flights} flights"
    console.say(f"Learned from {flights}: {options.out / budget.LEARNED}")
    console.document(found.document())
    return 0


def _budget(options: Namespace, console: Console, found: budget.Answer) -> int:
    """Write and print a budget."""
    with RESULTS.writing(options.out) as folder:
        (folder / DOCUMENT).write_text(to_json(found.document), encoding="utf-8")
        write_page(folder / PAGE, budget_page(found.document, found.evidence, now()))
        (folder / EMULATOR).mkdir()
        write_emulator(folder / EMULATOR, found.emulator)
    answer = outcome(found.document)
    for text in (answer.headline, *answer.lines):
        console.say(text)
    for title, head, rows in console_tables(found.document):
        console.table(title, head, rows)
    for text in found.document["quality"]["warnings"]:
        console.warn(text)
    console.say(f"Page: {options.out / PAGE}")
    console.document(found.document)
    return 0


def write(folder: Path, found: Diagnosis) -> None:
    """Write document, page and emulator into a folder."""
    (folder / DOCUMENT).write_text(to_json(found.document), encoding="utf-8")
    write_page(folder / PAGE, gap_page(found.document, found.evidence, now()))
    (folder / EMULATOR).mkdir()
    write_emulator(folder / EMULATOR, found.emulator)


def show(console: Console, document: Mapping[str, Any]) -> None:
    """Print the answer on one screen: sentence, effects, where, how far."""
    console.say(sentence(document))
    if reason := no_load(document):
        console.say(reason)
    if advice := to_tell(document):
        console.say(advice)
    for title, head, rows in (
        effect_table(document),
        window_table(document),
        where_table(document),
        shrink_table(document),
    ):
        if rows:
            console.table(title, head, rows)
    for text in document["quality"].get("warnings", ()):
        console.warn(text)


def _request(options: Namespace) -> Request:
    for name in ("real", "sim"):
        if getattr(options, name) is None:
            raise ConfigError(f"--{name} is required", hint="Name recorded and simulated flights")
    if options.heldout_sim is not None and options.heldout_real is None:
        raise ConfigError("--heldout-sim needs --heldout-real")
    if options.config is None:
        config = budget.mapping_of(options.sim, trust=options.trust)
    else:
        config = read_config(options.config, None)[0]
    return Request(
        options.real,
        options.sim,
        config,
        options.heldout_real,
        options.heldout_sim,
        options.trust,
    )
