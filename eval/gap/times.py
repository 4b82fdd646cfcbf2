"""Errors of Ti and Tt: how late a response starts and how long it takes, flight against model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from data_prep.events import PUSH, Event
from eval.gap.data import GapData
from eval.response import Transient, TransientConfig, measure_transient
from narxcal.support.arrays import FloatArray

_LEAST = 0.08  # of the channel's range: the smallest response that is read
_BEFORE_S, _AFTER_S = 1.0, 8.0


@dataclass(frozen=True)
class EventTimes:
    """One event on one channel: what the model has too little (flight less model), in seconds."""

    flight: int
    start: int
    direction: str
    Ti_s: float
    Tt_s: float


@dataclass(frozen=True)
class TimeErrors:
    """All events of one channel that could be read on both sides."""

    events: tuple[EventTimes, ...]

    def shared_with(self, other: TimeErrors) -> TimeErrors:
        """Those of the events that could be read in `other` as well."""
        there = {(event.flight, event.start) for event in other.events}
        return TimeErrors(tuple(e for e in self.events if (e.flight, e.start) in there))

    def mean_abs(self, name: str) -> float:
        """Mean absolute error of `Ti_s` or `Tt_s`; NaN without an event."""
        values = [abs(getattr(event, name)) for event in self.events]
        return float(np.mean(values)) if values else float("nan")

    def median(self, name: str, direction: str) -> float:
        """Median error of `Ti_s` or `Tt_s` over pushes or pulls; NaN without one."""
        values = [getattr(e, name) for e in self.events if e.direction == direction]
        return float(np.median(values)) if values else float("nan")

    def count(self, direction: str) -> int:
        """Events that were read."""
        return sum(event.direction == direction for event in self.events)


def time_errors(
    data: GapData, model: FloatArray, events: Sequence[Sequence[Event]]
) -> Mapping[str, TimeErrors]:
    """Read every event on every output of `data.real` and of `model` (flights, time, outputs).

    Events that end before the speeds settle, responses below 8 % of the channel's range, and
    those that either side does not settle on are left out. A response is followed for up to 8 s
    after its event, as far as the lever rests: the flight may be slower than the model.
    """
    dt_s, lengths = data.flights.signals.dt_s, data.flights.lengths
    longer = [
        (f, replace(event, stop=min(event.stop + round(_AFTER_S / dt_s), until)))
        for f, flight in enumerate(events)
        for event, until in zip(
            flight, [*(later.start for later in flight), int(lengths[f])][1:], strict=True
        )
    ]
    return {
        name: TimeErrors(
            tuple(
                found
                for f, event in longer
                if (found := _read(data, model, (f, k), event)) is not None
            )
        )
        for k, name in enumerate(data.flights.signals.outputs)
    }


def _read(
    data: GapData, model: FloatArray, place: tuple[int, int], event: Event
) -> EventTimes | None:
    f, k = place
    if event.interrupted or not event.settled:
        return None
    dt_s = data.flights.signals.dt_s
    rows = slice(max(0, event.start - round(_BEFORE_S / dt_s)), event.stop)
    time_s = np.arange(rows.start, rows.stop, dtype=np.float64) * dt_s
    config = TransientConfig(least_response=_LEAST * float(data.span[k]), drift_share=0.1)
    flight = measure_transient(time_s, data.real[f, rows, k], event.start * dt_s, config)
    own = config.model_copy(update={"least_response": 0.0, "drift_share": 0.2})
    sim = measure_transient(time_s, model[f, rows, k], event.start * dt_s, own)
    if not _comparable(flight, sim):
        return None
    direction = "push" if event.label == PUSH else "pull"
    errors = (flight.Ti_s - sim.Ti_s, flight.Tt_s - sim.Tt_s)
    return EventTimes(f, event.start, direction, *errors)


def _comparable(flight: Transient, model: Transient) -> bool:
    if flight.reason is not None or model.reason is not None:
        return False
    return flight.response * model.response > 0.0
