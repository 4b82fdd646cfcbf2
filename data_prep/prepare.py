"""Prepare logs: the running engine's parts, cleaned and smoothed, with all warnings about them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple, Self

import numpy as np
from pydantic import model_validator

from data_prep.cleaning.clean import CleanConfig, clean
from data_prep.cleaning.plausibility import checked, of_cleaning
from data_prep.cleaning.smooth import SmoothConfig, blurs, smooth
from data_prep.config import ENGINE, LogsConfig
from data_prep.equilibrium import (
    BELOW_IDLE,
    QuasiSteadyConfig,
    RunningConfig,
    quasi_steady,
    while_running,
)
from data_prep.events import Event, EventsConfig, find_events, needs_condition
from data_prep.log import CODE_WORD, LONG_SPAN_S, AuditEntry, Log
from data_prep.ranking import other_driver
from data_prep.sources.grid import SLOW
from narxcal.channels import spools_of
from narxcal.support.arrays import BoolArray, sample_and_hold, spans
from narxcal.support.errors import DataError
from narxcal.support.settings import Section

NOT_RECORDED = "not recorded"
HELD = "held for the model"
_MANY = 0.1  # share of a recording's rows
FRAGMENT = "fragment without a valid sample of a channel"
LEAST_PART_S = 20.0  # shorter parts of a divided log show no response with its settling
_TOLERANCE_S = 0.25  # within which Ti and Tt have to agree (FAA 14 CFR part 60)
_MOST_NAMED = 3  # logs in one line


class Preparation(Section):
    """The tables that preparation needs; a run configuration has them, too."""

    logs: LogsConfig = LogsConfig()
    running: RunningConfig = RunningConfig()
    clean: CleanConfig = CleanConfig()
    smooth: SmoothConfig = SmoothConfig()
    events: EventsConfig = EventsConfig()
    quasi_steady: QuasiSteadyConfig = QuasiSteadyConfig()

    def named_channels(self) -> tuple[str, ...]:
        """Channels that the tables name, which have to be built in or declared."""
        return tuple(self.running.above)

    @model_validator(mode="after")
    def _names_are_known(self) -> Self:
        for name in self.named_channels():
            self.logs.channel(name)
        return self


class LogWarning(NamedTuple):
    """What a reader of figures of one log has to know.

    `text` is a sentence without the log's name and without a full stop.
    """

    log: str
    kind: str
    text: str


@dataclass(frozen=True, eq=False)
class Prepared:
    """A cleaned and smoothed log; its events, equilibrium and warnings are found when first used.

    `outputs` are those of the model, so far as there is one.
    """

    log: Log
    tables: Preparation
    outputs: tuple[str, ...] = ()

    @cached_property
    def events(self) -> tuple[Event, ...]:
        """Pushes and pulls in order of time; raises as `data_prep.events.find_events`."""
        return tuple(find_events(self.log, self.tables.events.for_log(self.log, self.outputs)))

    @cached_property
    def equilibrium(self) -> BoolArray:
        """The quasi-steady samples (time,)."""
        spools = spools_of(self.outputs)
        return quasi_steady(self.log, self.tables.events.driver, spools, self.tables.quasi_steady)

    @cached_property
    def warnings(self) -> tuple[LogWarning, ...]:
        found = {
            "crowded": crowded(self.log),
            "fragment": _fragments(self.log),
            "unit": _never_runs(self.log),
            "masked": _all_masked(self.log),
            "coded": _coded(self.log),
            "outputs": _unrecorded(self.log, self.outputs, self.tables.logs),
            "rate": _slow_rate(self.log, self.tables.events),
            "driver": other_driver(self.log, self.tables.events.driver),
            "condition": needs_condition(self.log, self.tables.events),
            "window": blurs(self.tables.smooth, self.log.dt_s),
        }
        return tuple(LogWarning(self.log.name, kind, text) for kind, text in found.items() if text)


def prepare(logs: Sequence[Log], tables: Preparation | None = None) -> list[Prepared]:
    """Leave out where the engine does not run, clean and smooth; the audit counts what changed.

    So are fragments of a recording in which cleaning leaves nothing of a channel.
    """
    wanted = tables or Preparation()
    running = map(checked, while_running(logs, wanted.running))
    ready = [smooth(of_cleaning(clean(log, wanted.clean)), wanted.smooth) for log in running]
    return [Prepared(log, wanted) for log in _without_fragments(ready)]


def _without_fragments(logs: Sequence[Log]) -> list[Log]:
    """Leave out short parts that lack a channel; the longest part of the recording counts them."""
    found: dict[str, list[Log]] = {}
    for log in logs:
        found.setdefault(log.name.partition("#")[0], []).append(log)
    kept = []
    for parts in found.values():
        longest = max(parts, key=len)
        there = len(longest.recorded(tuple(longest.channels)))
        lost = [
            log
            for log in parts
            if len(log) * log.dt_s < LEAST_PART_S and len(log.recorded(tuple(log.channels))) < there
        ]
        for log in (each for each in parts if each not in lost):
            rows = sum(map(len, lost)) if log is longest else 0
            entry = AuditEntry("*", "dropped", FRAGMENT, rows)
            kept.append(replace(log, audit=log.audit.add(entry)) if rows else log)
    return kept


def cautions(logs: Iterable[Log], tables: Preparation, outputs: Sequence[str] = ()) -> list[str]:
    """Return the warnings about prepared logs as `in_lines` words them."""
    return in_lines(each for log in logs for each in Prepared(log, tables, tuple(outputs)).warnings)


def in_lines(warnings: Iterable[LogWarning]) -> list[str]:
    """Word the warnings about several logs, those of one kind in one line if they are many."""
    found: dict[str, list[LogWarning]] = {}
    for warning in warnings:
        found.setdefault(warning.kind, []).append(warning)
    return [line for group in found.values() for line in _lines(group)]


def _lines(group: Sequence[LogWarning]) -> Iterator[str]:
    """Join warnings of one kind: the same text once, many texts by the first one and a count."""
    if len({warning.text for warning in group}) == 1:
        names = ", ".join(warning.log for warning in group[:_MOST_NAMED])
        more = len(group) - _MOST_NAMED
        yield f"{names}{f' and {more} more' if more > 0 else ''}: {group[0].text}"
    elif len(group) <= _MOST_NAMED:
        yield from (f"{warning.log}: {warning.text}" for warning in group)
    else:
        yield f"{group[0].log} and, likewise, {len(group) - 1} more: {group[0].text}"


def crowded(log: Log) -> str:
    """Warn of a log that lost many rows to equal stamps."""
    lost: dict[str, int] = {}
    for entry in log.audit.entries:
        if entry.reason == "duplicate time stamp":
            lost[entry.channel] = lost.get(entry.channel, 0) + entry.samples
    most = max(lost.values(), default=0)
    if most <= _MANY * (len(log) + most):
        return ""
    return (
        f"{most} rows have the time stamp of the row before and were left out; its stamps are "
        "coarser than its rows"
    )


def _fragments(log: Log) -> str:
    """Say how many samples of fragments were left out."""
    lost = sum(each.samples for each in log.audit.entries if each.reason == FRAGMENT)
    why = f"in parts below {LEAST_PART_S:g} s nothing is left of a channel"
    return f"{lost} samples are left out: {why}" if lost else ""


def _never_runs(log: Log) -> str:
    """Warn of speeds that stay below any idle: they may be ratios, not percent."""
    highest = {name: float(np.nanmax(log[name])) for name in log.recorded(tuple(BELOW_IDLE))}
    if not highest or any(value >= BELOW_IDLE[name] for name, value in highest.items()):
        return ""
    most = " and ".join(f"{name} {value:.3g} %" for name, value in highest.items())
    return f"the engine never runs, at most {most}: is the unit right?"


def _all_masked(log: Log) -> str:
    """Warn of channels of which cleaning left nothing."""
    masked = {name: why for name, why in log.audit.masked().items() if NOT_RECORDED not in why}
    empty = [name for name, values in log.channels.items() if not np.isfinite(values).any()]
    named = [f"{name} ({', '.join(masked[name])})" for name in empty if name in masked]
    return f"no sample is left of {', '.join(named)}: check column and unit" if named else ""


def _coded(log: Log) -> str:
    """Warn of channels of which half of the recorded samples are code words."""
    words: dict[str, int] = {}
    for entry in log.audit.entries:
        if entry.reason.startswith(CODE_WORD):
            words[entry.channel] = words.get(entry.channel, 0) + entry.samples
    known = {
        name: int(np.isfinite(log[name]).sum()) - int(log.interpolated.get(name, np.zeros(0)).sum())
        for name in words
        if name in log.channels
    }
    most = [f"{name} ({words[name]})" for name, count in known.items() if words[name] >= count]
    return f"half of the samples or more are code words: {', '.join(most)}" if most else ""


def _slow_rate(log: Log, events: EventsConfig) -> str:
    """Warn of channels whose sampling interval exceeds the tolerance on Ti and Tt."""
    filled = {entry.channel: entry.samples for entry in log.audit.entries if entry.reason == SLOW}
    slow = []
    for name in dict.fromkeys((events.driver, *events.response)):
        if name not in log.channels:
            continue
        known = max(int(np.isfinite(log[name]).sum()), 1)
        every_s = log.dt_s * known / max(known - filled.get(name, 0), 1)
        if every_s > _TOLERANCE_S:
            slow.append(f"{name} is sampled every {every_s:.1g} s")
    if not slow:
        return ""
    return (
        f"{' and '.join(slow)}, coarser than the tolerance of {_TOLERANCE_S} s on Ti and Tt: these "
        "times are limited by interpolation"
    )


def _unrecorded(log: Log, outputs: Sequence[str], config: LogsConfig) -> str:
    """Warn of outputs that the log lacks, with the columns they were looked for in."""
    lacking = [
        f"{name}{_column(name, config, log.source.engine)}"
        for name in outputs
        if name not in log.channels or NOT_RECORDED in log.audit.masked().get(name, {})
    ]
    if not lacking:
        return ""
    are, by = ("is", "it") if len(lacking) == 1 else ("are", "them")
    return f"{', '.join(lacking)} {are} not recorded: nothing is learned or judged by {by}"


def _column(name: str, config: LogsConfig, engine: str) -> str:
    """Name the column, if it is not the channel's own name."""
    if name not in config.columns:
        return ""
    column = config.columns[name].column.replace(ENGINE, config.engines.get(engine, ""))
    return f" (column '{column}')"


def with_outputs(log: Log, outputs: Sequence[str]) -> Log:
    """Add the outputs of a model that the log lacks as NaN (time,), with an audit entry.

    A flight without a temperature probe still describes the spools; scores and Ti/Tt skip the
    channel without a sample. Raises `DataError` for a log that has none of them.
    """
    lacking = [name for name in outputs if name not in log.channels]
    if not lacking:
        return log
    if len(lacking) == len(outputs):
        raise DataError(
            f"the log has none of the outputs {', '.join(outputs)}",
            file=log.name,
            hint="Map one of them under [logs.columns], or run the model alone by narxcal simulate."
            f" The log has {', '.join(log.channels)}",
        )
    masked = [AuditEntry(name, "masked", NOT_RECORDED, len(log)) for name in lacking]
    return log.with_channels({name: np.full(len(log), np.nan) for name in lacking}, *masked)


def hold_inputs(log: Log, names: Sequence[str]) -> Log:
    """Fill masked samples of the named channels by sample-and-hold, and count them.

    A free run cannot step over a gap in its inputs. Raises `DataError` for a channel that the log
    lacks or has no valid sample of.
    """
    completed, entries = {}, []
    for name in names:
        if name not in log.channels:
            raise DataError(
                "an input of the model is not in the log",
                file=log.name,
                channel=name,
                hint=f"Map it under [logs.columns], if need be as {name} = {{ constant = ... }}, "
                f"or take it out of [steady_state] inputs. The log has {', '.join(log.channels)}",
            )
        values = log[name]
        unknown = ~np.isfinite(values)
        missing = int(unknown.sum())
        if not missing:
            continue
        if missing == len(values):
            raise DataError(
                "an input of the model has no valid sample",
                file=log.name,
                channel=name,
                hint="Map another column to it, or leave the log out",
            )
        completed[name] = sample_and_hold(values)
        long = tuple(
            (float(log.time_s[start]), float(log.time_s[stop - 1]))
            for start, stop in spans(unknown)
            if (stop - start) * log.dt_s >= LONG_SPAN_S
        )
        entries.append(AuditEntry(name, "filled", HELD, missing, long))
    return log.with_channels(completed, *entries) if completed else log
