"""Recorded, simulated, and simulated with the effect, one on top of the other."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes

from data_prep.events import PUSH, Event
from eval.gap.data import GapData
from eval.gap.evidence import Evidence
from eval.gap.excitation import events_of
from eval.report import style
from eval.report.style import Picture, picture
from narxcal.channels import symbol
from narxcal.support.arrays import FloatArray
from training.gap.quadratic import TOLERANCE

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
    changed = evidence.finding.kind in ("effects", "ambiguous") and bool(evidence.finding.effects)
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
    scale = np.sqrt(data.noise**2 + (TOLERANCE * data.span) ** 2)
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
    what = f"the {direction} at {event.start * dt_s:.0f} s of {view.data.names[f]}"
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
    rows[-1].set_xlabel("time of the flight [s]")
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
    axes[-1].set_xlabel("time of the flight [s]")
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
