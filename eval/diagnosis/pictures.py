"""The budget as bars; and recorded, simulated and corrected curves over each other."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from typing import Final, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from data_prep.events import PUSH, Event
from eval.diagnosis.document import Evidence
from eval.diagnosis.expected import with_effects
from eval.diagnosis.flights import events_of
from eval.diagnosis.words import Row, cause_words, listed, surest_words
from eval.report import style
from eval.report.style import Picture, picture
from narxcal.channels import symbol
from narxcal.effects.library import effect, name_of
from narxcal.support.arrays import FloatArray
from narxcal.support.moments import moment
from training.diagnosis.metric import Record

_OTHERS: Final = {
    "build": style.MASK,
    "offsets": "#8c959f",
    "noise": "#f0f2f5",
    "unexplained": "#24292f",
}
_LEAST: Final = 0.02  # of a bar: a part that a number fits into


def budget_picture(document: Row) -> Picture | None:
    """Bars of the whole gap, of each channel and of each phase, divided by cause; None without."""
    rows = document["budget"]
    if not rows or sum(row["share"] for row in rows) <= 0.0:
        return None
    names = listed([cause_words(row["cause"]) for row in rows])
    caption = "Squared gap, each channel over its range squared; 1 is the whole gap."
    alt = f"Shares of {names} in the gap, by channel and by phase"
    drawn = style.figure(10.0, 0.9 + 0.3 * len(_bars(rows)))
    draw_budget(drawn.add_subplot(), rows)
    return picture(drawn, alt, caption)


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
    """Draw the bars of the rows of `budget`."""
    cycle, bars = itertools.cycle(style.CYCLE), _bars(rows)
    colours = [_OTHERS.get(row["cause"]) or next(cycle) for row in rows]
    for place, (label, shares) in enumerate(bars.items()):
        _bar(axes, place, shares, colours)
        axes.text(-0.01, place, label, ha="right", va="center", fontsize=8)
    for row, colour in zip(rows, colours, strict=True):
        words = cause_words(row["cause"])
        axes.barh(-1, 0.0, color=colour, edgecolor="#8c959f", lw=0.4, label=words)
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


_LEAD_S, _TAIL_S, _LEAST_S = 4.0, 6.0, 20.0
_WIDTH = 10.0
_OWN, _HELD = "of the diagnosis", "that took no part"


class View(NamedTuple):
    """Flights and what the simulator says of them with the effects, (flights, time, outputs).

    `changed` says whether there are any; `whose` flights they are, in words.
    """

    data: Record
    after: FloatArray
    events: Sequence[Sequence[Event]]
    changed: bool
    whose: str


def view_of(evidence: Evidence) -> View:
    """The flights that took no part where there are any, else those of the diagnosis."""
    changed, held = bool(evidence.budget.verdict.effects), evidence.held_out
    if held is None:
        return View(evidence.data, evidence.after, evidence.where.events, changed, _OWN)
    return View(held.data, held.after, events_of(held.data), changed, _HELD)


def largest_event(view: View, of: FloatArray) -> tuple[int, Event] | None:
    """Flight and event with the most energy `of` (flights, time, outputs), of a gap or a change."""
    energy, every = _energy(view, of), [(f, e) for f, es in enumerate(view.events) for e in es]
    sizes = [float(energy[f, event.start : event.stop].sum()) for f, event in every]
    return every[int(np.argmax(sizes))] if max(sizes, default=0.0) > 0.0 else None


def _energy(view: View, of: FloatArray) -> FloatArray:
    """Squares over what a gap has to exceed, summed over outputs: (flights, time)."""
    return np.asarray(np.nansum(of**2 / view.data.variance, axis=-1))


def event_picture(view: View) -> Picture | None:
    """The worst event large: driver, then every channel with its gap below; None without events."""
    found = largest_event(view, view.data.difference)
    if found is None:
        return None
    figure, what = _event(view, *found)
    names = ", ".join(symbol(name) for name in view.data.flights.signals.outputs)
    shown = "recorded, simulated" + (", simulated with the effect" if view.changed else "")
    caption = (
        f"{what[:1].upper()}{what[1:]}: the largest gap of all events of flights {view.whose}. "
        f"Below each channel: recorded less simulated{_versus(view)}."
    )
    return picture(figure, f"{names} in {what}, of flights {view.whose}: {shown}", caption)


def effect_picture(evidence: Evidence, row: Row) -> Picture | None:
    """The event that an effect alone changes most, before and after; None where it changes none.

    `row` is that of the effect in `gap.json`.
    """
    name, data = name_of(row), evidence.data
    values = {name: {key: size["value"] for key, size in row["parameters"].items()}}
    after = evidence.after
    if evidence.budget.claimed != values:
        after = with_effects(values, data.flights, evidence.emulator)
    view = View(data, after, evidence.where.events, changed=True, whose=_OWN)
    found = largest_event(view, after - data.flights.y)
    if found is None:
        return None
    figure, what = _event(view, *found)
    meaning = effect(name).meaning
    caption = f"{meaning[:1].upper()}{meaning[1:]}: {surest_words(row)}. Shown is {what}."
    return picture(figure, f"{name}: {meaning}", caption)


def _event(view: View, f: int, event: Event) -> tuple[Figure, str]:
    dt_s, end = view.data.flights.signals.dt_s, int(view.data.flights.lengths[f])
    first = max(0, event.start - round(_LEAD_S / dt_s))
    last = max(event.stop + round(_TAIL_S / dt_s), first + round(_LEAST_S / dt_s))
    direction = "push" if event.label == PUSH else "pull"
    what = f"the {direction} at {moment(event.start * dt_s, 0.0)} of {view.data.names[f]}"
    parts = ((_curves, 1.35), (_gap_strip, 0.6))
    return _stacked(view, f, slice(first, min(last, end)), parts), what


def flight_picture(view: View) -> Picture:
    """Every channel's gap over the whole of the worst flight, before and after."""
    energy, lengths = _energy(view, view.data.difference), view.data.flights.lengths.tolist()
    means = [each[:n].sum() / n for each, n in zip(energy, lengths, strict=True)]
    f = int(np.argmax(means))
    flight = view.data.names[f]
    return picture(
        _stacked(view, f, slice(0, lengths[f]), ((_gap_strip, 0.95),), 0.9),
        f"Gap of every channel over {flight}, of flights {view.whose}{_versus(view)}",
        f"{flight}: recorded less simulated over the whole flight{_versus(view)}. "
        "Offsets that differ from flight to flight are left in.",
    )


_Place = tuple[int, int, slice]  # flight, output, and samples
_Draw = Callable[[Axes, View, _Place, str], None]


def _stacked(
    view: View, f: int, rows: slice, parts: Sequence[tuple[_Draw, float]], lw: float = 1.0
) -> Figure:
    """Draw the driver, `lw` wide, and below it each channel by `parts`, so many inches high."""
    signals = view.data.flights.signals
    time_s = np.arange(rows.start, rows.stop, dtype=np.float64) * signals.dt_s
    heights = [height for _, height in parts]
    figure, (driver, *strips) = style.stack(_WIDTH, [0.6, *heights * len(signals.outputs)])
    lever = view.data.flights.u[f, rows, signals.u(signals.driver)]
    style.curve(driver, time_s, lever, style.DRIVER, lw=lw)
    driver.set_ylabel(style.with_unit(signals.driver))
    contents = [(k, name, draw) for k, name in enumerate(signals.outputs) for draw, _ in parts]
    for axes, (k, name, draw) in zip(strips, contents, strict=True):
        draw(axes, view, (f, k, rows), name)
    style.legend(strips[0])
    for axes in (driver, *strips):
        style.over_time(axes)
    style.clock(strips[-1], np.zeros(1), " of the flight")
    return figure


def _versus(view: View) -> str:
    return ", before (orange) and after the effect is added (green)" if view.changed else ""


def _curves(axes: Axes, view: View, place: _Place, name: str) -> None:
    f, k, rows = place
    time_s = np.arange(rows.start, rows.stop, dtype=np.float64) * view.data.flights.signals.dt_s
    real = view.data.real[f, rows, k]
    style.shade_missing(axes, time_s, real, "unknown")
    style.curve(axes, time_s, view.data.flights.y[f, rows, k], style.STEADY, lw=1.6, ls="--",
                label="simulated")  # fmt: skip
    if view.changed:
        style.curve(axes, time_s, view.after[f, rows, k], style.GOOD, lw=2.2, alpha=0.8,
                    label="simulated + effect")  # fmt: skip
    style.curve(axes, time_s, real, style.MEASURED, lw=0.8, label="recorded")
    axes.set_ylabel(style.with_unit(name))


def _gap_strip(axes: Axes, view: View, place: _Place, name: str) -> None:
    f, k, rows = place
    time_s = np.arange(rows.start, rows.stop, dtype=np.float64) * view.data.flights.signals.dt_s
    real = view.data.real[f, rows, k]
    axes.axhline(0.0, color="#8c959f", lw=0.6)
    style.shade_missing(axes, time_s, real, "unknown")
    before = real - view.data.flights.y[f, rows, k]
    style.curve(
        axes, time_s, before, style.STEADY, lw=1.1, label="gap before" if view.changed else "gap"
    )
    if view.changed:
        style.curve(
            axes, time_s, real - view.after[f, rows, k], style.GOOD, lw=0.8, label="gap after"
        )
    axes.set_ylabel(f"Δ{style.with_unit(name)}")
    style.ticks(axes)
