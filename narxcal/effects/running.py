"""Runs effects on a batch of flights: what the simulator would have said with them.

The simulator is known by its logs and, in between, by an emulator in rate form `f(y, u)`. The
emulator is *anchored*: at the logged outputs it moves exactly as the log does,

    dy/dt = f(y, u') - f(y_sim, u) + d y_sim / dt

so that only the difference an effect makes is left to the emulator, and no effect means no
difference at all.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from narxcal.effects.base import (
    Effect,
    FloatArray,
    InputEffect,
    OutputEffect,
    RateEffect,
    Run,
    ShiftEffect,
    Signals,
)
from narxcal.errors import ConfigError

Setting = tuple[Effect, FloatArray]  # an effect and its theta (batch, parameters)
SETTLE_S = 20.0


@dataclass(frozen=True)
class Flights:
    """Inputs `u` (flights, time, inputs) and simulated outputs `y` (flights, time, outputs).

    Shorter flights are filled up with their last row; `lengths` (flights,) say where they end.
    """

    signals: Signals
    u: FloatArray
    y: FloatArray
    lengths: NDArray[np.int64]


class RateForm(Protocol):
    """A simulator in rate form, for many rows at once."""

    def drive(self, u: FloatArray) -> FloatArray:
        """All that depends on inputs `u` (rows, time, inputs) alone: (rows, time, features)."""

    def rate(self, y: FloatArray, drive: FloatArray) -> FloatArray:
        """Rates (..., outputs) at outputs `y` (..., outputs) under `drive` (..., features)."""


def respond(settings: Sequence[Setting], flights: Flights, emulator: RateForm | None) -> FloatArray:
    """Outputs (batch, flights, time, outputs) with the effects of `settings` in place.

    All thetas have one batch. Effects act in the order input, rate, output. Only those on rates,
    and on inputs but for a delay, need the `emulator`; raises `ConfigError` where it is missing.
    """
    batch, (count, steps, _) = len(settings[0][1]), flights.u.shape
    rows = np.tile(np.arange(count), batch)
    spread = [(effect, np.repeat(theta, count, axis=0)) for effect, theta in settings]
    y = flights.y[rows]
    inner = [setting for setting in spread if _inside(setting[0])]
    if inner:
        if emulator is None:
            name = inner[0][0].name
            raise ConfigError(f"effect '{name}' acts inside the engine: it needs an emulator")
        y = _moved(inner, flights, emulator, arrived(inner, flights.signals, flights.u[rows]))
    for effect, theta in spread:
        if isinstance(effect, ShiftEffect):
            y = effect.on_log(Run(flights.signals, theta, flights.u[rows]), y)
    told = arrived(spread, flights.signals, flights.u[rows])
    return read(spread, flights.signals, told, y).reshape(batch, count, steps, -1)


def _inside(effect: Effect) -> bool:
    """Whether an engine with the effect has to be emulated."""
    return isinstance(effect, (InputEffect, RateEffect)) and not isinstance(effect, ShiftEffect)


def arrived(settings: Sequence[Setting], signals: Signals, u: FloatArray) -> FloatArray:
    """Inputs (batch, time, inputs) that the engine is told; `u` itself without input effects."""
    for effect, theta in settings:
        if isinstance(effect, InputEffect):
            u = effect.on_input(Run(signals, theta, u), u)
    return u


def read(settings: Sequence[Setting], signals: Signals, u: FloatArray, y: FloatArray) -> FloatArray:
    """Readings (batch, time, outputs) of outputs `y` of an engine that is told `u`."""
    for effect, theta in settings:
        if isinstance(effect, OutputEffect):
            y = effect.on_output(Run(signals, theta, u), y)
    return y


def _moved(
    settings: Sequence[Setting], flights: Flights, emulator: RateForm, told: FloatArray
) -> FloatArray:
    """Integrate the anchored emulator with the rate hooks, by explicit steps of the raster."""
    signals, dt, count = flights.signals, flights.signals.dt_s, len(flights.u)
    rows = np.arange(len(told)) % count
    before = emulator.drive(flights.u)
    anchor = np.diff(flights.y, axis=1) / dt - emulator.rate(flights.y, before)[:, :-1]
    alone = all(not isinstance(effect, InputEffect) for effect, _ in settings)
    drive = before[rows] if alone else emulator.drive(told)
    acting = [
        (effect, Run(signals, theta, told))
        for effect, theta in settings
        if isinstance(effect, RateEffect)
    ]
    air = signals.thin_air(told)[..., None]
    y = flights.y[rows]
    if not np.array_equal(told[:, 0], flights.u[rows, 0]):
        y[:, 0] = _settled(emulator, y[:, 0], (before[rows, 0], drive[:, 0]), dt)
    for k in range(y.shape[1] - 1):
        rate = anchor[rows, k] + emulator.rate(y[:, k], drive[:, k])
        for effect, run in acting:
            rate = effect.on_rate(run, rate, air[:, k])
        y[:, k + 1] = y[:, k] + dt * rate
    return y


def _settled(
    emulator: RateForm, logged: FloatArray, drives: tuple[FloatArray, FloatArray], dt_s: float
) -> FloatArray:
    """Where an engine at rest at `logged` (rows, outputs) rests under the second of two drives."""
    before, drive = drives
    y, anchor = logged, emulator.rate(logged, before)
    for _ in range(round(SETTLE_S / dt_s)):
        y = y + dt_s * (emulator.rate(y, drive) - anchor)
    return y
