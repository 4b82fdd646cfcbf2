"""What a log does not record of a model's outputs: such an output is told, masked and not judged.

A flight without a temperature probe still says everything about the spools. The channel that is not
there becomes one without a sample, so that whoever counts samples channel by channel needs no rule
of its own, and its audit says why it is empty.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from data_prep.config import ENGINE, LogsConfig
from data_prep.events import EventsConfig
from data_prep.log import AuditEntry, Log
from narxcal.support.errors import DataError

NOT_RECORDED = "not recorded"


def with_outputs(log: Log, outputs: Sequence[str]) -> Log:
    """The log with each of `outputs`; those that it lacks are NaN (time,) and counted as masked.

    Raises `DataError` for a log that has none of them.
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


def recorded(log: Log, names: Sequence[str]) -> tuple[str, ...]:
    """Those of `names` of which the log has a sample."""
    there = (name for name in names if name in log.channels)
    return tuple(name for name in there if np.isfinite(log[name]).any())


def events_config(log: Log, config: EventsConfig, outputs: Sequence[str]) -> EventsConfig:
    """`config` with the responses that `log` holds; without any, with all `outputs` it holds.

    An event ends when its responses have settled: one that is not recorded says nothing about that,
    and with none left every event would end with the lever's rest.
    """
    known = recorded(log, config.response) or recorded(log, outputs)
    return config.model_copy(update={"response": known}) if known else config


def unrecorded(log: Log, outputs: Sequence[str], config: LogsConfig) -> str:
    """What to say of outputs that the log lacks, and of their columns; empty where it has all."""
    told = [
        f"{name}{_column(name, config, log.source.engine)}"
        for name in outputs
        if name not in log.channels or NOT_RECORDED in log.audit.masked().get(name, {})
    ]
    if not told:
        return ""
    are, by = ("is", "it") if len(told) == 1 else ("are", "them")
    return f"{log.name}: {', '.join(told)} {are} not recorded: nothing is learned or judged by {by}"


def _column(name: str, config: LogsConfig, engine: str) -> str:
    """Where it was looked for, if not under its own name."""
    if name not in config.columns:
        return ""
    column = config.columns[name].column.replace(ENGINE, config.engines.get(engine, ""))
    return f" (column '{column}')"
