"""Held-out flights in the terms of those that were diagnosed, so that effects mean the same.

And together with them, as the simulator flew them.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from eval.gap.data import GapData
from narxcal.effects.running import Flights, with_load
from narxcal.effects.steady import UNLOGGED
from narxcal.support.arrays import FloatArray
from narxcal.support.errors import DataError

_RATE = 0.01
_STILL = 1e-6  # of a channel's size: what changes by less does not change
_HINT = "Record and simulate them with the channels and at the rate of the others"


def in_terms_of(data: GapData, other: GapData) -> GapData:
    """`other` with the signals of `data`.

    An input that `other` lacks and that never changes in `data` has its value there. Raises
    `DataError` for one that does change, for an output that is missing, and for another rate.
    """
    if UNLOGGED in data.flights.signals.inputs:
        off = np.zeros(other.flights.u.shape[:2])
        other = replace(other, flights=with_load(other.flights, off, always=True))
    mine, theirs = data.flights.signals, other.flights.signals
    if abs(theirs.dt_s / mine.dt_s - 1.0) > _RATE:
        raise DataError(
            f"the held-out flights are worked at {1 / theirs.dt_s:.4g} Hz, those of the diagnosis "
            f"at {1 / mine.dt_s:.4g} Hz",
            file=other.names[0],
            hint=_HINT,
        )
    for name in mine.outputs:
        if name not in theirs.outputs:
            raise _lacking(other, name)
    columns = [theirs.outputs.index(name) for name in mine.outputs]
    u = np.stack([_input(data, other, name) for name in mine.inputs], axis=-1)
    flights = replace(other.flights, signals=mine, u=u, y=other.flights.y[..., columns])
    return replace(
        other, flights=flights, real=other.real[..., columns], noise=other.noise[columns]
    )


def together(first: Flights, others: Flights) -> Flights:
    """Flights (flights, time, ...) of the same inputs and outputs as one batch, in their ranges.

    What was recorded is no part of it: what a simulator says of a flight is known before anybody
    has flown it.
    """
    longest = max(first.u.shape[1], others.u.shape[1])
    u, y = (
        np.concatenate([_padded(part, longest) for part in parts])
        for parts in ((first.u, others.u), (first.y, others.y))
    )
    mine = first.signals
    lever = u[..., mine.u(mine.driver)]
    moving = np.ptp(u, axis=(0, 1)) > _STILL * np.maximum(np.abs(u).max(axis=(0, 1)), _STILL)
    signals = replace(
        mine,
        low=y.min(axis=(0, 1)),
        high=y.max(axis=(0, 1)),
        lever=(float(lever.min()), float(lever.max())),
        active=tuple(np.array(mine.inputs)[moving].tolist()),
    )
    return Flights(signals, u, y, np.concatenate([first.lengths, others.lengths]))


def _padded(rows: FloatArray, longest: int) -> FloatArray:
    """Rows (flights, time, ...) filled up with their last."""
    rest = np.repeat(rows[:, -1:], longest - rows.shape[1], axis=1)
    return np.concatenate([rows, rest], axis=1)


def _input(data: GapData, other: GapData, name: str) -> FloatArray:
    """The input (flights, time) of the other flights, or what it is throughout the diagnosed."""
    mine, theirs = data.flights, other.flights
    if name in theirs.signals.inputs:
        return theirs.u[..., theirs.signals.u(name)]
    if name in mine.signals.active:
        raise _lacking(other, name)
    return np.full(theirs.u.shape[:2], np.median(mine.u[..., mine.signals.u(name)]))


def _lacking(other: GapData, name: str) -> DataError:
    return DataError("the held-out flights lack it", file=other.names[0], channel=name, hint=_HINT)
