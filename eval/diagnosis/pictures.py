"""Where the gap is, as maps; and recorded, simulated and corrected curves over each other."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from data_prep.events import PUSH, Event
from eval.diagnosis.document import Evidence
from eval.diagnosis.flights import MOVES, GapData, events_of
from eval.report import style
from eval.report.style import Picture, picture
from narxcal.channels import symbol
from narxcal.support.arrays import FloatArray
from narxcal.support.moments import moment

_CELL_W, _CELL_H, _LEFT = 0.82, 0.5, 0.75  # inches
_DARK = 0.55  # of the map's range: beyond it letters are white
_NAMED = 3  # cells that the text alternative names


@dataclass(frozen=True, eq=False)
class HeatMap:
    """Shares `values` (rows, columns), NaN for what does not exist, and what stands in the cells.

    `titles` go above runs of columns: text -> how many. `small` (row, column) -> second line;
    `framed` are cells to stress.
    """

    rows: Sequence[str]
    columns: Sequence[str]
    values: FloatArray
    titles: Mapping[str, int] = field(default_factory=dict)
    small: Mapping[tuple[int, int], str] = field(default_factory=dict)
    framed: frozenset[tuple[int, int]] = frozenset()


def phase_map(document: Mapping[str, Any]) -> Picture | None:
    """Channel against direction and phase, with intervals; None where there is no gap."""
    bins = document["where"]
    if not _stands_out(document):
        return None
    channels = _channels(document)
    values = np.zeros((len(channels), len(MOVES)))
    small, framed = {}, set()
    for row in bins:
        place = channels.index(row["channel"]), MOVES.index((row["direction"], row["phase"]))
        values[place] = row["share"]
        small[place] = f"{100 * row['low']:.0f} to {100 * row['high']:.0f}"
        if row.get("core"):
            framed.add(place)
    columns = [phase for _, phase in MOVES]
    titles = {"": 1, "push": 3, "pull": 3}
    found = HeatMap(channels, columns, values, titles, small, frozenset(framed))
    return _drawn(
        found,
        "Share of the gap's energy by channel, direction and phase",
        "Share of the gap's energy above the noise floor in %, its 90 % interval below. Framed: "
        "the fewest cells that hold 70 %. Initiation is up to 10 % of the response, transit up to "
        "90 %, settling the rest of the event.",
    )


def regime_map(document: Mapping[str, Any]) -> Picture | None:
    """Channel against the levels of altitude, Mach, power and bleed; None without a gap."""
    channels, shares = _channels(document), _regime_shares(document["where"])
    if not (shares and _stands_out(document)):
        return None
    values, columns, titles = [], [], {}
    for regime, levels in shares.items():
        titles[regime] = len(levels)
        for level, found in levels.items():
            columns.append(level)
            values.append([found.get(channel, 0.0) for channel in channels])
    return _drawn(
        HeatMap(channels, columns, np.array(values).T, titles),
        "Share of the gap's energy by channel and regime",
        "The same energy by regime; each of the groups adds up to the whole. Altitude low is below "
        "10 000 ft, high from 25 000 ft; Mach low below 0.3, high from 0.6; power by thirds.",
    )


def _stands_out(document: Mapping[str, Any]) -> bool:
    """Whether any part of the gap is above the noise: shares of nothing mean nothing."""
    return any(row["share"] > 0.0 for row in document["where"])


def _channels(document: Mapping[str, Any]) -> list[str]:
    """All channels, in the order in which they were diagnosed."""
    known = list(document["quality"].get("channels", ()))
    return list(dict.fromkeys((*known, *(row["channel"] for row in document["where"]))))


def _regime_shares(bins: Sequence[Mapping[str, Any]]) -> dict[str, dict[str, dict[str, float]]]:
    """Regime -> level -> channel -> share of all energy."""
    found: dict[str, dict[str, dict[str, float]]] = {}
    for row in bins:
        for regime, levels in row.get("regime_shares", {}).items():
            for level, part in levels.items():
                cells = found.setdefault(regime, {}).setdefault(level, {})
                cells[row["channel"]] = cells.get(row["channel"], 0.0) + part * row["share"]
    return found


def _drawn(found: HeatMap, alt: str, caption: str) -> Picture:
    count, width = found.values.shape
    top, bottom = (0.42 if found.titles else 0.22), 0.04
    size = _LEFT + _CELL_W * width + 0.05, top + _CELL_H * count + bottom
    drawn = Figure(figsize=size, facecolor="white")
    place = (_LEFT / size[0], bottom / size[1])
    axes = drawn.add_axes((*place, _CELL_W * width / size[0], _CELL_H * count / size[1]))
    # No share is dark by being the largest of small ones alone.
    most = max(0.3, float(np.nanmax(found.values, initial=0.0)))
    shown = np.ma.masked_invalid(found.values)
    axes.pcolormesh(shown, cmap="Blues", vmin=0.0, vmax=most, edgecolors="white", lw=1.5)
    for (row, column), value in np.ndenumerate(found.values):
        _cell(axes, found, (row, column), value / most)
    _labels(axes, found)
    return picture(drawn, f"{alt}; largest: {_largest(found)}", caption)


def _cell(axes: Axes, found: HeatMap, place: tuple[int, int], depth: float) -> None:
    value, (row, column) = found.values[place], place
    if not math.isfinite(value):
        return
    text, small = f"{100 * value:.0f}", found.small.get(place, "")
    color = "white" if depth > _DARK else "#24292f" if round(100 * value) else "#8c959f"
    small = small if round(100 * value) else ""
    at = row + (0.4 if small else 0.5)
    weight = "bold" if place in found.framed else "normal"
    axes.text(column + 0.5, at, text, ha="center", va="center", size=9, color=color, weight=weight)
    if small:
        axes.text(column + 0.5, row + 0.74, small, ha="center", va="center", size=6.5, color=color)
    if place in found.framed:
        frame = Rectangle((column + 0.03, row + 0.04), 0.94, 0.92, fill=False, ec="#24292f", lw=1.4)
        axes.add_patch(frame)


def _labels(axes: Axes, found: HeatMap) -> None:
    axes.set_xticks(np.arange(len(found.columns)) + 0.5, found.columns)
    axes.set_yticks(np.arange(len(found.rows)) + 0.5, [symbol(name) for name in found.rows])
    axes.set(xlim=(0, len(found.columns)), ylim=(len(found.rows), 0))
    axes.tick_params(
        length=0, labelsize=8, top=True, labeltop=True, bottom=False, labelbottom=False
    )
    for side in axes.spines.values():
        side.set_visible(False)
    at, line = 0, -0.2 / _CELL_H
    for title, width in found.titles.items():
        if title:
            axes.text(at + width / 2, line - 0.06, title, ha="center", va="bottom", size=8.5)
            ends = [at + 0.1, at + width - 0.1]
            axes.plot(ends, [line, line], color="#8c959f", lw=0.7, clip_on=False)
        at += width


def _largest(found: HeatMap) -> str:
    """Name the largest cells, for a reader who does not see the map."""
    values = np.nan_to_num(found.values)
    titles = [title for title, width in found.titles.items() for _ in range(width)]
    order = np.argsort(-values, axis=None, kind="stable")[:_NAMED]
    cells = [np.unravel_index(place, values.shape) for place in order.tolist()]
    texts = [
        " ".join(filter(None, (symbol(found.rows[row]), *_column(found, titles, column))))
        + f" {100 * values[row, column]:.0f} %"
        for row, column in cells
        if values[row, column] > 0.0
    ]
    return ", ".join(texts) or "none"


def _column(found: HeatMap, titles: Sequence[str], column: int) -> tuple[str, str]:
    return (titles[column] if titles else "", found.columns[column])


_LEAD_S, _TAIL_S, _LEAST_S = 4.0, 6.0, 20.0
REPAIRED = style.GOOD
_WIDTH = 10.0
_OWN, _HELD = "of the diagnosis", "that took no part"


class View(NamedTuple):
    """Flights and what the simulator says of them with the effects, (flights, time, outputs).

    `changed` says whether there are any; `whose` flights they are, in words.
    """

    data: GapData
    after: FloatArray
    events: Sequence[Sequence[Event]]
    changed: bool
    whose: str


def views(evidence: Evidence) -> tuple[View, View | None]:
    """The flights of the diagnosis, and those that took no part where there are any."""
    changed = bool(evidence.budget.verdict.effects)
    own = View(evidence.data, evidence.after, evidence.where.events, changed, _OWN)
    held = evidence.held_out
    if held is None:
        return own, None
    return own, View(held.data, held.after, events_of(held.data), changed, _HELD)


def worst_event(view: View) -> tuple[int, Event] | None:
    """Flight and event with the most energy of the gap before anything is added."""
    best, found = 0.0, None
    energy = _energy(view)
    for f, flight in enumerate(view.events):
        for event in flight:
            own = float(np.nansum(energy[f, event.start : event.stop]))
            if own > best:
                best, found = own, (f, event)
    return found


def worst_flight(view: View) -> int:
    """Number of the flight with the largest mean energy of the gap."""
    energy = _energy(view)
    sizes = [
        np.nansum(each[:n]) / n for each, n in zip(energy, view.data.flights.lengths, strict=True)
    ]
    return int(np.argmax(sizes))


def _energy(view: View) -> FloatArray:
    """Squared gap over what a gap has to exceed, summed over outputs: (flights, time)."""
    data = view.data
    scale = np.sqrt(data.variance)
    return np.asarray(np.nansum((data.gap / scale) ** 2, axis=-1))


def event_picture(view: View) -> Picture | None:
    """The worst event large: driver, then every channel with its gap below; None without events."""
    found = worst_event(view)
    if found is None:
        return None
    f, event = found
    dt_s, end = view.data.flights.signals.dt_s, int(view.data.flights.lengths[f])
    first = max(0, event.start - round(_LEAD_S / dt_s))
    last = max(event.stop + round(_TAIL_S / dt_s), first + round(_LEAST_S / dt_s))
    direction = "push" if event.label == PUSH else "pull"
    what = f"the {direction} at {moment(event.start * dt_s, 0.0)} of {view.data.names[f]}"
    return _stacked(view, f, slice(first, min(last, end)), what)


def flight_picture(view: View) -> Picture:
    """Every channel's gap over the whole of the worst flight, before and after."""
    f = worst_flight(view)
    n, signals = int(view.data.flights.lengths[f]), view.data.flights.signals
    time_s = np.arange(n, dtype=np.float64) * signals.dt_s
    figure, rows = style.stack(_WIDTH, [0.6, *[0.95] * len(signals.outputs)])
    style.curve(rows[0], time_s, _driver(view, f)[:n], style.DRIVER, lw=0.9)
    rows[0].set_ylabel(style.with_unit(signals.driver))
    for k, name in enumerate(signals.outputs):
        _gap_strip(rows[1 + k], view, (f, k, slice(0, n)), name)
    style.legend(rows[1])
    for axes in rows:
        style.dress(axes)
        axes.margins(x=0.0)
    style.clock(rows[-1], time_s, " of the flight")
    flight = view.data.names[f]
    return picture(
        figure,
        f"Gap of every channel over {flight}, of flights {view.whose}{_versus(view)}",
        f"{flight}: recorded less simulated over the whole flight{_versus(view)}. "
        "Offsets that differ from flight to flight are left in.",
    )


def _stacked(view: View, f: int, rows: slice, what: str) -> Picture:
    signals = view.data.flights.signals
    time_s = np.arange(rows.start, rows.stop, dtype=np.float64) * signals.dt_s
    heights = [0.6] + [part for _ in signals.outputs for part in (1.35, 0.6)]
    figure, axes = style.stack(_WIDTH, heights)
    axes[0].plot(time_s, _driver(view, f)[rows], color=style.DRIVER, lw=1.0)
    axes[0].set_ylabel(style.with_unit(signals.driver))
    for k, name in enumerate(signals.outputs):
        _curves(axes[1 + 2 * k], view, (f, k, rows), name)
        _gap_strip(axes[2 + 2 * k], view, (f, k, rows), name)
    style.legend(axes[1])
    for each in axes:
        style.dress(each)
        each.margins(x=0.0)
    style.clock(axes[-1], np.zeros(1), " of the flight")
    names = ", ".join(symbol(name) for name in signals.outputs)
    shown = "recorded, simulated" + (", simulated with the effect" if view.changed else "")
    caption = (
        f"{what[:1].upper()}{what[1:]}: the largest gap of all events of flights {view.whose}. "
    )
    caption += "Below each channel: recorded less simulated"
    return picture(
        figure, f"{names} in {what}, of flights {view.whose}: {shown}", f"{caption}{_versus(view)}."
    )


def _versus(view: View) -> str:
    return ", before (orange) and after the effect is added (green)" if view.changed else ""


def _driver(view: View, f: int) -> FloatArray:
    flights = view.data.flights
    return np.asarray(flights.u[f, :, flights.signals.u(flights.signals.driver)])


def _curves(axes: Axes, view: View, place: tuple[int, int, slice], name: str) -> None:
    f, k, rows = place
    time_s = np.arange(rows.start, rows.stop, dtype=np.float64) * view.data.flights.signals.dt_s
    real = view.data.real[f, rows, k]
    style.shade_missing(axes, time_s, real, "unknown")
    style.curve(axes, time_s, view.data.flights.y[f, rows, k], style.STEADY, lw=1.6, ls="--",
                label="simulated")  # fmt: skip
    if view.changed:
        style.curve(axes, time_s, view.after[f, rows, k], REPAIRED, lw=2.2, alpha=0.8,
                    label="simulated + effect")  # fmt: skip
    style.curve(axes, time_s, real, style.MEASURED, lw=0.8, label="recorded")
    axes.set_ylabel(style.with_unit(name))


def _gap_strip(axes: Axes, view: View, place: tuple[int, int, slice], name: str) -> None:
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
            axes, time_s, real - view.after[f, rows, k], REPAIRED, lw=0.8, label="gap after"
        )
    axes.set_ylabel(f"Δ{style.with_unit(name)}")
    style.ticks(axes)
