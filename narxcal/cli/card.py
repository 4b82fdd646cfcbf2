"""`narxcal card`: which lever moves to fly next, for a run or an undecided diagnosis."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from pathlib import Path

from eval.card import Card, Wanted, calibration_card
from eval.diagnosis.separate import separation_card
from eval.report.card_page import CONSOLE_HEAD, card_page, console_rows
from eval.report.page import RunHeader
from narxcal.calibration.bundle import load_bundle
from narxcal.cli.console import Console
from narxcal.cli.diagnose import DOCUMENT as GAP
from narxcal.cli.options import add_data, add_out_file, add_trust, minutes, path
from narxcal.cli.results import check_pair
from narxcal.flight_test.moves import Limits
from narxcal.support.files import atomic_write_text, to_json
from narxcal.support.progress import Progress


def add_options(parser: ArgumentParser) -> None:
    parser.add_argument(
        "source", metavar="RUN|gap.json", type=path,
        help="folder that train wrote, or the undecided result of diagnose",
    )  # fmt: skip
    parser.add_argument(
        "--aircraft", metavar="LIMITS.toml", type=path, required=True, help="limits to keep"
    )
    parser.add_argument(
        "--minutes", metavar="N", type=minutes, default=20.0, help="flight time (default 20)"
    )
    add_out_file(parser, "CARD.html", "and CARD.json next to it")
    parser.add_argument(
        "--criterion",
        choices=("D", "I"),
        default="D",
        help="of a run: D, intervals of its parameters (default), or I, of its predictions",
    )
    add_data(parser, "folder of the run's training logs, if they have moved")
    add_trust(parser)


def run(options: Namespace, console: Console) -> int:
    """Plan the flight and write page and document."""
    document = check_pair(options, "the page", (".html", ".json"), options.source, options.aircraft)
    wanted = Wanted(Limits.read(options.aircraft), options.minutes, options.criterion)
    with console.progress("Planning") as advance:
        card = _card(options, wanted, advance)
    header = RunHeader(
        title="Flight card",
        run=str(options.source),
        facts={"Limits": str(options.aircraft), "Time": f"{options.minutes:g} minutes"},
        cautions=card.cautions,
    )
    found = {**card.document(), "source": str(options.source)}
    atomic_write_text(options.out, card_page(header, card))
    atomic_write_text(document, to_json(found))
    console.table("Card", CONSOLE_HEAD, console_rows(card))
    console.say(card.headline)
    console.finish(found, f"Page: {options.out} and {document.name}", card.cautions)
    return 0


def _card(options: Namespace, wanted: Wanted, progress: Progress) -> Card:
    source: Path = options.source
    gap = source / GAP if (source / GAP).is_file() else source
    if gap.is_file():
        return separation_card(gap, wanted)
    bundle = load_bundle(source, trust=options.trust)
    return calibration_card(bundle, wanted, options.data, progress)
