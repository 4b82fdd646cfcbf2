"""Sorts every sample of every flight: what the lever does, how far the response is, and where.

Direction and phase come from the lever's events and the simulated first output: initiation up to
10 % of its change, transit up to 90 %, settling up to the event's end. Everything else is steady.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from data_prep.events import Event
from eval.gap.data import GapData
from eval.response import HIGH, LOW
from narxcal.support.arrays import FloatArray, IntArray

Regimes = dict[str, tuple[tuple[str, ...], IntArray]]
DIRECTIONS = ("push", "pull", "steady")
PHASES = ("initiation", "transit", "settling", "steady")
# What the lever does and how far the response is, in the order of the numbers in `Bins.move`.
MOVES = (
    ("steady", "steady"),
    *((direction, phase) for direction in DIRECTIONS[:2] for phase in PHASES[:3]),
)
LEVELS = ("low", "mid", "high")
# Where a level begins: 10000 and 25000 ft, Mach 0.3 and 0.6, thirds of the speed range.
EDGES = {"altitude": (10e3, 25e3), "Mach": (0.3, 0.6), "power": (1 / 3, 2 / 3)}
SWITCHES = ("ECS", "NAI", "WAI")
_SMALL = 0.01  # of the range: a change whose 10 % and 90 % cannot be told


@dataclass(frozen=True, eq=False)
class Bins:
    """`move` (flights, time) is a row of `MOVES`; -1 beyond a flight's end.

    `regimes` maps altitude, Mach, power and bleed, as far as the inputs tell, to the names of
    their levels and which one each sample is in, (flights, time).
    """

    move: IntArray
    regimes: Regimes


def sort_samples(data: GapData, events: Sequence[Sequence[Event]]) -> Bins:
    """Find direction, phase and regime of every sample."""
    flights = data.flights
    move = np.full(flights.u.shape[:2], -1)
    for f, found in enumerate(events):
        n = int(flights.lengths[f])
        move[f, :n] = 0
        for event in found:
            move[f, event.start + 1 : event.stop] = _phases(flights.y[f, :, 0], event, data.span[0])
    return Bins(move, _regimes(data))


def _phases(y: FloatArray, event: Event, span: float) -> IntArray:
    """Rows of `MOVES` from the sample after the event's start to its end."""
    first = 1 + 3 * event.label
    part = y[event.start : event.stop]
    change = part[-1] - part[0]
    phases = np.full(len(part) - 1, first + 2)
    if abs(change) < _SMALL * span:
        return phases
    share = (part[1:] - part[0]) / change
    t10 = int(np.argmax(share >= LOW))
    t90 = t10 + int(np.argmax(share[t10:] >= HIGH))
    phases[:t10] = first
    phases[t10 : t90 + 1] = first + 1
    return phases


def _regimes(data: GapData) -> Regimes:
    flights, signals = data.flights, data.flights.signals
    values = {"power": signals.power(flights.y)}
    for name, channel in (("altitude", "ALT_ft"), ("Mach", "Mach")):
        if channel in signals.inputs:
            values[name] = flights.u[..., signals.u(channel)]
    found: Regimes = {
        name: (LEVELS, np.digitize(each, EDGES[name]).astype(np.int64))
        for name, each in values.items()
    }
    switches = [name for name in SWITCHES if name in signals.active]
    if switches:
        found["bleed"] = _combined(switches, [flights.u[..., signals.u(s)] for s in switches])
    return found


def _combined(
    names: Sequence[str], states: Sequence[FloatArray]
) -> tuple[tuple[str, ...], IntArray]:
    """Which switches are on: one level for each combination there is."""
    number = sum(((state > 0.5).astype(int) << k for k, state in enumerate(states)), start=0)
    present, index = np.unique(np.asarray(number), return_inverse=True)
    labels = tuple(
        "+".join(name for k, name in enumerate(names) if code >> k & 1) or "off" for code in present
    )
    return labels, np.asarray(index).reshape(states[0].shape)
