"""Runs effects on a batch of flights: what the simulator would have said with them.

The simulator is known by its logs and, in between, by an emulator that accepts other inputs,
made to settle elsewhere or loaded by a shift s, and set to another pace. The emulator is
*anchored*: what an effect does is the difference between its free run with the effect and its free
run without,

    y = y_sim + run(u', pace, s) - run(u, 1, 0)

so that no effect means no difference at all, and what the emulator gets wrong in both cancels.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from narxcal.effects.base import Effect, Pace, Run, Signals, as_simulated, together
from narxcal.effects.steady import UNLOGGED
from narxcal.support.arrays import FloatArray
from narxcal.support.errors import ConfigError

Setting = tuple[Effect, FloatArray]  # an effect and its theta (batch, parameters)


class Shift(NamedTuple):
    """By how much an engine settles elsewhere (rows, time, outputs), and its load (rows, time).

    The load is what is taken from the core, in %/s of its speed at full speed and sea level.
    """

    settled: FloatArray
    load: FloatArray


@dataclass(frozen=True)
class Flights:
    """Inputs `u` (flights, time, inputs) and simulated outputs `y` (flights, time, outputs).

    Shorter flights are filled up with their last row; `lengths` (flights,) say where they end.
    """

    signals: Signals
    u: FloatArray
    y: FloatArray
    lengths: NDArray[np.int64]


def with_load(flights: Flights, on: FloatArray, *, always: bool = False) -> Flights:
    """Flights with one more input, `on` (flights, time), of an unlogged load.

    As they were where it is on nowhere, unless `always`.
    """
    if not (always or on.any()):
        return flights
    inputs, active = (*flights.signals.inputs, UNLOGGED), (*flights.signals.active, UNLOGGED)
    signals = replace(flights.signals, inputs=inputs, active=active)
    return replace(flights, signals=signals, u=np.concatenate([flights.u, on[..., None]], axis=2))


class Emulator(Protocol):
    """Stands in for a simulator under other inputs, settling elsewhere, and at another pace."""

    def run(
        self,
        flights: Flights,
        given: FloatArray,
        pace: Pace | None = None,
        shift: Shift | None = None,
    ) -> FloatArray:
        """Free runs (rows, time, outputs) of an engine with inputs `given` (blocks, time, inputs).

        There are as many rows as `pace` has, or blocks: without one it is the simulator's own.
        Row r has the inputs of block `r % blocks`, settles elsewhere and is loaded by row r of
        `shift`, which comes with a pace, and begins where flight `r % flights` does, or as far
        from there as it settles.
        """


def respond(settings: Sequence[Setting], flights: Flights, emulator: Emulator | None) -> FloatArray:
    """Outputs (batch, flights, time, outputs) with the effects of `settings` in place.

    All thetas have one batch. Effects act in the order input, rate, output. Only those on rates,
    and on inputs but for a delay, need the `emulator`; raises `ConfigError` where it is missing.
    """
    batch, (count, steps, _) = len(settings[0][1]), flights.u.shape
    rows = np.tile(np.arange(count), batch)
    spread = [(effect, np.repeat(theta, count, axis=0)) for effect, theta in settings]
    y = flights.y[rows]
    inner = [setting for setting in spread if _inside(setting, flights.signals)]
    if inner:
        if emulator is None:
            name = inner[0][0].name
            raise ConfigError(f"effect '{name}' acts inside the engine: it needs an emulator")
        y = _moved(inner, flights, emulator, arrived(inner, flights.signals, flights.u[rows]))
    for effect, theta in spread:
        if effect.shifts is not None:
            y = effect.shifts(Run(flights.signals, theta, flights.u[rows]), y)
    given = arrived(spread, flights.signals, flights.u[rows])
    return read(spread, flights.signals, given, y).reshape(batch, count, steps, -1)


def response(
    effect: Effect, theta: FloatArray, flights: Flights, emulator: Emulator | None
) -> FloatArray:
    """What an effect at theta (parameters,) changes in the outputs, (flights, time, outputs)."""
    return np.asarray(respond([(effect, theta[None])], flights, emulator)[0] - flights.y)


def _inside(setting: Setting, signals: Signals) -> bool:
    """Whether an engine with the effect has to be emulated."""
    return emulates_input(setting[0]) or acts_inside(setting, signals)


def emulates_input(effect: Effect) -> bool:
    """Whether it changes inputs in a way that the outputs alone do not tell."""
    return effect.arrives is not None and effect.shifts is None


def acts_inside(setting: Setting, signals: Signals) -> bool:
    """Whether an engine with the effect settles or moves otherwise at the same inputs."""
    effect, theta = setting
    if effect.settled or effect.loads(theta, signals):
        return True
    if effect.pace is None:
        return False
    both = zip(effect.pace(theta, signals), as_simulated(len(theta)), strict=True)
    return any(bool((here != there).any()) for here, there in both)


def arrived(settings: Sequence[Setting], signals: Signals, u: FloatArray) -> FloatArray:
    """Inputs (batch, time, inputs) that reach the engine; `u` itself without input effects."""
    for effect, theta in settings:
        u = effect.on_input(Run(signals, theta, u, effect.channel), u)
    return u


def read(settings: Sequence[Setting], signals: Signals, u: FloatArray, y: FloatArray) -> FloatArray:
    """Readings (batch, time, outputs) of outputs `y` of an engine with inputs `u`."""
    for effect, theta in settings:
        y = effect.on_output(Run(signals, theta, u, effect.channel), y)
    return y


def _moved(
    settings: Sequence[Setting], flights: Flights, emulator: Emulator, given: FloatArray
) -> FloatArray:
    """Add to the logs what the effects change in the emulator's free run."""
    rows = np.arange(len(settings[0][1])) % len(flights.u)
    paces = [each.pace(theta, flights.signals) for each, theta in settings if each.pace is not None]
    shift = _shift(settings, flights, given)
    if shift is not None:
        paces = paces or [as_simulated(len(rows))]
    pace = together(paces) if paces else None
    if pace is None or any(effect.arrives is not None for effect, _ in settings):
        changed = emulator.run(flights, given, pace, shift)
    else:
        changed = _each_once(flights, emulator, pace, shift)
    same = emulator.run(flights, flights.u, as_simulated(len(flights.u)) if paces else None)
    return np.asarray(flights.y[rows] + (changed - same[rows]))


def _shift(settings: Sequence[Setting], flights: Flights, given: FloatArray) -> Shift | None:
    """Where the engine settles elsewhere and what loads it; None if no effect says so."""
    y = flights.y[np.arange(len(given)) % len(flights.u)]
    runs = [(effect, Run(flights.signals, theta, given)) for effect, theta in settings]
    settled = [each.total(run, y) for each, run in runs if each.settled]
    loads = [each.load(run, y) for each, run in runs if each.takes_power]
    if not settled and not loads:
        return None
    return Shift(sum(settled, np.zeros_like(y)), sum(loads, np.zeros(y.shape[:2])))


def _each_once(flights: Flights, emulator: Emulator, pace: Pace, shift: Shift | None) -> FloatArray:
    """Runs of all flights as every item of a batch has them, like ones run once.

    What is linear in an effect on the pace or a load is none, so that most runs of a fit may be
    alike.
    """
    count = len(flights.u)
    kinds: dict[bytes, int] = {}
    places: list[int] = []
    first: list[int] = []
    parts = [np.stack(pace, axis=1), *(shift or ())]
    for at in range(0, len(pace[0]), count):
        key = b"".join(part[at : at + count].tobytes() for part in parts)
        if key not in kinds:
            first.extend(range(at, at + count))
        places.append(kinds.setdefault(key, len(kinds)))
    own = Pace(*(field[first] for field in pace))
    moved = None if shift is None else Shift(shift.settled[first], shift.load[first])
    runs = emulator.run(flights, flights.u, own, moved)
    every = runs.reshape(len(kinds), count, *runs.shape[1:])[places]
    return np.asarray(every.reshape(-1, *runs.shape[1:]))
