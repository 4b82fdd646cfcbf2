"""The page of `card`: steps that a pilot flies, and what they are expected to give."""

from __future__ import annotations

from typing import Final

from eval.card import Card, Step
from eval.report.page import RunHeader, render
from eval.report.style import unit
from eval.report.tables import Cell, Table, figure
from narxcal.channels import symbol

_MOST_ROWS: Final = 40  # of what is expected; the JSON document has all
_HEAD: Final = ("step", "at", "altitude and Mach", "set lever, settle", "move lever", "rate",
                "watch", "share")  # fmt: skip


def card_page(header: RunHeader, card: Card) -> str:
    """Build the page."""
    return render("card.html.j2", header=header, card=card, steps=steps(card), gains=_gains(card))


def steps(card: Card) -> Table:
    """A row per step, with the minute at which its altitude is left for or its lever set."""
    rows, clock, height = [], 0.0, card.steps[0].move.altitude_ft
    for number, one in enumerate(card.steps, 1):
        cells = _cells(card, one)
        rows.append((Cell(str(number), "head"), Cell(f"{clock:.1f} min", number=True), *cells))
        clock += one.move.minutes + card.limits.climb_min(height, one.move.altitude_ft)
        height = one.move.altitude_ft
    caption = f"{card.minutes:.1f} minutes; lever {card.lever} in {unit(card.lever) or '-'}"
    return Table(caption, _HEAD, tuple(rows))


def _cells(card: Card, one: Step) -> tuple[Cell, ...]:
    move = one.move
    parts = [f"{to:.4g}{f', hold {held:.0f} s' if held >= 0.5 else ''}"
             for to, _, held in move.steps if move.steps[0][1] > 0.0]  # fmt: skip
    if not parts:
        parts = [f"constant for {move.duration_s:.0f} s"]
    rates = sorted({f"{rate:.3g}/s" for _, rate, _ in move.steps if rate > 0.0})
    outside = "" if one.inside else ", outside the training logs"
    switched = f", {symbol(move.switch)} on" if move.switch else ""
    return (
        Cell(f"{move.altitude_ft:.0f} ft, {move.mach:.2f}{switched}"),
        Cell(f"{move.corners[0][1]:.4g}, {move.settle_s:.0f} s"),
        Cell(f"{move.name}: {'; '.join(parts)}"),
        Cell(", ".join(rates) or "-"),
        Cell(f"{_watched(card, one)}{outside}"),
        Cell(f"{100.0 * one.share:.0f} %", number=True),
    )


def _watched(card: Card, one: Step) -> str:
    """Expected ranges of the outputs, with their limits."""
    words = []
    for name, low, high in zip(card.outputs, one.low.tolist(), one.high.tolist(), strict=True):
        most = card.limits.highest.get(name)
        end = "" if most is None else f" (limit {most:.4g})"
        words.append(f"{symbol(name)} {low:.4g} to {high:.4g}{end}")
    return ", ".join(words)


def _gains(card: Card) -> Table:
    """What the flight is expected to give, the most first."""
    rows = tuple(
        (Cell(name, "head"), figure(before), figure(after), Cell(what))
        for name, before, after, what in card.expected[:_MOST_ROWS]
    )
    left = len(card.expected) - len(rows)
    caption = "Before and after the flight" + (f"; {left} more in the JSON document" * bool(left))
    return Table(caption, ("of", "before", "after", ""), rows)


def console_rows(card: Card) -> list[list[str]]:
    """A row per step for the command line."""
    return [[cell.text for cell in row[:6]] for row in steps(card).rows]


CONSOLE_HEAD: Final = list(_HEAD[:6])
