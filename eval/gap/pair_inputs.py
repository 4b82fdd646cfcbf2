"""Inputs of a pair of logs: the simulator's where it has them, and the same as were recorded."""

from __future__ import annotations

import numpy as np

from data_prep.log import Log
from data_prep.prepare import hold_inputs
from narxcal.channels import CHANNELS
from narxcal.support.arrays import FloatArray
from narxcal.support.errors import DataError

# Samples of an input may differ by this part of the channel's range, and few of them by more.
_ROUNDING, _FEW = 2e-3, 1e-3
_ROLES = ("lever", "ambient", "switch")


def inputs_of(name: str, real: Log, sim: Log, counts: dict[str, int]) -> dict[str, FloatArray]:
    """Inputs of either log; where both have one, the simulator's, for that is what it was told.

    Samples that were held over a hole are added to `counts`. Raises `DataError` where there is
    nothing to drive the engine, and where recorded and simulated inputs differ.
    """
    has = {**real.channels, **sim.channels}
    driver = "TRA_deg" if "TRA_deg" in has else "FF_kgph"
    if driver not in has:
        raise DataError(
            "there is no TRA_deg, and no FF_kgph to take for the driver",
            file=name,
            hint="Map the throttle's column, or the fuel flow's",
        )
    wanted = [
        each
        for each in CHANNELS
        if each in has and (CHANNELS[each].role in _ROLES or each == driver)
    ]
    found = {}
    for each in wanted:
        if each in real.channels and each in sim.channels:
            _check_same(name, real, sim, each)
        source = sim if each in sim.channels else real
        missing = int(np.count_nonzero(~np.isfinite(source[each])))
        if missing:
            counts[f"{each} held"] = missing
        found[each] = hold_inputs(source, [each])[each]
    return found


def _check_same(name: str, real: Log, sim: Log, channel: str) -> None:
    a, b = real[channel], sim[channel]
    known = np.isfinite(a) & np.isfinite(b)
    if not known.any():
        return
    row = CHANNELS[channel]
    span = min(row.high - row.low, 2.0 * float(np.ptp(b[known])) + float(np.abs(b[known]).max()))
    apart = np.zeros(len(a), dtype=np.bool_)
    apart[known] = np.abs(a[known] - b[known]) > _ROUNDING * span
    if apart.sum() <= _FEW * len(a):
        return
    first = int(np.argmax(apart))
    raise DataError(
        f"the inputs differ: recorded {a[first]:g}, simulated with {b[first]:g} "
        f"({int(apart.sum())} of {len(a)} samples differ by more than rounding)",
        file=name,
        channel=channel,
        row=first + 1,
        hint="Simulate with the inputs that were recorded",
    )


def is_input(name: str, log: Log) -> bool:
    """Whether a simulator takes the channel; fuel flow only where there is no lever."""
    if name == "FF_kgph":
        return "TRA_deg" not in log.channels
    return CHANNELS[name].role in _ROLES
