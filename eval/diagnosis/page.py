"""Tables of a diagnosis for terminal and page, and the page itself.

All but the curves of recorded and simulated outputs is made from `gap.json`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any, Final, NamedTuple

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from eval.diagnosis import pictures
from eval.diagnosis.document import Evidence
from eval.diagnosis.drawings import drawing
from eval.diagnosis.words import (
    VERDICTS,
    Row,
    cause_words,
    is_sure,
    listed,
    next_flights,
    outcome,
    parameter_words,
    percent,
    size_words,
)
from eval.report import style
from eval.report.page import RunHeader, render
from eval.report.style import Picture, number, picture
from eval.report.tables import Cell, Table, figure
from narxcal.channels import symbol
from narxcal.effects.library import effect, name_of
from narxcal.support.interrupt import is_interrupt
from training.diagnosis.budget import Interval

_OTHERS: Final = {
    "build": style.MASK,
    "offsets": "#8c959f",
    "noise": "#f0f2f5",
    "unexplained": "#24292f",
}
_SHOWN: Final = 8  # effects that are not claimed, in the terminal
_LEAST: Final = 0.02  # of a bar: a part that a number fits into
_MOST_DRAWN: Final = 4


class Drawn(NamedTuple):
    """An effect drawn as an engineer draws it, and what it stands for."""

    name: str
    standing: str
    sure: bool
    picture: Picture


def budget_table(document: Row) -> Table:
    """One row per cause: share of the whole gap with its interval, and how probable."""
    rows = tuple(
        (
            Cell(cause_words(row["cause"]), "head"),
            Cell(percent(row["share"]), number=True),
            Cell(f"{percent(row['low'])} to {percent(row['high'])}", number=True),
            *(Cell(percent(value), number=True) for value in row["channels"].values()),
            Cell("" if row["probability"] is None else percent(row["probability"]), number=True),
            Cell(" or ".join(row["credible_set"][1:])),
        )
        for row in document["budget"]
    )
    channels = document["budget"][0]["channels"] if document["budget"] else ()
    head = (
        "cause", "share", "interval", *(symbol(name) for name in channels), "probability",
        "or as well",
    )  # fmt: skip
    return Table("Shares of the energy of the whole gap; they add up to 100 %", head, rows)


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
        rows.append(
            (
                Cell(name_of(row), "head"),
                Cell(percent(row["probability"]), number=True),
                Cell(f"{parameter_words(first)} {size_words(size)}"),
                Cell("" if least is None else f"{number(least)}{unit}", number=True),
            )
        )
    head = ("effect", "probability", "if it acts", "least size that could be named")
    return Table("Effects that are not named", head, tuple(rows))


def console_tables(document: Row) -> Iterator[tuple[str, Sequence[str], list[list[str]]]]:
    """The same tables as text, narrow enough for a terminal."""
    rows = [
        [
            cause_words(row["cause"]).partition(" (")[0],
            percent(row["share"]),
            f"{percent(row['low'])} to {percent(row['high'])}",
            "" if row["probability"] is None else percent(row["probability"]),
        ]
        for row in document["budget"]
    ]
    yield "Where the gap's energy comes from", ("cause", "share", "interval", "probability"), rows
    table = sizes_table(document)
    short = [[cell.text for cell in row] for row in table.rows[:_SHOWN]]
    yield table.caption, ("effect", "probability", "if it acts", "least nameable"), short


def budget_picture(document: Row) -> Picture | None:
    """Bars of the whole gap, of each channel and of each phase, divided by cause; None without."""
    rows = document["budget"]
    if not rows or sum(row["share"] for row in rows) <= 0.0:
        return None
    names = listed([cause_words(row["cause"]) for row in rows])
    caption = "Squared gap, each channel over its range squared; 1 is the whole gap."
    alt = f"Shares of {names} in the gap, by channel and by phase"
    return picture(budget_figure(rows), alt, caption)


def budget_figure(rows: Sequence[Row]) -> Figure:
    """The same as a matplotlib figure, from the rows of `budget`."""
    drawn = style.figure(10.0, 0.9 + 0.3 * len(_bars(rows)))
    draw_budget(drawn.add_subplot(), rows)
    return drawn


def _bars(rows: Sequence[Row]) -> dict[str, list[float]]:
    """Label of each bar, and its shares in the order of `rows`."""
    bars = {"whole gap": [row["share"] for row in rows]}
    bars |= {symbol(c): [row["channels"][c] for row in rows] for c in rows[0]["channels"]}
    return bars | {
        phase.replace("_", ", "): [row["phases"][phase] for row in rows]
        for phase in rows[0]["phases"]
        if sum(row["phases"][phase] for row in rows) > 0.0
    }


def draw_budget(axes: Axes, rows: Sequence[Row]) -> None:
    """Draw the bars of `budget_figure` on given axes."""
    effects = [row["cause"] for row in rows if row["cause"] not in _OTHERS]
    colours = dict(zip(effects, style.CYCLE * (1 + len(effects) // len(style.CYCLE)), strict=False))
    bars = _bars(rows)
    for place, (label, shares) in enumerate(bars.items()):
        _bar(axes, place, shares, [{**_OTHERS, **colours}[row["cause"]] for row in rows])
        axes.text(-0.01, place, label, ha="right", va="center", fontsize=8)
    for row in rows:
        colour = {**_OTHERS, **colours}[row["cause"]]
        axes.barh(
            -1, 0.0, color=colour, edgecolor="#8c959f", lw=0.4, label=cause_words(row["cause"])
        )
    axes.set(ylim=(len(bars) - 0.4, -0.6), xlim=(0.0, 1.0), yticks=())
    axes.set_xlabel("share of the energy of the whole gap")
    style.dress(axes, grid="x")
    style.legend(axes, columns=3)


def _bar(axes: Axes, place: int, shares: Sequence[float], colours: Sequence[str]) -> None:
    left = 0.0
    for share, colour in zip(shares, colours, strict=True):
        width = max(share, 0.0)
        axes.barh(place, width, left=left, color=colour, edgecolor="white", lw=0.5, height=0.7)
        if width >= _LEAST:
            ink = "white" if colour in ("#24292f", *style.CYCLE[:3]) else "#24292f"
            text = f"{100.0 * width:.0f}"
            axes.text(
                left + 0.5 * width, place, text, ha="center", va="center", fontsize=7, color=ink
            )
        left += width


def shrink_table(document: Row) -> Table:
    """RMS of the gap per channel before and after the named effects are added, and the noise."""
    rows = tuple(
        (
            Cell(style.with_unit(name), "head"),
            *(figure(one[k]) for k in ("before", "after", "floor")),
        )
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

    own, held = pictures.views(evidence)
    named = document["verdict"]["effects"]
    shown = own if held is None else held
    parts = {
        "budget": drawn("the budget", budget_picture, document),
        "where": [
            drawn("the map of phases", pictures.phase_map, document),
            drawn("the map of regimes", pictures.regime_map, document),
        ],
        "overlays": [
            drawn("the largest event", pictures.event_picture, shown),
            drawn("the gap over a flight", pictures.flight_picture, shown),
        ],
        "drawn": [
            Drawn(name, standing, name in named and is_sure(document, [name]), picture)
            for name, standing, sizes in shown_effects(document)
            if effect(name).applies(evidence.data.flights.signals)
            and (picture := drawn(name, drawing, effect(name), sizes, own.data.flights.signals))
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


def shown_effects(document: Row) -> list[tuple[str, str, dict[str, Interval]]]:
    """Effects to draw, how each stands, and its sizes: claimed ones and what may be instead.

    Where nothing is claimed though the gap is real, the best candidate.
    """
    verdict = document["verdict"]
    rows = {name_of(row): row for row in document["effects"]}
    standings = {
        name: f"claimed, {percent(rows[name]['probability'])} probable"
        for name in verdict["effects"]
        if name in rows
    }
    standings |= dict.fromkeys(verdict["ambiguous_with"], "may be instead")
    if verdict["kind"] == "unknown" and rows:
        standings = {next(iter(rows)): "best candidate, not claimed"}
    found = [
        (
            name,
            standing,
            {
                key: Interval(each["value"], each["low"], each["high"])
                for key, each in rows[name]["parameters"].items()
            },
        )
        for name, standing in standings.items()
        if name in rows
    ]
    return found[:_MOST_DRAWN]


def header(document: Mapping[str, Any], created: str) -> RunHeader:
    """What the page says about where it comes from."""
    quality = document["quality"]
    facts = {
        "Flights": ", ".join(quality.get("flights", ())),
        "Held out": ", ".join(quality.get("held_out", ())),
        "Rate": _rate(quality),
        "Driver": quality.get("driver", ""),
        "Computed in": f"{quality['wall_s']:.0f} s" if "wall_s" in quality else "",
    }
    return RunHeader(
        title="Diagnosis of the gap between simulator and engine",
        created=created,
        model=_compared(quality),
        versions=quality.get("versions", {}),
        facts={name: text for name, text in facts.items() if text},
    )


def _compared(quality: Mapping[str, Any]) -> str:
    kind, count = quality.get("simulator", "logs"), len(quality.get("flights", ()))
    flights = "one flight" if count == 1 else f"{count} flights"
    return f"{_SIMULATORS.get(kind, kind)}, compared with {flights}"


_SIMULATORS = {
    "logs": "simulated logs",
    "bundle": "a calibration of narxcal",
    "virtual engine": "the virtual engine",
    "function": "a function of Python",
}


def _rate(quality: Mapping[str, Any]) -> str:
    if "rate_hz" not in quality:
        return ""
    return f"{quality['rate_hz']:.4g} Hz, processed at {quality.get('worked_at_hz', 0.0):.4g} Hz"
