"""Figures of a reproduced paper that no other page has."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from data_prep.events import Event
from data_prep.log import FloatArray, Log
from eval.report import style
from eval.report.svg import Picture, picture

_LEAD_S = 2.0


def segment(log: Log, event: Event, channels: Sequence[str], title: str) -> Picture:
    """Draw one event with nothing but what was measured: figures 6 and 7 of the paper."""
    rows = slice(max(0, event.start - round(_LEAD_S / log.dt_s)), event.stop)
    figure, axes = style.stack(6.4, [0.7] + [1.1] * (len(channels) - 1))
    time = log.time_s[rows] - event.start_s
    for part, name in zip(axes, channels, strict=True):
        colour = style.DRIVER if part is axes[0] else style.MEASURED
        style.curve(part, time, log[name][rows], colour, lw=1.2)
        part.set_ylabel(style.with_unit(name))
        part.axvline(0.0, color="#57606a", lw=0.7, ls=":")
        style.dress(part)
        part.margins(x=0.0)
    axes[-1].set_xlabel("time after the lever moved [s]")
    place = f"{event.start_s:.1f} s of {log.name}"
    return picture(figure, f"{title} at {place}", f"{title}, at {place}.")


def free_runs(
    time_s: FloatArray, channel: str, measured: FloatArray, runs: Mapping[str, FloatArray]
) -> Picture:
    """Overlay free runs of several models over one log, `(time,)` each."""
    figure, (upper, lower) = style.stack(10.0, [1.9, 0.9])
    for colour, (name, values) in zip(style.CYCLE, runs.items(), strict=False):
        style.curve(upper, time_s, values, colour, lw=1.4, alpha=0.85)
        style.curve(lower, time_s, values - measured, colour, lw=0.8, label=name)
    style.curve(upper, time_s, measured, style.MEASURED, lw=0.8)
    upper.set_ylabel(style.with_unit(channel))
    lower.set_ylabel(f"Δ{style.with_unit(channel)}")
    lower.set_xlabel("time [s]")
    for axes in (upper, lower):
        style.dress(axes)
        axes.margins(x=0.0)
    style.legend(lower, columns=5)
    names = ", ".join(runs)
    alt = f"{style.symbol(channel)} measured and in free run: {names}"
    return picture(
        figure, alt, "Measured: the line without a colour; below, each model minus measured."
    )


def fused(
    time_s: FloatArray, channel: str, curves: Mapping[str, FloatArray], caption: str
) -> Picture:
    """Show some seconds of a noisy channel, `(time,)` per name, the truth last: figure 13."""
    figure = style.figure(10.0, 2.8)
    axes = figure.subplots()
    colours = ("#b6bdc4", style.CYCLE[0], style.CYCLE[1], style.CYCLE[2])
    *others, truth = curves.items()
    for colour, (name, values) in zip(colours, others, strict=False):
        axes.plot(time_s, values, color=colour, lw=1.0, label=name)
    axes.plot(time_s, truth[1], color=style.MEASURED, lw=1.0, ls="--", label=truth[0])
    axes.set(xlabel="time [s]", ylabel=style.with_unit(channel))
    axes.margins(x=0.0)
    style.dress(axes)
    style.legend(axes, columns=5)
    return picture(figure, f"{style.symbol(channel)} with noise, fused and true", caption)


def bars(
    labels: Sequence[str], groups: Mapping[str, FloatArray], what: str, limit: float
) -> Picture:
    """Grouped bars on a logarithmic scale: one group per label, one bar per name, a limit line."""
    figure = style.figure(10.0, 2.7)
    axes = figure.subplots()
    width = 0.8 / max(1, len(groups))
    place = np.arange(len(labels), dtype=np.float64)
    for k, (colour, (name, values)) in enumerate(zip(style.CYCLE, groups.items(), strict=False)):
        axes.bar(
            place + (k - 0.5 * (len(groups) - 1)) * width, values, width, color=colour, label=name
        )
    axes.axhline(limit, color=style.BAD, lw=1.0, ls=":")
    axes.set_xticks(place, list(labels))
    axes.set_ylabel(what)
    axes.set_yscale("log")
    style.dress(axes, grid="y")
    style.legend(axes, columns=4)
    return picture(figure, f"{what} of {', '.join(groups)}", "The dotted line is the criterion.")
