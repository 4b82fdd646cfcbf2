"""How every figure of a report looks: colours, axes, units."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from data_prep.log import FloatArray
from eval.report.svg import MAX_POINTS, envelope, spans
from narxcal.channels import CHANNELS

# Okabe and Ito's colours, told apart with every common colour-vision deficiency and in grey print.
MEASURED = "#000000"
MODEL = "#0072b2"
STEADY = "#e69f00"
DRIVER = "#57606a"
GOOD = "#009e73"
BAD = "#d55e00"
MASK = "#d0d7de"
CYCLE = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9")
_INK, _GRID = "#24292f", "#e4e8ec"
_UNITS = {"degC": "°C", "deg": "°", "-": "", "0/1": ""}


def symbol(channel: str) -> str:
    """`N1_pct` -> `N1`: what an engineer calls the channel."""
    return channel.rsplit("_", 1)[0] if channel in CHANNELS else channel


def unit(channel: str) -> str:
    """Printed unit of a channel, empty where it has none."""
    known = CHANNELS.get(channel)
    return "" if known is None else _UNITS.get(known.unit, known.unit)


def with_unit(channel: str) -> str:
    """`N1_pct` -> `N1 [%]`, the label of an axis."""
    text = unit(channel)
    return f"{symbol(channel)} [{text}]" if text else symbol(channel)


def figure(width: float, height: float) -> Figure:
    """Create an empty figure, sizes in inches, laid out so that labels never collide."""
    return Figure(figsize=(width, height), layout="constrained", facecolor="white")


def stack(width: float, heights: Sequence[float]) -> tuple[Figure, list[Axes]]:
    """Rows of axes, `heights` in inches, over one time axis; room for a legend above the second.

    Margins are fixed: finding them by trial, as a layout engine does, takes half of the time.
    """
    left, right, top, bottom, gap, legend_gap = 0.62, 0.12, 0.06, 0.42, 0.11, 0.22
    total = top + sum(heights) + gap * (len(heights) - 1) + legend_gap + bottom
    drawn = Figure(figsize=(width, total), facecolor="white")
    rows: list[Axes] = []
    edge = total - top
    for position, height in enumerate(heights):
        edge -= height + (gap if position else 0.0) + (legend_gap if position == 1 else 0.0)
        place = (left / width, edge / total, (width - left - right) / width, height / total)
        rows.append(drawn.add_axes(place, sharex=rows[0] if rows else None))
        rows[-1].yaxis.set_label_coords(-0.47 / (width - left - right), 0.5)
        rows[-1].tick_params(labelbottom=position == len(heights) - 1)
    return drawn, rows


def pair(width: float, height: float) -> tuple[Figure, Axes, Axes]:
    """Two axes side by side with room for a legend above, margins fixed as in `stack`."""
    drawn = Figure(figsize=(width, height), facecolor="white")
    low, tall = 0.42 / height, (height - 0.42 - 0.24) / height
    wide = (width - 1.4) / 2  # and room for the half of the last tick's label
    left = drawn.add_axes((0.62 / width, low, wide / width, tall))
    right = drawn.add_axes((1.25 / width + wide / width, low, wide / width, tall))
    return drawn, left, right


def dress(axes: Axes, *, size: float = 8.0, grid: Literal["both", "x", "y"] = "both") -> None:
    """Quiet frame and grid: ink belongs to the data."""
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    for side in ("left", "bottom"):
        axes.spines[side].set_color("#8c959f")
        axes.spines[side].set_linewidth(0.6)
    axes.tick_params(labelsize=size, colors=_INK, length=2.5, width=0.6, color="#8c959f")
    axes.xaxis.label.set(size=size, color=_INK)
    axes.yaxis.label.set(size=size, color=_INK)
    axes.grid(visible=True, axis=grid, color=_GRID, linewidth=0.6)
    axes.set_axisbelow(True)


def legend(axes: Axes, columns: int = 4, size: float = 8.0) -> None:
    """One line of entries above the axes, where it hides no data."""
    axes.legend(
        loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=columns, fontsize=size, frameon=False,
        borderaxespad=0.2, handlelength=1.8, columnspacing=1.4, labelcolor=_INK,
    )  # fmt: skip


def shade_missing(axes: Axes, time: FloatArray, values: FloatArray, label: str = "masked") -> None:
    """Grey out where `values` is NaN; runs closer than a pixel are drawn as one."""
    if not len(time):
        return
    pixel = (time[-1] - time[0]) / 1200 if len(time) > 1 else 0.0
    merged: list[list[float]] = []
    for start, end in spans(time, np.isnan(values)):
        if merged and start - merged[-1][1] <= pixel:
            merged[-1][1] = end
        else:
            merged.append([start, end])
    if merged:
        bars = [(start, max(end - start, pixel)) for start, end in merged]
        axes.broken_barh(
            bars, (0, 1), transform=axes.get_xaxis_transform(), color=MASK, lw=0, zorder=0.4,
            label=label,
        )  # fmt: skip


def curve(axes: Axes, time: FloatArray, values: FloatArray, color: str, **line: Any) -> None:
    """Plot a curve thinned to its envelope of `points` samples."""
    points = line.pop("points", MAX_POINTS)
    axes.plot(*envelope(time, values, points), color=color, **line)
