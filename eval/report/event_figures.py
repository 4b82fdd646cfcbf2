"""The large overlay of one event with its Ti/Tt windows, for the page and as a picture file."""

from __future__ import annotations

import io

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from eval.report import style
from eval.report.content import ChannelTrace, EventTrace, Response
from eval.report.style import Picture, picture
from eval.report.windows import allowed_times
from narxcal.channels import symbol
from narxcal.support.arrays import FloatArray

_TI, _TT = style.GOOD, "#cc79a7"


def large(trace: EventTrace, driver_name: str) -> Picture:
    """Draw the event as a qualification page does, every output with its own Ti/Tt windows."""
    figure = overlay_figure(trace, driver_name)
    symbols = ", ".join(symbol(channel.name) for channel in trace.channels)
    place = f"{trace.event.start_s:.1f} s of {trace.event.log}"
    alt = f"Overlay of {symbols}, flight and model, {_kind(trace)} at {place}"
    caption = (
        "Flight: the line without a colour; model in blue. Shaded: where the model may reach "
        "10 % (green) and 90 % (pink) of its own response; dots: where flight and model do."
    )
    return picture(figure, alt, caption)


def overlay_figure(trace: EventTrace, driver_name: str) -> Figure:
    """Build the large overlay: driver, then per output the curves and their deviation."""
    ratios = [0.6] + [part for _ in trace.channels for part in (1.7, 0.5)]
    figure, rows = style.stack(8.6, ratios)
    time = trace.time_s - trace.event.start_s
    rows[0].plot(time, trace.driver, color=style.DRIVER, lw=1.2)
    rows[0].set_ylabel(style.with_unit(driver_name))
    for output, upper, lower in zip(trace.channels, rows[1::2], rows[2::2], strict=True):
        response = trace.responses.get(output.name)
        _levels(upper, response)
        _windows(upper, response, trace.event.start_s, label=True)
        _curves(upper, time, output)
        _dots(upper, response, trace.event.start_s)
        upper.set_ylabel(style.with_unit(output.name))
        lower.axhline(0.0, color="#8c959f", lw=0.6)
        if output.model is not None:
            lower.plot(time, output.model - output.measured, color=style.MODEL, lw=0.9)
        lower.set_ylabel(f"Δ{style.with_unit(output.name)}")
    for axes in rows:
        style.dress(axes)
        axes.axvline(0.0, color="#57606a", lw=0.7, ls=":")
        axes.margins(x=0.0)
    style.legend(rows[1], columns=6)
    rows[-1].set_xlabel("time after the lever moved [s]")
    return figure


def summary_figure(trace: EventTrace, driver_name: str) -> bytes:
    """One event as a PNG for a README: driver, overlay with Ti/Tt windows and residual."""
    figure = overlay_figure(trace, driver_name)
    kind = f"{trace.event.log}: {_kind(trace)} at {trace.event.start_s:.0f} s"
    figure.axes[0].set_title(kind, fontsize=9, loc="left", color="#24292f")
    buffer = io.BytesIO()
    FigureCanvasAgg(figure)
    figure.savefig(
        buffer, format="png", dpi=160, bbox_inches="tight", pad_inches=0.1,
        metadata={"Software": None},
    )  # fmt: skip
    return buffer.getvalue()


def _kind(trace: EventTrace) -> str:
    return "push" if trace.event.label == 0 else "pull"


def _curves(axes: Axes, time: FloatArray, trace: ChannelTrace) -> None:
    style.shade_missing(axes, time, trace.measured)
    if trace.steady is not None:
        style.curve(axes, time, trace.steady, style.STEADY, lw=0.9, ls="--", label="steady state")
    if trace.model is not None:
        style.curve(axes, time, trace.model, style.MODEL, lw=2.2, alpha=0.8, label="model")
    style.curve(axes, time, trace.measured, style.MEASURED, lw=1.0, label="flight")


def _levels(axes: Axes, response: Response | None) -> None:
    """10 % and 90 % of the flight's response."""
    if response is None or not np.isfinite(response.flight.response):
        return
    for share in (0.1, 0.9):
        level = response.flight.before + share * response.flight.response
        axes.axhline(level, color="#8c959f", lw=0.5, ls=(0, (4, 3)))


def _windows(axes: Axes, response: Response | None, t0_s: float, *, label: bool = False) -> None:
    """Shade where the model's own 10 % and 90 % may lie, and mark where the flight's do."""
    if response is None:
        return
    for (start_s, stop_s), colour, text in zip(
        allowed_times(response), (_TI, _TT), ("Ti window", "Tt window"), strict=False
    ):
        axes.axvspan(
            start_s - t0_s, stop_s - t0_s, color=colour, alpha=0.25, lw=0,
            label=text if label else None,
        )  # fmt: skip
    for reached_s in (response.flight.t10_s, response.flight.t90_s):
        if np.isfinite(reached_s):
            axes.axvline(reached_s - t0_s, color=style.MEASURED, lw=0.6)


def _dots(axes: Axes, response: Response | None, t0_s: float) -> None:
    if response is None:
        return
    for reading, colour in ((response.flight, style.MEASURED), (response.model, style.MODEL)):
        if reading is None or not np.isfinite(reading.t10_s):
            continue
        levels = [reading.before + share * reading.response for share in (0.1, 0.9)]
        times = [reading.t10_s - t0_s, reading.t90_s - t0_s]
        axes.plot(times, levels, "o", ms=4.5, color=colour, mec="white", mew=0.6, zorder=5)
