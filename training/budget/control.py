"""Which kind of control a simulator's engine is under, where its own logs leave that open.

Controls that hold another speed, the core's acceleration or fuel follow the same logs; what an
effect on how the engine moves does under them differs. The one under which such an effect takes
clearly more of the recorded gap is the engine's.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from narxcal.effects.base import RateEffect
from narxcal.effects.library import hypotheses
from narxcal.effects.running import Flights
from training.budget.dictionary import Dictionary
from training.budget.fitting import Frame
from training.budget.metric import Metric, Record, assumed_variance
from training.budget.nuisances import nuisances
from training.gap.emulator import GreyBoxEmulator

_CLEARLY: Final = 0.03  # of the gap
_FLIGHTS: Final = 3  # that are asked: those with most of the gap


def suited(emulators: Sequence[GreyBoxEmulator], record: Record) -> GreyBoxEmulator:
    """The emulator under whose control one effect of moves takes clearly more, or the first."""
    moving = [e for e in hypotheses(record.flights.signals) if isinstance(e, RateEffect)]
    if len(emulators) == 1 or not moving:
        return emulators[0]
    some = _some(record)
    left = []
    for one in emulators:
        dictionary = Dictionary(moving, some.flights, one)
        metric = Metric(some, assumed_variance(some))
        frame = Frame(some, metric, some.gap, nuisances(some, None, 0.0))
        before = frame.energy(frame.none)
        fits = [frame.fit(nodes) for nodes in dictionary.nodes.values()]
        left.append(min(frame.energy(each.solved) for each in fits) / before)
    best = int(np.argmin(left))
    return emulators[best] if left[best] < left[0] - _CLEARLY else emulators[0]


def _some(record: Record) -> Record:
    energy = (record.gap**2 / record.span**2).sum(axis=(1, 2))
    rows = np.sort(np.argsort(-energy)[:_FLIGHTS])
    flights: Flights = record.flights
    few = replace(flights, u=flights.u[rows], y=flights.y[rows], lengths=flights.lengths[rows])
    _, unit = np.unique(record.unit[rows], return_inverse=True)
    unit = unit.reshape(record.unit[rows].shape)
    lowest = int((record.unit[rows] < 0).any())
    return Record(few, record.real[rows], record.noise, unit - lowest)
