"""The diagnosis by the budget core: from pairs of logs to `gap.json` of schema narxcal.gap/2."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from eval.gap.blocks import batch, block_size
from eval.gap.bins import MOVES, sort_samples
from eval.gap.data import GapData, Pair
from eval.gap.excitation import check_excitation, events_of
from eval.gap.rerun import Rerun
from eval.gap.simulators import Simulate
from narxcal.support.arrays import IntArray
from training.budget.diagnosis import Phases, concluded, weigh, Evidence
from training.budget.metric import Record
from training.budget.odds import Odds, load
from training.budget.result import Budget
from training.gap.emulator import GreyBoxEmulator, fit_emulators

RATE_HZ = 4.0
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
    return Record(flights, data.real, data.noise, unit)


def phases_of(data: GapData) -> Phases:
    """What moves in every sample: `push_transit` and the like."""
    names = tuple("steady" if d == "steady" else f"{d}_{p}" for d, p in MOVES)
    return Phases(names, sort_samples(data, events_of(data)).move)
