"""Flights as the budget takes them: units that are left out, and what moves in every sample."""

from __future__ import annotations

import numpy as np

from eval.gap.bins import MOVES, sort_samples
from eval.gap.data import GapData
from eval.gap.excitation import events_of
from narxcal.effects.running import Flights
from training.budget.diagnosis import Phases
from training.budget.metric import Record

_BLOCK_S, _MOST = 300.0, 6  # of a flight, where fewer than three stand for themselves


def record_of(data: GapData) -> Record:
    """The flights with their units: flights, or blocks of them where there are fewer than three."""
    flights = data.flights
    count, steps = flights.u.shape[:2]
    unit = np.full((count, steps), -1)
    start = 0
    for f, length in enumerate(flights.lengths.tolist()):
        parts = 1
        if count < 3:
            parts = int(np.clip(length * flights.signals.dt_s / _BLOCK_S, 2, _MOST))
        unit[f, :length] = start + np.arange(length) * parts // length
        start += parts
    return Record(flights, data.real, data.noise, unit, _groups(flights), data.fast)


def _groups(flights: Flights) -> tuple[int, ...]:
    """Which logs are of one flight, and so of several engines: those flown alike."""
    signals = flights.signals
    if "ALT_ft" not in signals.active:
        return tuple(range(len(flights.u)))
    flown = flights.u[..., signals.u("ALT_ft")]
    return tuple(
        next(g for g in range(f + 1) if np.array_equal(flown[g], flown[f]))
        for f in range(len(flown))
    )


def phases_of(data: GapData) -> Phases:
    """What moves in every sample: `push_transit` and the like."""
    names = tuple("steady" if d == "steady" else f"{d}_{p}" for d, p in MOVES)
    return Phases(names, sort_samples(data, events_of(data)).move)
