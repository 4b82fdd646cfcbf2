"""Drawings of effects that shift where outputs settle: bars, wear, heat soak, a sensor's error."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from eval.gap.sketch import HEIGHT, Sketch, band, bar, finish, panel
from eval.report import style
from narxcal.effects.steady import ShapedEffect


def _columns(sketch: Sketch, x: str) -> tuple[Figure, dict[str, Axes]]:
    """One panel per output that the effect moves."""
    parts = sketch.effect.terms(sketch.signals) if isinstance(sketch.effect, ShapedEffect) else ()
    outputs = list(dict.fromkeys(output for _, output in parts))
    drawn = style.figure(2.3 * len(outputs), HEIGHT)
    panels = np.atleast_1d(drawn.subplots(1, len(outputs)))
    for axes, output in zip(panels, outputs, strict=True):
        axes.set(xlabel=x, ylabel=f"Δ{style.with_unit(output)}")
        axes.axhline(0.0, color="#8c959f", lw=0.6)
    return drawn, dict(zip(outputs, panels, strict=True))


def shift_bars(sketch: Sketch) -> Figure:
    """One bar per switch (or other shape) on every output, with its interval."""
    drawn, panels = _columns(sketch, "")
    for output, axes in panels.items():
        shapes = [
            name.removesuffix(f"_{output}") for name in sketch.sizes if name.endswith(f"_{output}")
        ]
        for place, shape in enumerate(shapes):
            size = sketch.sizes[f"{shape}_{output}"]
            bar(axes, place, size, style.CYCLE[place % len(style.CYCLE)])
        axes.set_xticks(range(len(shapes)), [shape.replace("_", " ") for shape in shapes])
        axes.set_xlim(-0.7, len(shapes) - 0.3)
        finish(axes, legend=False)
        axes.tick_params(axis="x", labelsize=7)
    return drawn


def wear(sketch: Sketch) -> Figure:
    """Shift of every output over power."""
    drawn, panels = _columns(sketch, "power (0 idle, 1 full)")
    power = np.array([0.0, 1.0])
    for output, axes in panels.items():
        base, slope = (sketch.sizes[f"{shape}_{output}"] for shape in ("base", "power"))
        middle = base.value + slope.value * power
        half = 0.5 * np.array([base.high - base.low, slope.high - slope.low])
        spread = np.hypot(half[0], half[1] * power)
        band(axes, power, middle - spread, middle + spread)
        axes.plot(power, middle, color=style.MODEL, lw=1.6)
        finish(axes, legend=False)
    return drawn


def soak(sketch: Sketch) -> Figure:
    """Drift of every output after a step from idle to full power."""
    drawn, panels = _columns(sketch, "time after a push [s]")
    tau, signals = sketch.sizes["tau_s"], sketch.signals
    hot = "EGT_C" if "EGT_C" in signals.outputs else signals.outputs[-1]
    time = np.linspace(0.0, 4.0 * tau.value, 201)
    for output, axes in panels.items():
        share = sketch.sizes[f"share_{output}"]
        unit = signals.width(hot) * np.exp(-time / tau.value)
        band(axes, time, share.low * unit, share.high * unit)
        axes.plot(time, share.value * unit, color=style.MODEL, lw=1.6)
        axes.margins(x=0.0)
        finish(axes, legend=False)
    return drawn


def sensor_error(sketch: Sketch) -> Figure:
    """Error of one sensor over time: a constant, or one that grows."""
    hours = np.array([0.0, 1.0])
    drifts = sketch.effect.id == "sensor_drift"
    channel = sketch.effect.channel or ""
    drawn, axes = panel("time [h]", f"error of {style.with_unit(channel)}")
    shape, size = hours if drifts else np.ones(2), sketch.first
    axes.axhline(0.0, color=style.STEADY, ls="--", lw=0.8, label="simulator")
    band(axes, hours, size.low * shape, size.high * shape)
    axes.plot(hours, size.value * shape, color=style.MODEL, lw=1.6, label="with the effect")
    axes.margins(x=0.0)
    finish(axes)
    return drawn
