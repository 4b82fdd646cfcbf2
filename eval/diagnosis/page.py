"""Tables of a diagnosis for terminal and page, and the page itself.

All but the curves of recorded and simulated outputs is made from `gap.json`.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, Final, NamedTuple

from eval.diagnosis import pictures
from eval.diagnosis.document import Evidence
from eval.diagnosis.flights import MOVES
from eval.diagnosis.words import (
    VERDICTS,
    Row,
    cause_words,
    is_sure,
    next_flights,
    outcome,
    parameter_words,
    percent,
    size_words,
)
from eval.report import style
from eval.report.page import RunHeader, render
from eval.report.style import Picture, number
from eval.report.tables import Cell, Table, plain
from eval.report.tables import row as line
from narxcal.channels import symbol
from narxcal.effects.library import effect, name_of
from narxcal.support.interrupt import is_interrupt

_SHOWN: Final = 8  # effects that are not claimed, in the terminal
_MOST_DRAWN: Final = 4


class Drawn(NamedTuple):
    """What an effect changes, and how it stands."""

    name: str
    standing: str
    sure: bool
    picture: Picture


def budget_table(document: Row) -> Table:
    """One row per cause: share of the whole gap with its interval, and how probable."""
    rows = tuple(
        line(
            cause,
            *map(plain, (*numbers, *map(percent, row["channels"].values()), probability)),
            " or ".join(row["credible_set"][1:]),
        )
        for row in document["budget"]
        for cause, *numbers, probability in [_cause(row)]
    )
    channels = document["budget"][0]["channels"] if document["budget"] else ()
    head = (
        "cause", "share", "interval", *(symbol(name) for name in channels), "probability",
        "or as well",
    )  # fmt: skip
    return Table("Shares of the energy of the whole gap; they add up to 100 %", head, rows)


def _cause(row: Row) -> list[str]:
    """Words of a cause, its share, interval and probability."""
    ends = f"{percent(row['low'])} to {percent(row['high'])}"
    chance = "" if row["probability"] is None else percent(row["probability"])
    return [cause_words(row["cause"]), percent(row["share"]), ends, chance]


def sizes_table(document: Row) -> Table:
    """Every effect that is not named: probability, its best size, and the least nameable one."""
    claimed = document["verdict"]["effects"]
    rows = []
    for row in document["effects"]:
        if name_of(row) in claimed or not row["parameters"]:
            continue
        first, size = next(iter(row["parameters"].items()))
        least = row["nameable"]
        unit = "" if size["unit"] == "-" else f" {size['unit']}"
        words = f"{parameter_words(first)} {size_words(size)}"
        smallest = "" if least is None else f"{number(least)}{unit}"
        rows.append(line(name_of(row), plain(percent(row["probability"])), words, plain(smallest)))
    head = ("effect", "probability", "if it acts", "least size that could be named")
    return Table("Effects that are not named", head, tuple(rows))


def console_tables(document: Row) -> Iterator[tuple[str, Sequence[str], list[list[str]]]]:
    """The same tables as text, narrow enough for a terminal."""
    rows = [[c.partition(" (")[0], *rest] for c, *rest in map(_cause, document["budget"])]
    yield "Where the gap's energy comes from", ("cause", "share", "interval", "probability"), rows
    table = sizes_table(document)
    short = [[cell.text for cell in row] for row in table.rows[:_SHOWN]]
    yield table.caption, ("effect", "probability", "if it acts", "least nameable"), short


def phase_table(document: Row) -> Table:
    """Channel against direction and phase; no rows where no part of the gap is above the noise."""
    found = {(r["channel"], r["direction"], r["phase"]): r for r in document["where"]}
    rows = [
        line(symbol(channel), *(_bin(found.get((channel, *move))) for move in MOVES))
        for channel in _channels(document)
    ]
    head = ("channel", "steady", *(" ".join(move) for move in MOVES[1:]))
    caption = (
        "Share of the gap's energy above the noise floor, with its 90 % interval. Bold: the fewest "
        "cells that hold 70 %. Initiation is up to 10 % of the response, transit up to 90 %, "
        "settling the rest of the event"
    )
    return Table(caption, head, tuple(rows))


def _bin(row: Row | None) -> Cell:
    if row is None:
        return Cell("")
    text = f"{percent(row['share'])} ({100 * row['low']:.0f} to {100 * row['high']:.0f})"
    return Cell(text, "strong" if row["core"] else "", number=True, level=row["share"])


def regime_table(document: Row) -> Table:
    """Channel against the levels of altitude, Mach, power and bleed."""
    shares: dict[str, dict[str, float]] = defaultdict(partial(defaultdict, float))
    for row in document["where"]:
        for regime, levels in row["regime_shares"].items():
            for level, part in levels.items():
                shares[f"{regime} {level}"][row["channel"]] += part * row["share"]
    rows = [
        line(symbol(n), *(Cell(percent(p[n]), number=True, level=p[n]) for p in shares.values()))
        for n in (_channels(document) if shares else ())
    ]
    caption = (
        "The same energy by regime; the levels of each add up to the whole. Altitude low is below "
        "10 000 ft, high from 25 000 ft; Mach low below 0.3, high from 0.6; power by thirds"
    )
    return Table(caption, ("channel", *shares), tuple(rows))


def _channels(document: Row) -> list[str]:
    """All channels in the order in which they were diagnosed; none where there is no gap."""
    there = any(row["share"] > 0.0 for row in document["where"])
    return list(document["quality"]["channels"]) if there else []


def shrink_table(document: Row) -> Table:
    """RMS of the gap per channel before and after the named effects are added, and the noise."""
    rows = tuple(
        line(style.with_unit(name), *(one[k] for k in ("before", "after", "floor")))
        for name, one in document["shrink"]["channels"].items()
    )
    caption = f"RMS of recorded less simulated, on {document['shrink']['on']}"
    return Table(caption, ("channel", "before", "after", "noise"), rows)


class Page(NamedTuple):
    """The HTML text, and which pictures could not be drawn, in a sentence each."""

    html: str
    failed: tuple[str, ...]


def budget_page(document: Row, evidence: Evidence, created: str = "") -> Page:
    """Build the page of `diagnose`; `created` is the time it bears.

    A picture that cannot be drawn is left out and named in the cautions.
    """
    failed: list[str] = []

    def drawn(what: str, make: Callable[..., Picture | None], *given: Any) -> Picture | None:
        try:
            return make(*given)
        except Exception as error:  # a picture may not cost the answer
            if is_interrupt(error):
                raise
            failed.append(f"{what} could not be drawn ({type(error).__name__}: {error})")
            return None

    named, shown = document["verdict"]["effects"], pictures.view_of(evidence)
    parts = {
        "budget": drawn("the budget", pictures.budget_picture, document),
        "where": [phase_table(document), regime_table(document)],
        "overlays": [
            drawn("the largest event", pictures.event_picture, shown),
            drawn("the gap over a flight", pictures.flight_picture, shown),
        ],
        "drawn": [
            Drawn(name, standing, name in named and is_sure(document, [name]), picture)
            for name, standing, row in shown_effects(document)
            if effect(name).applies(evidence.data.flights.signals)
            and (picture := drawn(name, pictures.effect_picture, evidence, row))
        ],
    }
    said = outcome(document)
    html = render(
        "budget.html.j2",
        header=header(document, created),
        document=document,
        cautions=(*document["quality"]["warnings"], *failed),
        outcome=said if is_sure(document, named) else replace(said, passed=None),
        word=VERDICTS[document["verdict"]["kind"]],
        budget_table=budget_table(document),
        sizes_table=sizes_table(document),
        shrink_table=shrink_table(document),
        next_flights=next_flights(document),
        **parts,
    )
    return Page(html, tuple(failed))


def shown_effects(document: Row) -> list[tuple[str, str, Row]]:
    """Effects to draw, how each stands, and its row: claimed ones and what may be instead.

    Where nothing is claimed though the gap is real, the best candidate.
    """
    verdict, rows = document["verdict"], {name_of(row): row for row in document["effects"]}
    known = [name for name in verdict["effects"] if name in rows]
    standings = {n: f"claimed, {percent(rows[n]['probability'])} probable" for n in known}
    standings |= dict.fromkeys(verdict["ambiguous_with"], "may be instead")
    if verdict["kind"] == "unknown" and rows:
        standings = {next(iter(rows)): "best candidate, not claimed"}
    found = [(name, standing, rows[name]) for name, standing in standings.items() if name in rows]
    return found[:_MOST_DRAWN]


def header(document: Mapping[str, Any], created: str) -> RunHeader:
    """What the page says about where it comes from."""
    quality = document["quality"]
    facts = {
        "Flights": ", ".join(quality["flights"]),
        "Held out": ", ".join(quality["held_out"]),
        "Rate": f"{quality['rate_hz']:.4g} Hz, processed at {quality['worked_at_hz']:.4g} Hz",
        "Driver": quality["driver"],
        "Computed in": f"{quality['wall_s']:.0f} s" if "wall_s" in quality else "",
    }
    return RunHeader(
        title="Diagnosis of the gap between simulator and engine",
        created=created,
        model=_compared(quality),
        versions=quality["versions"],
        facts={name: text for name, text in facts.items() if text},
    )


def _compared(quality: Mapping[str, Any]) -> str:
    kind, count = quality.get("simulator", "logs"), len(quality["flights"])
    flights = "one flight" if count == 1 else f"{count} flights"
    return f"{_SIMULATORS.get(kind, kind)}, compared with {flights}"


_SIMULATORS = {
    "logs": "simulated logs",
    "bundle": "a calibration of narxcal",
    "virtual engine": "the virtual engine",
    "function": "a function of Python",
}
