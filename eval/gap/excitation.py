"""Pushes and pulls of the driver in every flight, and whether there are enough of them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from data_prep.events import PULL, PUSH, Event, EventsConfig, find_events
from data_prep.log import Log
from eval.gap.data import GapData
from narxcal.support.errors import DataError

FEWEST = 3  # pushes, and pulls, over all flights: fewer say nothing about their spread
_FUEL_FRACTION = 0.05  # a fuel flow wanders more than a lever does


def events_of(data: GapData) -> tuple[tuple[Event, ...], ...]:
    """Pushes and pulls of each flight, settled when the simulated speeds are."""
    signals = data.flights.signals
    speeds = tuple(name for name in signals.outputs if name.endswith("_pct"))
    config = EventsConfig(
        driver=signals.driver,
        response=speeds or signals.outputs[:1],
        condition="",
        min_fraction=0.02 if signals.governed else _FUEL_FRACTION,
    )
    return tuple(tuple(find_events(_log(data, f), config)) for f in range(len(data.names)))


def _log(data: GapData, f: int) -> Log:
    flights, n = data.flights, int(data.flights.lengths[f])
    signals = flights.signals
    channels = {signals.driver: flights.u[f, :n, signals.u(signals.driver)]}
    channels |= {name: flights.y[f, :n, signals.y(name)] for name in signals.outputs}
    return Log(data.names[f], np.arange(n, dtype=np.float64) * signals.dt_s, channels)


def check_excitation(data: GapData, events: Sequence[Sequence[Event]]) -> None:
    """Raise `DataError`, saying what is missing, for fewer than three pushes or three pulls."""
    labels = [event.label for flight in events for event in flight]
    found = {"pushes": labels.count(PUSH), "pulls": labels.count(PULL)}
    if min(found.values()) >= FEWEST:
        return
    missing = " and ".join(
        f"{FEWEST - count} more {kind}" for kind, count in found.items() if count < FEWEST
    )
    counted = " and ".join(_counted(count, kind) for kind, count in found.items())
    raise DataError(
        f"too little excitation: {counted} of {data.flights.signals.driver} in "
        f"{_counted(len(data.names), 'flights')}, {FEWEST} of each are needed",
        hint=f"Fly at least {missing}, idle to high power and back",
    )


def _counted(count: int, plural: str) -> str:
    one = plural.removesuffix("es") if plural.endswith("shes") else plural.removesuffix("s")
    return f"{count} {one if count == 1 else plural}"
