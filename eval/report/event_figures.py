"""The large overlay of one event with its Ti/Tt windows, for the page and as a picture file."""

from __future__ import annotations

import io

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from eval.report import style
from eval.report.style import Picture, picture
from eval.report.view import Curves, LogView
from eval.rules import time_bands
from eval.transients import AssessedEvent, Assessment
from narxcal.channels import symbol
from narxcal.support.arrays import FloatArray


def large(view: LogView, one: AssessedEvent) -> Picture:
    """Draw the event as a qualification page does, every output with its own Ti/Tt windows."""
    figure = overlay_figure(view, one)
    symbols = ", ".join(symbol(name) for name in view.outputs)
    place = f"{one.event.start_s:.1f} s of {one.event.log}"
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
    for each in axes:
        style.dress(each)
        each.axvline(0.0, color="#57606a", lw=0.7, ls=":")
        each.margins(x=0.0)
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
    kind = f"{one.event.log}: {_direction(one)} at {one.event.start_s:.0f} s"
    figure.axes[0].set_title(kind, fontsize=9, loc="left", color="#24292f")
    buffer = io.BytesIO()
    FigureCanvasAgg(figure)
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
    """10 % and 90 % of the flight's response."""
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
