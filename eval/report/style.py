"""How every figure of a report looks: colours, axes, units.

Matplotlib figure -> small inline SVG, the same bytes for the same figure, from any thread.
"""

from __future__ import annotations

import hashlib
import io
import math
import re
import threading
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal
from xml.sax.saxutils import escape, quoteattr

import matplotlib as mpl
import numpy as np
from markupsafe import Markup
from matplotlib.axes import Axes
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from matplotlib.text import Text
from matplotlib.ticker import FuncFormatter, MaxNLocator

from narxcal.channels import described, symbol
from narxcal.intervals import LEVEL
from narxcal.support.arrays import AnyFloats, BoolArray, FloatArray
from narxcal.support.arrays import spans as runs_of
from narxcal.support.moments import dated, elapsed, stamp

NOTHING = "\N{EN DASH}"

MAX_POINTS = 1500

# rc parameters are global to the process, so only one thread may render at a time.
RENDERING = threading.Lock()

_NO_METADATA = {"Date": None, "Creator": None, "Format": None, "Type": None}


def number(value: float | None, digits: int = 3) -> str:
    """Print `digits` significant digits without an exponent; a dash for what does not exist."""
    if value is None or not math.isfinite(value):
        return NOTHING
    return "0" if value == 0.0 else f"{value:.{decimals(value, digits)}f}"


def decimals(value: float, digits: int) -> int:
    """Decimals, up to six, that show `digits` significant digits of a finite value but 0."""
    # The exponent after rounding: 0.9997 is 1.00, as 1.0004 is.
    exponent = int(f"{value:.{digits - 1}e}".partition("e")[2])
    return min(max(digits - 1 - exponent, 0), 6)


@dataclass(frozen=True)
class Picture:
    """An inline SVG, its text for readers who cannot see it, and its caption."""

    svg: Markup
    alt: str
    caption: str = ""


def picture(figure: Figure, alt: str, caption: str = "") -> Picture:
    """Render `figure`; text stays text (searchable) and takes the page's own font."""
    buffer = io.StringIO()
    without_math(figure)
    with RENDERING, mpl.rc_context({"svg.fonttype": "none", "svg.hashsalt": "narxcal"}):
        FigureCanvasSVG(figure).print_svg(buffer, metadata=_NO_METADATA)  # type: ignore[no-untyped-call]
    return Picture(Markup(_shrink(buffer.getvalue(), alt)), alt, caption)  # noqa: S704 - our own SVG


def without_math(figure: Figure) -> None:
    """Draw `$` as a sign in all texts that hold it: names of files and columns are no formulas."""
    for text in figure.findobj(Text):
        if isinstance(text, Text) and "$" in text.get_text():
            text.set_parse_math(False)


def envelope(
    time: AnyFloats, values: FloatArray, points: int = MAX_POINTS
) -> tuple[AnyFloats, FloatArray]:
    """Thin a curve to at most `points` samples that keep every bin's minimum and maximum.

    Arrays are `(time,)`. A bin of which all samples are missing gives one NaN, so a gap stays a
    gap; an extreme value is never lost, as it would be by taking every n-th sample.
    """
    if len(values) <= points:
        return time, values
    size = -(-len(values) // (points // 2))
    bins = -(-len(values) // size)
    padded = np.full(bins * size, np.nan)
    padded[: len(values)] = values
    block = padded.reshape(bins, size)
    first = np.arange(bins) * size
    low = first + np.where(np.isnan(block), np.inf, block).argmin(axis=1)
    high = first + np.where(np.isnan(block), -np.inf, block).argmax(axis=1)
    keep = np.unique(np.concatenate([low, high]))
    return time[keep], values[keep]


def spans(time: FloatArray, flagged: BoolArray) -> list[tuple[float, float]]:
    """(start, end) times of the runs of True in `flagged` `(time,)`."""
    last = len(time) - 1
    return [(float(time[a]), float(time[min(b, last)])) for a, b in runs_of(flagged)]


def _shrink(svg: str, alt: str) -> str:
    body = svg[svg.index("<svg") :]
    # The canvas style would leak out of an inline SVG to the page; the page's CSS carries it.
    body = re.sub(r"\s*<defs>\s*<style.*?</style>\s*</defs>", "", body, flags=re.DOTALL)
    body = re.sub(r"\s*<metadata>.*?</metadata>", "", body, flags=re.DOTALL)
    body = re.sub(r"font-family: [^;\"]*;? ?", "", body)
    body = re.sub(r" transform=\"rotate\(-?0 [^\"]*\"", "", body)
    body = re.sub(r"\b(?:d|x|y|transform)=\"[^\"]*\"", _hundredths, body)
    body = re.sub(r"\s*\n\s*", "\n", re.sub(r" \n(?=[LMCQzZ\"])", "", body))
    body = _private_ids(body, alt)
    box = re.search(r'width="([\d.]+)pt" height="[\d.]+pt" (viewBox="[^"]+")', body)
    width, view = (float(box[1]), box[2]) if box else (720.0, "")
    # Small drawings keep their size; wide ones take the width of the page. None gets so small that
    # its letters cannot be read: the page scrolls it instead.
    natural = f"{width * 4 / 3:.0f}px"
    limit = "" if width > 700.0 else f";max-width:{natural}"
    head = (
        f'<svg class="plot" role="img" aria-label={quoteattr(alt)} {view} '
        f'style="--natural:{natural}{limit}" xmlns="http://www.w3.org/2000/svg" '
        f'xmlns:xlink="http://www.w3.org/1999/xlink">\n<title>{escape(alt)}</title>'
    )
    return head + body[body.index(">") + 1 :]


def _hundredths(attribute: re.Match[str]) -> str:
    """Cut coordinates to 0.01 pt, far below what a printer resolves."""
    return re.sub(r"(\d+\.\d\d)\d+", r"\1", attribute[0])


def _private_ids(body: str, alt: str) -> str:
    """Drop the ids nobody refers to and make the others unique to this drawing of this name."""
    used = set(re.findall(r"(?:href=\"#|url\(#)([^\")]+)", body))
    key = hashlib.sha256((alt + body).encode()).hexdigest()[:8]
    body = re.sub(
        r" id=\"([^\"]*)\"",
        lambda match: f' id="{key}{match[1]}"' if match[1] in used else "",
        body,
    )
    return re.sub(r"(href=\"#|url\(#)", rf"\g<1>{key}", body)


# Okabe and Ito's colours, distinct with every common colour-vision deficiency and in grey print.
MEASURED = "#000000"
MODEL = "#0072b2"
STEADY = "#e69f00"
DRIVER = "#57606a"
GOOD = "#009e73"
BAD = "#d55e00"
MASK = "#d0d7de"
TI, TT = GOOD, "#cc79a7"  # windows of the two times
CYCLE = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9")
_LEGEND_LINE = 0.18  # inches per line of a legend
# Between two numbers of an axis over time, longest first where few are wanted.
_STEPS_S = (0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 15.0, 30.0, 60.0, 120.0, 300.0, 600.0, 900.0,
            1800.0, 3600.0, 7200.0, 14400.0, 36000.0)  # fmt: skip
_INK, _GRID = "#24292f", "#e4e8ec"
_UNITS = {"degC": "°C", "deg": "°", "-": "", "0/1": ""}


def unit(channel: str) -> str:
    """Printed unit of a channel, empty where it has none."""
    known = described(channel).unit
    return _UNITS.get(known, known)


def with_unit(channel: str) -> str:
    """`N1_pct` -> `N1 [%]`, the label of an axis."""
    text = unit(channel)
    return f"{symbol(channel)} [{text}]" if text else symbol(channel)


def figure(width: float, height: float) -> Figure:
    """Create an empty figure, sizes in inches, laid out so that labels never collide."""
    return Figure(figsize=(width, height), layout="constrained", facecolor="white")


def stack(
    width: float, heights: Sequence[float], on: Figure | None = None
) -> tuple[Figure, list[Axes]]:
    """Rows of axes, `heights` in inches, over one time axis; room for a legend above the second.

    Margins are fixed: finding them by trial, as a layout engine does, takes half of the time.
    The figure is a new one unless it is given.
    """
    left, right, top, bottom, gap, legend_gap = 0.62, 0.12, 0.06, 0.42, 0.11, 0.22
    total = top + sum(heights) + gap * (len(heights) - 1) + legend_gap + bottom
    drawn = Figure(facecolor="white") if on is None else on
    drawn.set_size_inches(width, total)
    rows: list[Axes] = []
    edge = total - top
    for position, height in enumerate(heights):
        edge -= height + (gap if position else 0.0) + (legend_gap if position == 1 else 0.0)
        place = (left / width, edge / total, (width - left - right) / width, height / total)
        rows.append(drawn.add_axes(place, sharex=rows[0] if rows else None))
        rows[-1].yaxis.set_label_coords(-0.47 / (width - left - right), 0.5)
        rows[-1].tick_params(labelbottom=position == len(heights) - 1)
    return drawn, rows


def pair(width: float, height: float, legend_rows: int = 1) -> tuple[Figure, Axes, Axes]:
    """Two axes side by side with room for a legend above, margins fixed as in `stack`."""
    height += _LEGEND_LINE * (legend_rows - 1)
    drawn = Figure(figsize=(width, height), facecolor="white")
    low, tall = 0.42 / height, (height - 0.42 - 0.24 - _LEGEND_LINE * (legend_rows - 1)) / height
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


def over_time(axes: Axes, channel: str = "") -> None:
    """Dress axes over time, which fills their width; `channel` labels its values."""
    if channel:
        axes.set_ylabel(with_unit(channel))
    dress(axes)
    axes.margins(x=0.0)


def clock(axes: Axes, time_s: FloatArray, of: str = "") -> None:
    """Label axes over the time (time,) of a log by minutes and seconds since it began.

    `of` follows the label; where the log has dates it says at which it began.
    """
    began_s = float(time_s[0]) if len(time_s) else 0.0
    axes.xaxis.set_major_locator(_Clock(began_s))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda at, _: _tick(at - began_s)))
    axes.set_xlabel(clock_label(began_s, of))


def clock_label(began_s: float, of: str = "") -> str:
    """What an axis over the time of a log shows."""
    return f"time{of} after {stamp(began_s) if dated(began_s) else 'its start'} [min:s]"


def _tick(seconds: float) -> str:
    return elapsed(seconds, 3).removesuffix("000").rstrip(".")


class _Clock(MaxNLocator):
    """Places whole minutes, or whole parts of minutes, after the log began."""

    def __init__(self, began_s: float) -> None:
        super().__init__(nbins=8, steps=[1, 2, 5, 10])
        self._began_s = began_s

    def tick_values(self, vmin: float, vmax: float) -> Any:
        """Times between the two that are whole multiples of a step of the clock."""
        low, high = vmin - self._began_s, vmax - self._began_s
        step = next((one for one in _STEPS_S if high - low <= 9.0 * one), None)
        if step is None:
            return [at + self._began_s for at in super().tick_values(low, high)]
        return step * np.arange(np.ceil(low / step), np.floor(high / step) + 1.0) + self._began_s


def ticks(axes: Axes) -> None:
    """At least three numbers on the axis of a low strip of values."""
    axes.yaxis.set_major_locator(MaxNLocator(nbins=4, min_n_ticks=3))


def legend(axes: Axes, columns: int = 4, size: float = 8.0) -> None:
    """Entries above the axes, where they hide no data; nothing where no curve has a label."""
    if not axes.get_legend_handles_labels()[0]:  # the plotting library would warn
        return
    axes.legend(
        loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=columns, fontsize=size, frameon=False,
        borderaxespad=0.2, handlelength=1.8, columnspacing=1.4, labelcolor=_INK,
    )  # fmt: skip


def missing_spans(
    time: FloatArray, values: FloatArray, pixels: int = 1200
) -> list[tuple[float, float]]:
    """(start, end) where `values` is NaN, at least a pixel; runs closer than a pixel are one."""
    pixel = float(time[-1] - time[0]) / pixels if len(time) > 1 else 0.0
    merged: list[tuple[float, float]] = []
    for start, end in spans(time, np.isnan(values)):
        if merged and start - merged[-1][1] <= pixel:
            merged[-1] = (merged[-1][0], end)
        else:
            merged.append((start, end))
    return [(start, max(end, start + pixel)) for start, end in merged]


def shade_missing(axes: Axes, time: FloatArray, values: FloatArray, label: str = "masked") -> None:
    """Grey out where `values` is NaN."""
    bars = [(start, end - start) for start, end in missing_spans(time, values)]
    if bars:
        axes.broken_barh(
            bars, (0, 1), transform=axes.get_xaxis_transform(), color=MASK, lw=0, zorder=0.4,
            label=label,
        )  # fmt: skip


def band(axes: Axes, time: FloatArray, middle: FloatArray, half: FloatArray) -> None:
    """Shade an interval around a curve, both ends thinned to their envelopes."""
    points = MAX_POINTS // 2
    (at, low), (_, high) = (
        _ends(time, values, points) for values in (middle - half, middle + half)
    )
    label = f"{100 * LEVEL:.0f} % interval"
    axes.fill_between(at, low[0], high[1], color=MODEL, alpha=0.18, lw=0, label=label)


def _ends(
    time: FloatArray, values: FloatArray, points: int
) -> tuple[FloatArray, tuple[FloatArray, FloatArray]]:
    """Least and largest value (bin,) in each of at most `points` bins, and where bins begin."""
    starts = np.arange(0, len(values), -(-len(values) // points))
    ends = (np.minimum.reduceat(values, starts), np.maximum.reduceat(values, starts))
    return time[starts], ends


def curve(axes: Axes, time: FloatArray, values: FloatArray, color: str, **line: Any) -> None:
    """Plot a curve thinned to its envelope of `points` samples."""
    points = line.pop("points", MAX_POINTS)
    axes.plot(*envelope(time, values, points), color=color, **line)
