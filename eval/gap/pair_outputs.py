"""Outputs of a pair of logs: which can be compared, and whether there is enough of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from data_prep.log import Log
from narxcal.support.arrays import FloatArray, bridge_gaps
from narxcal.support.errors import DataError

SPEEDS = ("N1_pct", "N2_pct")
DIAGNOSED = (*SPEEDS, "EGT_C", "FF_kgph")
_MOST_MISSING = 0.2


def outputs_of(name: str, real: Log, sim: Log, inputs: Mapping[str, FloatArray]) -> tuple[str, ...]:
    """Outputs that are compared: those on both sides.

    Raises `DataError` where no spool speed is among them.
    """
    candidates = [each for each in DIAGNOSED if each not in inputs]
    both = tuple(e for e in candidates if e in real.channels and e in sim.channels)
    if not any(each in both for each in SPEEDS):
        raise DataError(
            f"recorded and simulated log share neither {' nor '.join(SPEEDS)}",
            file=name,
            hint=f"A spool speed has to be on both sides; recorded are {_named(real, candidates)}, "
            f"simulated are {_named(sim, candidates)}",
        )
    return both


def _named(log: Log, outputs: Sequence[str]) -> str:
    return ", ".join(each for each in outputs if each in log.channels) or "none of the outputs"


def lone(real: Log, sim: Log, outputs: Sequence[str]) -> dict[str, str]:
    """Outputs that only one side has: channel -> which."""
    one, other = "recorded but not simulated", "simulated but not recorded"
    return {
        each: one if each in real.channels else other
        for each in outputs
        if (each in real.channels) != (each in sim.channels)
    }


def complete(name: str, sim: Log, channel: str, counts: dict[str, int]) -> FloatArray:
    """A simulated channel (time,) with its holes bridged, and these added to `counts`.

    Raises `DataError` where too much is missing or the channel is constant.
    """
    values = sim[channel]
    missing = int(np.count_nonzero(~np.isfinite(values)))
    if missing > _MOST_MISSING * len(values):
        raise DataError(
            f"{missing} of {len(values)} simulated samples are missing",
            file=name,
            channel=channel,
            hint="Simulate the whole flight, or leave the log or the channel out",
        )
    if missing:
        counts[f"{channel} simulated missing"] = missing
    _check_varies(name, values, channel, "simulated")
    return bridge_gaps(values)


def check_recorded(name: str, real: Log, channel: str, counts: dict[str, int]) -> None:
    """Add the unknown samples of a recorded channel to `counts`.

    Raises `DataError` where nothing is known or the channel is constant.
    """
    values = real[channel]
    missing = int(np.count_nonzero(~np.isfinite(values)))
    if missing == len(values):
        raise DataError(
            "no recorded sample is known",
            file=name,
            channel=channel,
            hint="Leave the channel out of all logs, or this log out",
        )
    if missing:
        counts[f"{channel} unknown"] = missing
    _check_varies(name, values, channel, "recorded")


def _check_varies(name: str, values: FloatArray, channel: str, what: str) -> None:
    known = values[np.isfinite(values)]
    if np.ptp(known) <= 1e-9 * max(1.0, float(np.abs(known).max())):
        raise DataError(
            f"the {what} channel is constant ({known[0]:g} throughout)",
            file=name,
            channel=channel,
            hint="Its sensor is stuck, or another column is meant; leave the channel or log out",
        )
