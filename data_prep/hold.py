"""Completes the inputs of a model: a free run cannot step over a hole."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from data_prep.log import AuditEntry, Log
from narxcal.support.arrays import sample_and_hold
from narxcal.support.errors import DataError


def hold_inputs(log: Log, names: Sequence[str]) -> Log:
    """Carry the last known value of each named channel over its masked samples, and count them.

    Samples before the first known one take that one. Raises `DataError` for a channel with no
    known sample at all.
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
        missing = int((~np.isfinite(values)).sum())
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
        entries.append(AuditEntry(name, "filled", "held for the model", missing))
    return log.with_channels(completed, *entries) if completed else log
