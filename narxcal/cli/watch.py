"""`narxcal watch`: trends, steps and outliers of a fleet's engines over their flights."""

from __future__ import annotations

from argparse import ArgumentParser, ArgumentTypeError, Namespace

from eval.fleets.fleet import load_fleet, with_group
from eval.fleets.watch import watch
from eval.report.page import RunHeader
from eval.report.watch_page import console_rows, watch_page
from narxcal.cli.console import Console
from narxcal.cli.options import add_out_file, address, path
from narxcal.cli.results import check_pair
from narxcal.support.addresses import Folder
from narxcal.support.files import atomic_write_text, to_json


def add_options(parser: ArgumentParser) -> None:
    parser.add_argument(
        "fleet", metavar="FLEET", type=address, help="dataset that narxcal fleet wrote"
    )
    add_out_file(parser, "PAGE.html", "and PAGE.json next to it")
    parser.add_argument(
        "--engine",
        metavar="REGEX",
        type=_pattern,
        help="group 1 in a file's name is its engine; files that differ in it alone are one flight",
    )
    parser.add_argument(
        "--config", metavar="CONFIG", type=path,
        help="TOML file of the fleet, for commands with the places of flights and run",
    )  # fmt: skip


def _pattern(text: str) -> str:
    try:
        return with_group(text, "the engine")
    except ValueError as error:
        raise ArgumentTypeError(str(error)) from None


def run(options: Namespace, console: Console) -> int:
    """Watch a fleet; writes page and document, returns 1 where an alarm stands."""
    dataset = Folder(str(options.fleet))
    inputs = [] if dataset.local is None else [dataset.local]
    document = check_pair(options, "the page", (".html", ".json"), *inputs)
    place = {}
    if options.config:
        fleet = load_fleet(options.config)
        place = {"flights": fleet.flights, "run": fleet.run}
    with console.progress("Watching"):
        found = watch(dataset, options.engine)
    header = RunHeader(title="Fleet watch", run=str(options.fleet))
    result = found.document()
    atomic_write_text(options.out, watch_page(header, found, place))
    atomic_write_text(document, to_json(result))
    if found.alarms:
        console.table("Alarms", ["alarm", "of", "p", "may be"], console_rows(found))
    console.say(found.outcome.headline)
    console.finish(result, f"Page: {options.out} and {document.name}", found.remarks)
    return found.outcome.exit_code
