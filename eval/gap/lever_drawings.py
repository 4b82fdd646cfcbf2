"""Drawings of effects on the lever: a hysteresis loop, a late or slow lever, a bias."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from eval.gap.sketch import Sketch, band, finish, panel
from eval.report import style
from narxcal.effects.base import InputEffect, Run, Signals
from narxcal.support.arrays import FloatArray

_DT_S = 0.02


def _told(sketch: Sketch, lever: FloatArray, size: float) -> FloatArray:
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
            lever[200:], _told(sketch, lever, size)[200:], color=style.MODEL, lw=0.5, alpha=0.6
        )
    arrived = _told(sketch, lever, sketch.first.value)
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
        ends = [_told(sketch, lever, value) for value in (size.low, size.high)]
        first = share == 1.0
        axes.plot(
            time, lever, color=style.STEADY, ls="--", lw=0.8, label="lever" if first else None
        )
        band(axes, time, *ends)
        arrived, label = _told(sketch, lever, size.value), "what arrives" if first else None
        axes.plot(time, arrived, color=style.MODEL, lw=1.6, label=label)
    axes.margins(x=0.0)
    finish(axes)
    return drawn


def lever_bias(sketch: Sketch) -> Figure:
    """What arrives over the lever: a line beside the diagonal."""
    drawn, axes = panel(_lever_label(sketch, "lever"), _lever_label(sketch, "what arrives"))
    lever = np.linspace(*sketch.signals.lever, 51)
    axes.plot(lever, lever, color=style.STEADY, ls="--", lw=0.8, label="simulator")
    ends = [_told(sketch, lever, value) for value in (sketch.first.low, sketch.first.high)]
    band(axes, lever, *ends)
    arrived = _told(sketch, lever, sketch.first.value)
    axes.plot(lever, arrived, color=style.MODEL, lw=1.6, label="engine")
    finish(axes)
    return drawn
