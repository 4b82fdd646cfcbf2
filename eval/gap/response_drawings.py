"""Drawings of effects on how fast something follows: steps, time constants, over altitude."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from eval.gap.sketch import Sketch, band, bar, finish, number, panel
from eval.report import style
from narxcal.channels import symbol
from narxcal.effects.base import Signals
from narxcal.effects.memory import Lag
from narxcal.support.arrays import FloatArray
from training.budget.result import Interval

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
        lag = Lag(np.array([size]), float(time[1] - time[0]))
        return np.asarray(lag((time >= 0.0).astype(float)[None])[0])

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
