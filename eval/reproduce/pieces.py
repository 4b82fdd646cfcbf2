"""The segments that the paper's networks are trained on: one event each, with a short lead."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from data_prep.events import EventsConfig, find_events
from data_prep.log import Log
from training.crossval import Segment
from training.pipeline import Split

LEAD_S = 3.0


def pieces(log: Log, config: EventsConfig) -> list[Segment]:
    """Cut a log into one piece per event, from `LEAD_S` before it to its end; they never overlap.

    What lies between the events, long flights at rest, belongs to none. Events are those of the
    whole log, on the ground too.
    """
    found, last = [], 0
    lead = round(LEAD_S / log.dt_s)
    for event in find_events(log, config.model_copy(update={"condition": ""})):
        start = max(last, event.start - lead)
        part = replace(log.part(start, event.stop), name=f"{log.name}[{start}:{event.stop}]")
        own = replace(event, log=part.name, start=event.start - start, stop=event.stop - start)
        found.append(Segment(part, 0, len(part), (own,)))
        last = event.stop
    return found


def cut(logs: Sequence[Log], config: EventsConfig) -> tuple[Log, ...]:
    """Pieces of all logs as logs of their own; a log without events stays whole."""
    return tuple(part for log in logs for part in [one.log for one in pieces(log, config)] or [log])


def trained_on_pieces(split: Split, config: EventsConfig) -> Split:
    """The split with its training logs cut into pieces."""
    return replace(split, train=cut(split.train, config))
