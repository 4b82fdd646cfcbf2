"""A budget for people: its sentences, its tables for terminal and page, and the page itself.

All but the overlays of recorded and simulated curves is made from `gap.json` (narxcal.gap/2).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from eval.gap import heat_maps
from eval.gap.effect_words import in_words, listed, size_words, surest_words
from eval.gap.evidence import Evidence
from eval.gap.overlays import event_picture, flight_picture, views
from eval.gap.page import drawn_effects, header
from eval.outcome import Outcome
from eval.report import style
from eval.report.page import render
from eval.report.style import Picture, picture
from eval.report.tables import Cell, Table, figure, number
from narxcal.channels import symbol
from narxcal.effects.library import effect

NAMED: Final = {
    "build": "differences of build",
    "offsets": "flight offsets",
    "noise": "noise",
    "unexplained": "explained by nothing in the library",
}
_OTHERS: Final = {
    "build": style.MASK,
    "offsets": "#8c959f",
    "noise": "#f0f2f5",
    "unexplained": "#24292f",
}
_WORDS: Final = {
    "none": "✓ NO EFFECT",
    "effects": "● FOUND",
    "ambiguous": "≈ NOT TOLD APART",
    "unknown": "? I DON'T KNOW",
}
_SHOWN: Final = 8  # effects that are not claimed, in the terminal
_LEAST: Final = 0.02  # of a bar: a part that a number fits into
Row = Mapping[str, Any]


def name_of(row: Row) -> str:
    """Name of an effect by its row: `id`, or `id:channel`."""
    return f"{row['id']}:{row['channel']}" if row.get("channel") else str(row["id"])


def sentences(document: Row) -> list[str]:
    """The verdict: one sentence for each effect that is named, then what is left."""
    verdict, rows = document["verdict"], {name_of(row): row for row in document["effects"]}
    shares = {row["cause"]: row for row in document["budget"]}
    found = [_claim(name, rows[name], shares) for name in verdict["effects"] if name in rows]
    if not found:
        reason = verdict["reason"].rstrip(".")
        found = [f"No effect is named: {reason}."]
    if verdict["ambiguous_with"]:
        others = listed([in_words(name) for name in verdict["ambiguous_with"]], "or")
        found.append(f"These flights do not tell it from {others}.")
    left = shares.get("unexplained")
    if left is not None:
        found.append(
            f"{_percent(left['share'])} of the whole gap is explained by nothing in the library."
        )
    return found


def _claim(name: str, row: Row, shares: Mapping[str, Row]) -> str:
    text = f"{in_words(name)}, {surest_words(row)}"
    share = shares.get(name)
    if share is None:
        return f"{text[:1].upper()}{text[1:]}."
    most = max(share["channels"], key=lambda each: share["channels"][each])
    whole = sum(each["channels"].get(most, 0.0) for each in shares.values())
    part = share["channels"][most] / whole if whole > 0.0 else 0.0
    text += f": {_percent(share['share'])} of the gap, {_percent(part)} of that of {symbol(most)}"
    return f"{text[:1].upper()}{text[1:]}."


def outcome(document: Row) -> Outcome:
    """The verdict box: what is named, how sure, and how far the gap shrinks."""
    first, *rest = sentences(document)
    shrink = document["shrink"]
    if document["verdict"]["effects"]:
        low, high = (_percent(shrink["predicted"][key]) for key in ("low", "high"))
        text = f"Added to the simulator they take {_percent(shrink['predicted']['value'])} "
        text += f"({low} to {high}) off the squared gap"
        if shrink["realised"] is not None:
            text += f"; on {shrink['on']} it is {_percent(shrink['realised'])}"
        rest.append(f"{text}.")
        rest += _events(shrink)
    return Outcome(document["verdict"]["kind"] != "unknown" or None, first, tuple(rest))


def _events(shrink: Row) -> Iterator[str]:
    """Errors of the response times before and after, where events could be read."""
    for name, times in shrink["times"].items():
        if times["events"]:
            text = ", ".join(
                f"{each} {number(times[f'{each}_before_s'])} s before, "
                f"{number(times[f'{each}_after_s'])} s after"
                for each in ("Ti", "Tt")
            )
            yield f"Mean error of {symbol(name)} over {times['events']} events: {text}."


def budget_table(document: Row) -> Table:
    """One row per cause: share of the whole gap with its interval, and how probable."""
    rows = tuple(
        (
            Cell(_cause(row["cause"]), "head"),
            Cell(_percent(row["share"]), number=True),
            Cell(f"{_percent(row['low'])} to {_percent(row['high'])}", number=True),
            *(Cell(_percent(value), number=True) for value in row["channels"].values()),
            Cell("" if row["probability"] is None else _percent(row["probability"]), number=True),
            Cell(" or ".join(row["credible_set"][1:])),
        )
        for row in document["budget"]
    )
    channels = document["budget"][0]["channels"] if document["budget"] else ()
    head = (
        "cause", "share", "interval", *(symbol(name) for name in channels), "probability",
        "not told from",
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
                Cell(_percent(row["probability"]), number=True),
                Cell(f"{first} {size_words(size)}"),
                Cell("" if least is None else f"{number(least)}{unit}", number=True),
            )
        )
    head = ("effect", "probability", "if it acts", "least size that could be named")
    return Table("Effects that are not named", head, tuple(rows))


def console_tables(document: Row) -> Iterator[tuple[str, Sequence[str], list[list[str]]]]:
    """The same tables as text, narrow enough for a terminal."""
    rows = [
        [
            _cause(row["cause"]).partition(" (")[0],
            _percent(row["share"]),
            f"{_percent(row['low'])} to {_percent(row['high'])}",
            "" if row["probability"] is None else _percent(row["probability"]),
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
    names = listed([_cause(row["cause"]) for row in rows])
    caption = "Squared gap, each channel over its range squared; 1 is the whole gap."
    alt = f"Shares of {names} in the gap, by channel and by phase"
    return picture(budget_figure(rows), alt, caption)


def budget_figure(rows: Sequence[Row]) -> Figure:
    """The same as a matplotlib figure, from the rows of `budget`."""
    effects = [row["cause"] for row in rows if row["cause"] not in _OTHERS]
    colours = dict(zip(effects, style.CYCLE * (1 + len(effects) // len(style.CYCLE)), strict=False))
    bars = {"whole gap": [row["share"] for row in rows]}
    bars |= {symbol(c): [row["channels"][c] for row in rows] for c in rows[0]["channels"]}
    bars |= {
        phase.replace("_", ", "): [row["phases"][phase] for row in rows]
        for phase in rows[0]["phases"]
        if sum(row["phases"][phase] for row in rows) > 0.0
    }
    drawn = style.figure(10.0, 0.9 + 0.3 * len(bars))
    axes = drawn.add_subplot()
    for place, (label, shares) in enumerate(bars.items()):
        _bar(axes, place, shares, [{**_OTHERS, **colours}[row["cause"]] for row in rows])
        axes.text(-0.01, place, label, ha="right", va="center", fontsize=8)
    for row in rows:
        colour = {**_OTHERS, **colours}[row["cause"]]
        axes.barh(-1, 0.0, color=colour, edgecolor="#8c959f", lw=0.4, label=_cause(row["cause"]))
    axes.set(ylim=(len(bars) - 0.4, -0.6), xlim=(0.0, 1.0), yticks=())
    axes.set_xlabel("share of the energy of the whole gap")
    style.dress(axes, grid="x")
    style.legend(axes, columns=3)
    return drawn


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


def next_flights(document: Row) -> list[tuple[str, str]]:
    """Manoeuvres that would tell apart what these flights do not, each with what for."""
    found: dict[str, list[str]] = {}
    verdict = document["verdict"]
    sets = [row["credible_set"] for row in document["budget"] if len(row["credible_set"]) > 1]
    doubted = [*verdict["ambiguous_with"], *(name for names in sets for name in names)]
    if doubted:
        doubted = [*verdict["effects"], *doubted]
    for name in dict.fromkeys(doubted):
        found.setdefault(effect(name).manoeuvre, []).append(in_words(name))
    return [(manoeuvre, f"tells {listed(words)}") for manoeuvre, words in found.items()]


def budget_page(document: Row, evidence: Evidence, created: str = "") -> str:
    """Build the page of `diagnose`; `created` is the time it bears."""
    own, held = views(evidence)
    shown = own if held is None else held
    return render(
        "budget.html.j2",
        header=header(document, created),
        document=document,
        outcome=outcome(document),
        word=_WORDS[document["verdict"]["kind"]],
        budget=budget_picture(document),
        budget_table=budget_table(document),
        sizes_table=sizes_table(document),
        shrink_table=shrink_table(document),
        where=[heat_maps.phase_map(document), heat_maps.regime_map(document)],
        overlays=[event_picture(shown), flight_picture(shown)],
        drawn=drawn_effects(document, evidence),
        next_flights=next_flights(document),
    )


def _cause(name: str) -> str:
    return NAMED[name] if name in NAMED else in_words(name)


def _percent(share: float) -> str:
    return f"{100.0 * share:z.0f} %"
