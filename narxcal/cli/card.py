"""`narxcal card`: which lever moves to fly next, for a run or an undecided diagnosis."""

from __future__ import annotations

import math
from argparse import ArgumentParser, Namespace
from pathlib import Path
from typing import Final

from eval.cards.card import Card, Step, Wanted, calibration_card
from eval.diagnosis.separate import separation_card
from eval.report.page import RunHeader, render
from eval.report.style import number, unit
from eval.report.tables import Cell, Table, figure
from narxcal.calibration.bundle import load_bundle
from narxcal.channels import described, symbol
from narxcal.cli.console import Console
from narxcal.cli.diagnose import DOCUMENT as GAP
from narxcal.cli.options import add_data, add_out_file, add_trust, minutes, path
from narxcal.cli.results import check_pair
from narxcal.flight_test.moves import Limits
from narxcal.support.files import atomic_write_text, to_json
from narxcal.support.progress import Progress

_MOST_ROWS: Final = 40  # of what is expected; the JSON document has all
_HEAD: Final = ("step", "at", "altitude and Mach", "set lever, settle", "move lever", "rate",
                "watch", "share", "flown")  # fmt: skip
_BOX: Final = "\N{BALLOT BOX}"
# What a pilot reads on a dial of a channel in this unit.
_READ: Final = {"%": 1.0, "deg": 1.0, "degC": 5.0, "kg/h": 10.0, "rpm": 10.0,
                "ft": 100.0}  # fmt: skip


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
    steps = _steps(card)
    page = render("card.html.j2", header=header, card=card, steps=steps, gains=_gains(card))
    atomic_write_text(options.out, page)
    atomic_write_text(document, to_json(found))
    rows = [[cell.text for cell in row[:6]] for row in steps.rows]
    console.table("Card", list(_HEAD[:6]), rows)
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


def _steps(card: Card) -> Table:
    """A row per step, with the minute at which its altitude is left for or its lever set."""
    rows, clock, height = [], 0.0, card.steps[0].move.altitude_ft
    for place, one in enumerate(card.steps, 1):
        cells = _cells(card, one)
        rows.append((Cell(str(place), "head"), Cell(f"{clock:.1f} min", number=True), *cells))
        clock += one.move.minutes + card.limits.climb_min(height, one.move.altitude_ft)
        height = one.move.altitude_ft
    caption = f"{card.minutes:.1f} minutes; lever {symbol(card.lever)}"
    return Table(caption, _HEAD, tuple(rows))


def _cells(card: Card, one: Step) -> tuple[Cell, ...]:
    move = one.move
    parts = [f"{_read(card.lever, to)}{f', hold {held:.0f} s' if held >= 0.5 else ''}"
             for to, _, held in move.steps if move.steps[0][1] > 0.0]  # fmt: skip
    if not parts:
        parts = [f"constant for {move.duration_s:.0f} s"]
    rates = sorted(
        {f"{number(rate, 2)} {unit(card.lever)}/s" for _, rate, _ in move.steps if rate > 0.0}
    )
    outside = "" if one.inside else ", outside the training logs"
    switched = f", {symbol(move.switch)} on" if move.switch else ""
    return (
        Cell(f"{_read('ALT_ft', move.altitude_ft)}, Mach {move.mach:.2f}{switched}"),
        Cell(f"{_read(card.lever, move.corners[0][1])}, {move.settle_s:.0f} s"),
        Cell(f"{move.name}: {'; '.join(parts)}"),
        Cell(", ".join(rates) or "-"),
        Cell(f"{_watched(card, one)}{outside}"),
        Cell(f"{100.0 * one.share:.0f} %", number=True),
        Cell(_BOX),
    )


def _read(channel: str, value: float, ways: str = "near") -> str:
    """A value as a pilot reads it, with its unit; limits are rounded `down`."""
    known = described(channel).unit
    step = _READ.get(known, 0.0)
    if not step:
        return f"{value:.3g} {unit(channel)}".rstrip()
    whole = math.floor(value / step) if ways == "down" else round(value / step)
    return f"{whole * step:.0f} {unit(channel)}"


def _watched(card: Card, one: Step) -> str:
    words = []
    for name, low, high in zip(card.outputs, one.low.tolist(), one.high.tolist(), strict=True):
        most = card.limits.highest.get(name)
        end = "" if most is None else f" (limit {_read(name, most, 'down')})"
        words.append(f"{symbol(name)} {_read(name, low)} to {_read(name, high)}{end}")
    return ", ".join(words)


def _gains(card: Card) -> Table:
    rows = tuple(
        (Cell(name, "head"), figure(before), figure(after), Cell(what))
        for name, before, after, what in card.expected[:_MOST_ROWS]
    )
    left = len(card.expected) - len(rows)
    caption = "Before and after the flight" + (f"; {left} more in the JSON document" * bool(left))
    return Table(caption, ("of", "before", "after", ""), rows)
