"""Drawings of one event with its Ti/Tt windows: a large overlay, and a small panel among others.

The overlay is for a page and as a picture file. The panel of the contact sheet is SVG by hand: a
log holds dozens of events; a plotting library takes a hundred times as long for each and makes the
page several times as heavy. Its looks (`.panel ...`) are in the page's style sheet.
"""

from __future__ import annotations

import io
from dataclasses import dataclass
from xml.sax.saxutils import escape, quoteattr

import numpy as np
from markupsafe import Markup
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from eval.report import style
from eval.report.style import Picture, envelope, picture, spans, with_unit
from eval.report.view import Curves, LogView
from narxcal.channels import symbol
from narxcal.support.arrays import AnyFloats, FloatArray
from training.responses.rules import time_bands
from training.responses.transients import AssessedEvent, Assessment


def large(view: LogView, one: AssessedEvent) -> Picture:
    """Draw the event as a qualification page does, every output with its own Ti/Tt windows."""
    figure = overlay_figure(view, one)
    symbols = ", ".join(symbol(name) for name in view.outputs)
    place = f"{view.when(one.event)} of {one.event.log}"
    alt = f"Overlay of {symbols}, flight and model, {_direction(one)} at {place}"
    caption = (
        "Flight: the line without a colour; model in blue. Shaded: where the model may reach "
        "10 % (green) and 90 % (pink) of its own response; marked: where flight and model do."
    )
    return picture(figure, alt, caption)


def overlay_figure(view: LogView, one: AssessedEvent) -> Figure:
    """Build the large overlay: driver, then per output the curves and their deviation."""
    ratios = [0.6] + [part for _ in view.outputs for part in (1.7, 0.5)]
    figure, axes = style.stack(8.6, ratios)
    rows = view.rows(one.event)
    time = view.log.time_s[rows] - one.event.start_s
    axes[0].plot(time, view.log[view.driver][rows], color=style.DRIVER, lw=1.2)
    axes[0].set_ylabel(style.with_unit(view.driver))
    for curves, upper, lower in zip(view.curves(rows), axes[1::2], axes[2::2], strict=True):
        draw_output(upper, time, curves, one)
        lower.axhline(0.0, color="#8c959f", lw=0.6)
        if curves.model is not None:
            lower.plot(time, curves.model - curves.measured, color=style.MODEL, lw=0.9)
        lower.set_ylabel(f"Δ{style.with_unit(curves.name)}")
        style.ticks(lower)
    for each in axes:
        each.axvline(0.0, color="#57606a", lw=0.7, ls=":")
        style.over_time(each)
    style.legend(axes[1], columns=6)
    axes[-1].set_xlabel("time after the lever moved [s]")
    return figure


def draw_output(axes: Axes, time: FloatArray, curves: Curves, one: AssessedEvent) -> None:
    """Draw one output over `time (time,)` after the lever moved, with its Ti/Tt windows."""
    assessment, t0_s = one.of(curves.name), one.event.start_s
    if assessment is not None:
        _levels(axes, assessment)
        _windows(axes, assessment, t0_s)
    draw_curves(axes, time, curves)
    if assessment is not None:
        _dots(axes, assessment, t0_s)
    axes.set_ylabel(style.with_unit(curves.name))


def summary_figure(view: LogView, one: AssessedEvent) -> bytes:
    """One event as a PNG for a README: driver, overlay with Ti/Tt windows and residual."""
    figure = overlay_figure(view, one)
    kind = f"{one.event.log}: {_direction(one)} at {view.when(one.event)}"
    figure.axes[0].set_title(kind, fontsize=9, loc="left", color="#24292f")
    buffer = io.BytesIO()
    FigureCanvasAgg(figure)
    style.without_math(figure)
    figure.savefig(
        buffer, format="png", dpi=160, bbox_inches="tight", pad_inches=0.1,
        metadata={"Software": None},
    )  # fmt: skip
    return buffer.getvalue()


def _direction(one: AssessedEvent) -> str:
    return ("push", "pull")[one.event.label]


def draw_curves(axes: Axes, time: FloatArray, curves: Curves) -> None:
    """Draw one output over `time (time,)`: measured on top of model, interval, steady state."""
    style.shade_missing(axes, time, curves.measured)
    if curves.model is not None and curves.half_width is not None:
        style.band(axes, time, curves.model, curves.half_width)
    if curves.steady is not None:
        style.curve(axes, time, curves.steady, style.STEADY, lw=0.9, ls="--", label="steady state")
    if curves.model is not None:
        style.curve(
            axes, time, curves.model, style.MODEL, lw=2.0, alpha=0.8, label="model, free run"
        )
    style.curve(axes, time, curves.measured, style.MEASURED, lw=0.8, label="measured")


def _levels(axes: Axes, one: Assessment) -> None:
    if not np.isfinite(one.flight.response):
        return
    for share in (0.1, 0.9):
        level = one.flight.before + share * one.flight.response
        axes.axhline(level, color="#8c959f", lw=0.5, ls=(0, (4, 3)))


def _windows(axes: Axes, one: Assessment, t0_s: float) -> None:
    """Shade where the model's own 10 % and 90 % may lie, and mark where the flight's do."""
    bands = time_bands(one.flight, one.model, one.verdict)
    for (start_s, stop_s), colour, label in zip(
        bands, (style.TI, style.TT), ("Ti window", "Tt window"), strict=False
    ):
        axes.axvspan(start_s - t0_s, stop_s - t0_s, color=colour, alpha=0.25, lw=0, label=label)
    for reached_s in (one.flight.t10_s, one.flight.t90_s):
        if np.isfinite(reached_s):
            axes.axvline(reached_s - t0_s, color=style.MEASURED, lw=0.6)


def _dots(axes: Axes, one: Assessment, t0_s: float) -> None:
    for reading, colour in ((one.flight, style.MEASURED), (one.model, style.MODEL)):
        if not np.isfinite(reading.t10_s):
            continue
        levels = [reading.before + share * reading.response for share in (0.1, 0.9)]
        times = [reading.t10_s - t0_s, reading.t90_s - t0_s]
        axes.plot(times, levels, "o", ms=4.5, color=colour, mec="white", mew=0.6, zorder=5)


# --- panel ---

_POINTS = 160
_WIDTH, _HEIGHT, _LEFT, _RIGHT = 290.0, 196.0, 44.0, 280.0


@dataclass(frozen=True)
class _Axes:
    """Maps time and value ranges to the rectangle from `top` to `bottom`."""

    time: tuple[float, float]
    value: tuple[float, float]
    top: float
    bottom: float

    def x(self, time: float | AnyFloats) -> FloatArray:
        first, last = self.time
        share = (np.asarray(time, dtype=float) - first) / (last - first)
        return np.asarray(_LEFT + share * (_RIGHT - _LEFT))

    def y(self, value: float | FloatArray) -> FloatArray:
        low, high = self.value
        share = (np.asarray(value, dtype=float) - low) / (high - low)
        return np.asarray(self.bottom - share * (self.bottom - self.top))


def panel(view: LogView, one: AssessedEvent) -> Picture:
    """Draw the driver above, below the output that failed, else the first, with t10 and t90."""
    rows, t0_s = view.rows(one.event), one.event.start_s
    time, driver = view.log.time_s[rows] - t0_s, view.log[view.driver][rows]
    reach = (float(time[0]), max(float(time[-1]), float(time[0]) + 1e-9))
    failed = {each.channel for each in one.assessments if each.verdict.ok is False}
    curves = view.curves(rows)
    output = next((each for each in curves if each.name in failed), curves[0])
    upper = _Axes(reach, _range([driver]), 6.0, 50.0)
    known = [part for part in (output.measured, output.model, output.steady) if part is not None]
    lower = _Axes(reach, _range(known), 60.0, 164.0)
    parts = [
        *_frame(upper, view.driver),
        _path(upper, time, driver, "drv"),
        *_marks(lower, one.of(output.name), t0_s),
        *_frame(lower, output.name),
        *_output(lower, time, output),
        *_time_axis(lower, upper),
    ]
    alt = f"{one.move} at {view.when(one.event)}: {symbol(view.driver)} and {symbol(output.name)}"
    head = (
        f'<svg class="panel" role="img" aria-label={quoteattr(alt)} '
        f'viewBox="0 0 {_WIDTH:g} {_HEIGHT:g}" xmlns="http://www.w3.org/2000/svg">'
    )
    return Picture(Markup(head + "\n".join(parts) + "</svg>"), alt)  # noqa: S704 - all escaped


def _range(curves: list[FloatArray]) -> tuple[float, float]:
    known = np.concatenate(curves)
    known = known[np.isfinite(known)]
    if not len(known):
        return 0.0, 1.0
    low, high = float(known.min()), float(known.max())
    margin = max(0.06 * (high - low), 1e-3 * max(1.0, abs(high)))
    return low - margin, high + margin


def _frame(axes: _Axes, name: str) -> list[str]:
    middle = (axes.top + axes.bottom) / 2
    place = f"translate(9 {middle:g}) rotate(-90)"
    parts = [
        f'<path class="ax" d="M{_LEFT:g} {axes.top:g}V{axes.bottom:g}H{_RIGHT:g}"/>',
        f'<text class="lab" transform="{place}">{escape(with_unit(name))}</text>',
    ]
    for tick in _ticks(*axes.value, 3):
        height = float(axes.y(tick))
        parts.append(f'<path class="grid" d="M{_LEFT:g} {height:.1f}H{_RIGHT:g}"/>')
        parts.append(f'<text class="ytk" x="{_LEFT - 4:g}" y="{height + 3:.1f}">{tick:g}</text>')
    return parts


def _ticks(low: float, high: float, number: int) -> list[float]:
    found = MaxNLocator(nbins=number, steps=[1, 2, 5, 10]).tick_values(low, high)
    return [round(float(tick), 10) for tick in found if low <= tick <= high]


def _time_axis(lower: _Axes, upper: _Axes) -> list[str]:
    zero = float(lower.x(0.0))
    parts = [f'<path class="zero" d="M{zero:.1f} {upper.top:g}V{lower.bottom:g}"/>']
    for tick in _ticks(*lower.time, 6):
        place = float(lower.x(tick))
        parts.append(f'<text class="xtk" x="{place:.1f}" y="{lower.bottom + 12:g}">{tick:g}</text>')
    middle = (_LEFT + _RIGHT) / 2
    label = "time after the lever moved [s]"
    return [*parts, f'<text class="xtk" x="{middle:g}" y="{lower.bottom + 26:g}">{label}</text>']


def _output(axes: _Axes, time: FloatArray, curves: Curves) -> list[str]:
    parts = [
        _rectangle(axes, start, end, "mask")
        for start, end in spans(time, np.isnan(curves.measured))
    ]
    if curves.steady is not None:
        parts.append(_path(axes, time, curves.steady, "std"))
    if curves.model is not None:
        parts.append(_path(axes, time, curves.model, "mod"))
    return [*parts, _path(axes, time, curves.measured, "mea")]


def _path(axes: _Axes, time: FloatArray, values: FloatArray, kind: str) -> str:
    thin_time, thin_values = envelope(time, values, _POINTS)
    x, y = axes.x(thin_time), axes.y(thin_values)
    known = np.isfinite(y)
    pen_up = np.r_[True, ~known[:-1]]
    points = [
        f"{'M' if lifted else 'L'}{across:.1f} {up:.1f}"
        for across, up, lifted in zip(x[known], y[known], pen_up[known], strict=True)
    ]
    return f'<path class="{kind}" d="{"".join(points)}"/>'


def _rectangle(axes: _Axes, start: float, end: float, kind: str) -> str:
    left, right = (float(x) for x in np.clip(axes.x(np.array([start, end])), _LEFT, _RIGHT))
    height = axes.bottom - axes.top
    return (
        f'<rect class="{kind}" x="{left:.1f}" y="{axes.top:g}" '
        f'width="{max(right - left, 0.5):.1f}" height="{height:g}"/>'
    )


def _marks(axes: _Axes, one: Assessment | None, t0_s: float) -> list[str]:
    """10 % and 90 % levels, the flight's times at them, and where the model's may be."""
    if one is None or one.flight.reason is not None:
        return []
    flight = one.flight
    parts = [
        _rectangle(axes, start - t0_s, end - t0_s, kind)
        for (start, end), kind in zip(
            time_bands(flight, one.model, one.verdict), ("ti", "tt"), strict=False
        )
    ]
    for share, reached_s in ((0.1, flight.t10_s), (0.9, flight.t90_s)):
        height = float(axes.y(flight.before + share * flight.response))
        across = float(axes.x(reached_s - t0_s))
        parts.append(f'<path class="lev" d="M{_LEFT:g} {height:.1f}H{_RIGHT:g}"/>')
        parts.append(f'<path class="t" d="M{across:.1f} {axes.top:g}V{axes.bottom:g}"/>')
    return parts
