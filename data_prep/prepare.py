"""From raw logs to prepared ones: the running engine's, cleaned, then smoothed.

What a reader has to know of logs before any figure that rests on them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from data_prep.clean import CleanConfig, clean
from data_prep.config import LogsConfig
from data_prep.equilibrium import USUAL, RunningConfig, while_running
from data_prep.events import EventsConfig, unconditional
from data_prep.grid import SLOW
from data_prep.log import Log
from data_prep.recorded import NOT_RECORDED, unrecorded
from data_prep.smooth import SmoothConfig, smooth


class Sections(Protocol):
    """Whatever holds the three tables: the whole run configuration, or `Preparation`."""

    @property
    def running(self) -> RunningConfig:
        """Table `[running]`."""

    @property
    def clean(self) -> CleanConfig:
        """Table `[clean]`."""

    @property
    def smooth(self) -> SmoothConfig:
        """Table `[smooth]`."""


@dataclass(frozen=True)
class Preparation:
    """The three tables alone, for use without a run configuration."""

    clean: CleanConfig = field(default_factory=CleanConfig)
    smooth: SmoothConfig = field(default_factory=SmoothConfig)
    running: RunningConfig = field(default_factory=RunningConfig)


def prepare(logs: Sequence[Log], sections: Sections | None = None) -> list[Log]:
    """Leave out where the engine stands, then clean and smooth; the audit says what changed."""
    wanted = sections or Preparation()
    runs = while_running(logs, wanted.running)
    return [smooth(clean(log, wanted.clean), wanted.smooth) for log in runs]


_MANY = 0.1  # share of a recording's rows
_TOLERANCE_S = 0.25  # what the rules for Ti and Tt allow (FAA 14 CFR part 60)


def cautions(
    logs: Sequence[Log],
    events: EventsConfig,
    outputs: Sequence[str] = (),
    mapping: LogsConfig = LogsConfig(),  # noqa: B008 (it cannot be changed)
) -> list[str]:
    """Sentences without a full stop; none where there is nothing to say.

    `outputs` are those of the model, and `mapping` says in which columns they were looked for.
    """
    said = (
        *map(crowded, logs),
        *map(never_runs, logs),
        *map(all_masked, logs),
        *(unrecorded(log, outputs, mapping) for log in logs),
        *(seldom(log, events) for log in logs),
        unconditional(logs, events),
    )
    return [text for text in said if text]


def never_runs(log: Log) -> str:
    """What to say of a log whose speeds stay below any idle: they may be ratios, not percent."""
    highest = {
        name: float(np.nanmax(log[name]))
        for name in USUAL
        if name in log.channels and np.isfinite(log[name]).any()
    }
    if not highest or any(value >= USUAL[name] for name, value in highest.items()):
        return ""
    told = " and ".join(f"{name} {value:.3g} %" for name, value in highest.items())
    return f"{log.name}: the engine never runs, at most {told}: is the unit right?"


def seldom(log: Log, events: EventsConfig) -> str:
    """What to say of a log whose events can be read no better than the rules ask; else empty."""
    filled = {entry.channel: entry.samples for entry in log.audit.entries if entry.reason == SLOW}
    told = []
    for name in dict.fromkeys((events.driver, *events.response)):
        if name not in log.channels:
            continue
        known = max(int(np.isfinite(log[name]).sum()), 1)
        every_s = log.dt_s * known / max(known - filled.get(name, 0), 1)
        if every_s > _TOLERANCE_S:
            told.append(f"{name} about every {every_s:.1g} s")
    if not told:
        return ""
    return (
        f"{log.name}: recorded are {' and '.join(told)}, while Ti and Tt have to agree within "
        f"{_TOLERANCE_S} s: what they say rests on interpolation"
    )


def all_masked(log: Log) -> str:
    """What to say of channels of which cleaning left nothing; empty if it left some of each."""
    masked = {name: why for name, why in log.audit.masked().items() if NOT_RECORDED not in why}
    empty = [name for name, values in log.channels.items() if not np.isfinite(values).any()]
    told = [f"{name} ({', '.join(masked[name])})" for name in empty if name in masked]
    if not told:
        return ""
    return f"{log.name}: no sample is left of {', '.join(told)}: check column and unit"


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
