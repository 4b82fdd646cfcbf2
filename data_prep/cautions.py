"""What a reader has to know of logs before any figure that rests on them."""

from __future__ import annotations

from collections.abc import Sequence

from data_prep.events import EventsConfig, unconditional
from data_prep.log import Log

_MANY = 0.1  # share of a recording's rows


def cautions(logs: Sequence[Log], events: EventsConfig) -> list[str]:
    """Sentences without a full stop; none where there is nothing to say."""
    return [text for text in (*map(crowded, logs), unconditional(logs, events)) if text]


def crowded(log: Log) -> str:
    """What to say of a log that lost many rows to equal stamps; empty for others."""
    lost: dict[str, int] = {}
    for entry in log.audit.entries:
        if entry.reason == "duplicate time stamp":
            lost[entry.channel] = lost.get(entry.channel, 0) + entry.samples
    most = max(lost.values(), default=0)
    if most <= _MANY * (len(log) + most):
        return ""
    return (
        f"{log.name}: {most} rows have the time stamp of the row before and were left out; its "
        "stamps are coarser than its rows"
    )
