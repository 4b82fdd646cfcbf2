"""The small panel of the contact sheet, written as SVG by hand.

A log holds dozens of events; a plotting library takes a hundred times as long for each and makes
the page several times as heavy. The looks (`.panel ...`) are in the page's style sheet.
"""

from __future__ import annotations

from dataclasses import dataclass
from xml.sax.saxutils import escape, quoteattr

import numpy as np
from markupsafe import Markup
from matplotlib.ticker import MaxNLocator

from eval.report.style import AnyFloats, Picture, envelope, spans, with_unit
from eval.report.view import Curves, LogView
from eval.rules import time_bands
from eval.transients import AssessedEvent, Assessment
from narxcal.channels import symbol
from narxcal.support.arrays import FloatArray

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
        """Return where a time in seconds lies across the panel."""
        first, last = self.time
        share = (np.asarray(time, dtype=float) - first) / (last - first)
        return np.asarray(_LEFT + share * (_RIGHT - _LEFT))

    def y(self, value: float | FloatArray) -> FloatArray:
        """Return how far down a value lies."""
        low, high = self.value
        share = (np.asarray(value, dtype=float) - low) / (high - low)
        return np.asarray(self.bottom - share * (self.bottom - self.top))


def panel(view: LogView, one: AssessedEvent) -> Picture:
    """Draw the driver above and the first output below, with t10, t90 and their windows."""
    rows, t0_s = view.rows(one.event), one.event.start_s
    time, driver = view.log.time_s[rows] - t0_s, view.log[view.driver][rows]
    reach = (float(time[0]), max(float(time[-1]), float(time[0]) + 1e-9))
    output = view.curves(rows)[0]
    upper = _Axes(reach, _range([driver]), 6.0, 50.0)
    curves = [part for part in (output.measured, output.model, output.steady) if part is not None]
    lower = _Axes(reach, _range(curves), 60.0, 164.0)
    parts = [
        *_frame(upper, view.driver),
        _path(upper, time, driver, "drv"),
        *_marks(lower, one.of(output.name), t0_s),
        *_frame(lower, output.name),
        *_output(lower, time, output),
        *_time_axis(lower, upper),
    ]
    alt = f"{one.move} at {t0_s:.1f} s: {symbol(view.driver)} and {symbol(output.name)}"
    head = (
        f'<svg class="panel" role="img" aria-label={quoteattr(alt)} '
        f'viewBox="0 0 {_WIDTH:g} {_HEIGHT:g}" xmlns="http://www.w3.org/2000/svg">'
    )
    return Picture(Markup(head + "\n".join(parts) + "</svg>"), alt)  # noqa: S704 - all escaped


def _range(curves: list[FloatArray]) -> tuple[float, float]:
    """Return what the curves span, with a margin; any range if nothing is known."""
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
