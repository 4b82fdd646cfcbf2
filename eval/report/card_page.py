"""The page of `card`: steps that a pilot flies, and what they are expected to give."""

from __future__ import annotations

import math
from typing import Final

from eval.card import Card, Step
from eval.report.page import RunHeader, render
from eval.report.style import number, unit
from eval.report.tables import Cell, Table, figure
from narxcal.channels import described, symbol

_MOST_ROWS: Final = 40  # of what is expected; the JSON document has all
_HEAD: Final = ("step", "at", "altitude and Mach", "set lever, settle", "move lever", "rate",
                "watch", "share", "flown")  # fmt: skip
_BOX: Final = "\N{BALLOT BOX}"
# What a pilot reads on a dial of a channel in this unit.
_READ: Final = {"%": 1.0, "deg": 1.0, "degC": 5.0, "kg/h": 10.0, "rpm": 10.0,
                "ft": 100.0}  # fmt: skip


def card_page(header: RunHeader, card: Card) -> str:
    return render("card.html.j2", header=header, card=card, steps=steps(card), gains=_gains(card))


def steps(card: Card) -> Table:
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
    """Expected ranges of the outputs, with their limits."""
    words = []
    for name, low, high in zip(card.outputs, one.low.tolist(), one.high.tolist(), strict=True):
        most = card.limits.highest.get(name)
        end = "" if most is None else f" (limit {_read(name, most, 'down')})"
        words.append(f"{symbol(name)} {_read(name, low)} to {_read(name, high)}{end}")
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
