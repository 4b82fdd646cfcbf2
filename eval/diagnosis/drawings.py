"""A found effect drawn as an engineer draws it: hysteresis loop, lag step, soak curve, bars.

Curves come from the effect's own hooks wherever it has one to show, so that the drawing is the
effect that was found. Shaded or thin: the ends of the parameter's interval.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from eval.diagnosis.words import surest_words
from eval.report import style
from eval.report.style import Picture, picture
from narxcal.channels import symbol
from narxcal.effects.base import Effect, InputEffect, Parameter, Run, Signals
from narxcal.effects.operators import lag
from narxcal.effects.steady import ShapedEffect
from narxcal.support.arrays import FloatArray
from training.diagnosis.budget import Interval

WIDTH, HEIGHT = 4.6, 2.7  # in inches


class Sketch(NamedTuple):
    """An effect with its sizes, and the signals it acts on."""

    effect: Effect
    sizes: Mapping[str, Interval]
    signals: Signals

    @property
    def first(self) -> Interval:
        """Size of the effect's first parameter."""
        return self.sizes[self.effect.parameters(self.signals)[0].name]


def number(value: float) -> str:
    """Three digits, short where the last ones are 0."""
    return f"{value:.3g}"


def panel(x: str, y: str) -> tuple[Figure, Axes]:
    """An empty figure of one panel, its axes labelled."""
    drawn = style.figure(WIDTH, HEIGHT)
    axes = drawn.subplots()
    axes.set(xlabel=x, ylabel=y)
    return drawn, axes


def finish(axes: Axes, *, legend: bool = True) -> None:
    """Dress the axes as all of a page are, with a legend above."""
    style.dress(axes)
    if legend:
        style.legend(axes, columns=3)


def band(axes: Axes, x: FloatArray, low: FloatArray, high: FloatArray) -> None:
    """Shade between what the ends of an interval give."""
    axes.fill_between(x, low, high, color=style.MODEL, alpha=0.2, lw=0)


def bar(axes: Axes, place: float, size: Interval, color: str, width: float = 0.6) -> None:
    """A bar with its interval as a line."""
    axes.bar(place, size.value, width, color=color)
    axes.plot([place, place], [size.low, size.high], color=style.MEASURED, lw=1.2)


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


def sensor_scale(sketch: Sketch) -> Figure:
    """Error of one sensor over its reading: a share of it."""
    signals, channel = sketch.signals, sketch.effect.channel or ""
    column = signals.y(channel)
    reading = np.linspace(float(signals.low[column]), float(signals.high[column]), 2)
    drawn, axes = panel(f"{style.with_unit(channel)}", f"error of {style.with_unit(channel)}")
    axes.axhline(0.0, color=style.STEADY, ls="--", lw=0.8, label="simulator")
    low, value, high = (
        0.01 * size * reading for size in (sketch.first.low, sketch.first.value, sketch.first.high)
    )
    band(axes, reading, low, high)
    axes.plot(reading, value, color=style.MODEL, lw=1.6, label="with the effect")
    axes.margins(x=0.0)
    finish(axes)
    return drawn


def parameter_bars(sketch: Sketch) -> Figure:
    """Sizes of all parameters, for an effect that has no drawing of its own."""
    names = list(sketch.sizes)
    drawn, axes = panel("", "size")
    for place, name in enumerate(names):
        bar(axes, place, sketch.sizes[name], style.CYCLE[place % len(style.CYCLE)])
    axes.set_xticks(range(len(names)), names)
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


_DT_S = 0.02


def _arrived(sketch: Sketch, lever: FloatArray, size: float) -> FloatArray:
    """What arrives of a lever (time,), at one size of the effect's only parameter."""
    signals = sketch.signals
    u = np.zeros((1, len(lever), len(signals.inputs)))
    u[0, :, signals.u(signals.driver)] = lever
    at = Signals(signals.inputs, signals.outputs, _DT_S, signals.driver, signals.low, signals.high)
    acting = sketch.effect
    if not isinstance(acting, InputEffect):
        return lever
    arrived = acting.on_input(Run(at, np.array([[size]]), u), u)
    return np.asarray(arrived[0, :, signals.u(signals.driver)])


def _lever_label(sketch: Sketch, what: str) -> str:
    return f"{what} [{'°' if sketch.signals.governed else style.unit(sketch.signals.driver)}]"


def hysteresis(sketch: Sketch) -> Figure:
    """Loop of the lever that arrives over the lever, to and fro, with a small loop in it."""
    low, high = sketch.signals.lever
    middle = 0.5 * (low + high)
    reach = float(np.clip(2.5 * sketch.first.value, 2.0, 0.5 * (high - low) + 1.0))
    corners = middle + reach * np.array([0.0, 1.0, -1.0, 1.0, 0.4, 0.9])
    lever = np.interp(np.linspace(0.0, 5.0, 1001), np.arange(6), corners)
    drawn, axes = panel(_lever_label(sketch, "lever"), _lever_label(sketch, "what arrives"))
    axes.plot(lever, lever, color=style.STEADY, ls="--", lw=0.8, label="simulator")
    for size in (sketch.first.low, sketch.first.high):
        axes.plot(
            lever[200:], _arrived(sketch, lever, size)[200:], color=style.MODEL, lw=0.5, alpha=0.6
        )
    arrived = _arrived(sketch, lever, sketch.first.value)
    axes.plot(lever[200:], arrived[200:], color=style.MODEL, lw=1.8, label="engine")
    finish(axes)
    return drawn


def lever_in_time(sketch: Sketch) -> Figure:
    """Fast steps of the lever of three sizes, and what arrives of them."""
    low, high = sketch.signals.lever
    drawn, axes = panel("time after the lever moved [s]", _lever_label(sketch, "what arrives"))
    delayed = sketch.effect.id == "throttle_delay"
    size = sketch.first
    until = 1.0 + 2.0 * size.high if delayed else 1.0 + 1.2 * (high - low) / size.value
    time = np.arange(-0.2 * until, until, _DT_S)
    for share in (1.0, 0.5, 0.2):
        lever = low + share * (high - low) * np.clip(time / 0.5, 0.0, 1.0)
        ends = [_arrived(sketch, lever, value) for value in (size.low, size.high)]
        first = share == 1.0
        axes.plot(
            time, lever, color=style.STEADY, ls="--", lw=0.8, label="lever" if first else None
        )
        band(axes, time, *ends)
        arrived, label = _arrived(sketch, lever, size.value), "what arrives" if first else None
        axes.plot(time, arrived, color=style.MODEL, lw=1.6, label=label)
    axes.margins(x=0.0)
    finish(axes)
    return drawn


def lever_bias(sketch: Sketch) -> Figure:
    """What arrives over the lever, against the diagonal."""
    drawn, axes = panel(_lever_label(sketch, "lever"), _lever_label(sketch, "what arrives"))
    lever = np.linspace(*sketch.signals.lever, 51)
    axes.plot(lever, lever, color=style.STEADY, ls="--", lw=0.8, label="simulator")
    ends = [_arrived(sketch, lever, value) for value in (sketch.first.low, sketch.first.high)]
    band(axes, lever, *ends)
    arrived = _arrived(sketch, lever, sketch.first.value)
    axes.plot(lever, arrived, color=style.MODEL, lw=1.6, label="engine")
    finish(axes)
    return drawn


_EITHER = 0.5  # of a share that is all or nothing


def step_response(sketch: Sketch) -> Figure:
    """Answer to a unit step, 63 % of it marked where a lag has that.

    A sensor may have had a lag in the simulator, `own_s`: then that is the simulator's answer.
    """
    tau, shifted = sketch.first, sketch.effect.id == "time_skew"
    own = sketch.sizes["own_s"].value if "own_s" in sketch.sizes else 0.0
    until = max(5.0 * (own + tau.value), 1.2 * (own + tau.high), 0.5)
    time = np.linspace(-0.2 * until, until, 601)
    drawn, axes = panel("time after the step [s]", "share of the step [-]")

    def answer(size: float) -> FloatArray:
        if shifted or size == 0.0:
            return np.asarray((time >= size).astype(float))
        step = (time >= 0.0).astype(float)[None]
        return np.asarray(lag(step, np.array([size]), float(time[1] - time[0]))[0])

    axes.plot(time, answer(own), color=style.STEADY, ls="--", lw=0.8, label="simulator")
    band(axes, time, answer(own + tau.low), answer(own + tau.high))
    axes.plot(time, answer(own + tau.value), color=style.MODEL, lw=1.6, label="with the effect")
    level = 0.5 if shifted else 1.0 - np.exp(-1.0)
    place = own + tau.value
    axes.plot([place], [level], "o", color=style.BAD, ms=4, label=f"{number(place)} s")
    axes.margins(x=0.0)
    finish(axes)
    return drawn


def time_constants(sketch: Sketch) -> Figure:
    """Time constants of both spools, up and down, in those of the simulator.

    Where the control makes pushes and pulls differ, the time that its limit lets a pull take.
    """
    names = [name for name in ("N1_pct", "N2_pct") if name in sketch.signals.outputs]
    rows = [(name, way) for name in names for way in ("up", "down")]
    control = "by_control" in sketch.sizes and sketch.sizes["by_control"].value > _EITHER
    as_it_was = {"accel_decel_asymmetry": "up" if control else "down"}.get(sketch.effect.id)
    changed = sketch.first
    if control:  # what may go twice as fast takes half the time
        changed = Interval(1.0 / changed.value, 1.0 / changed.high, 1.0 / changed.low)
    drawn, axes = panel("", f"{'limited transit' if control else 'time constant'}, simulator = 1")
    axes.axhline(1.0, color=style.STEADY, ls="--", lw=0.8, label="simulator")
    for place, (name, way) in enumerate(rows):
        free = way == as_it_was or (sketch.effect.id == "spool_coupling" and name == "N2_pct")
        size = Interval(1.0, 1.0, 1.0) if free else changed
        bar(axes, place, size, style.MODEL if way == "up" else style.CYCLE[5])
    axes.set_xticks(range(len(rows)), [f"{symbol(name)} {way}" for name, way in rows])
    finish(axes)
    return drawn


def over_altitude(sketch: Sketch) -> Figure:
    """Limit of acceleration, or time constant against the simulator's, over altitude."""
    altitude = np.linspace(0.0, 45000.0, 91)
    limit = sketch.effect.id == "accel_limit"
    air_only = Signals(("ALT_ft",), (), 1.0, "", np.empty(0), np.empty(0))
    air = air_only.thin_air(altitude[:, None])

    def line(size: float) -> FloatArray:
        return np.asarray(size * air if limit else air ** (-size))

    what = "fastest acceleration [%/s]" if limit else "time constant, simulator = 1"
    drawn, axes = panel("altitude [1000 ft]", what)
    size = sketch.first
    kft = 1e-3 * altitude
    band(axes, kft, line(size.low), line(size.high))
    axes.plot(kft, line(size.value), color=style.MODEL, lw=1.6, label="with the effect")
    if not limit:
        axes.axhline(1.0, color=style.STEADY, ls="--", lw=0.8, label="simulator")
    axes.margins(x=0.0)
    finish(axes)
    return drawn


def drawing(acting: Effect, sizes: Mapping[str, Interval], signals: Signals) -> Picture:
    """Draw `acting` at `sizes` (parameter -> value with interval), for these signals.

    A parameter that is not given is neutral.
    """
    parameters = acting.parameters(signals)
    neutral = {p.name: Interval(p.neutral, p.neutral, p.neutral) for p in parameters}
    sketch = Sketch(acting, {**neutral, **sizes}, signals)
    other = shift_bars if isinstance(acting, ShapedEffect) else parameter_bars
    drawn = _DRAWN.get(acting.id, other)(sketch)
    alt = f"{acting.name}: {acting.meaning}"
    return picture(drawn, alt, _caption(acting, parameters, sketch.sizes))


def _caption(acting: Effect, parameters: Sequence[Parameter], sizes: Mapping[str, Interval]) -> str:
    """What it is, its sizes with their intervals, and how those are drawn."""
    given = {p.name: {**asdict(sizes[p.name]), "unit": p.unit} for p in parameters}
    meaning = f"{acting.meaning[:1].upper()}{acting.meaning[1:]}"
    words = surest_words({"id": acting.id, "channel": acting.channel, "parameters": given})
    return f"{meaning}: {words}. Shaded, or a thin line in a bar: 90 % interval."


_DRAWN: dict[str, Callable[[Sketch], Figure]] = {
    "throttle_backlash": hysteresis,
    "throttle_delay": lever_in_time,
    "throttle_rate_limit": lever_in_time,
    "throttle_bias": lever_bias,
    "driver_gain": lever_bias,
    "actuator_lag": step_response,
    "sensor_lag": step_response,
    "flowmeter_dynamics": step_response,
    "time_skew": step_response,
    "spool_lag": time_constants,
    "spool_coupling": time_constants,
    "accel_decel_asymmetry": time_constants,
    "accel_limit": over_altitude,
    "altitude_lag": over_altitude,
    "deterioration": wear,
    "heat_soak": soak,
    "sensor_bias": sensor_error,
    "sensor_drift": sensor_error,
    "sensor_gain": sensor_scale,
}
