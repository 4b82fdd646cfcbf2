"""Where the gap is, as maps: channel against direction and phase, regime, and frequency."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from eval.gap.bins import MOVES
from eval.report.style import Picture, picture
from narxcal.channels import symbol
from narxcal.support.arrays import FloatArray

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


def band_map(document: Mapping[str, Any]) -> Picture | None:
    """Channel against bands of frequency; each channel adds up to its own gap; None without one."""
    bands = {name: rows for name, rows in document["quality"].get("bands", {}).items() if rows}
    if not (bands and _stands_out(document)):
        return None
    first = next(iter(bands.values()))
    columns = [_band(row["low_hz"], row["high_hz"], row is first[-1]) for row in first]
    values = np.array([[row["share"] for row in rows] for rows in bands.values()])
    small = {
        (k, j): f"coh. {row['coherence']:.2f}"
        for k, rows in enumerate(bands.values())
        for j, row in enumerate(rows)
    }
    return _drawn(
        HeatMap(list(bands), columns, values, {"Hz": len(columns)}, small),
        "Share of each channel's gap by frequency",
        "Share of the channel's own gap in each band in %. Below it the coherence with the driver: "
        "the part of the gap there that a linear answer to the driver could be.",
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


def _band(low: float, high: float, last: bool) -> str:
    return f"over {low:g}" if last else f"{low:g} to {high:g}"


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
