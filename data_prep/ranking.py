"""Rank the channels that may drive the engine by their correlation with its outputs."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd

from data_prep.log import Log
from narxcal.channels import SPOOLS
from narxcal.support.arrays import FloatArray

# The calibration paper's rule, section 2.5: |rho| in [0.8, 1] is a strong correlation.
STRONG = 0.8
# Below this a driver explains less than a quarter of the variance of what it is to drive.
WEAK = 0.5
_DRIVERS = ("TRA_deg", "FF_kgph")  # channels that can drive an engine; spools respond at once


def pearson(log: Log, inputs: Sequence[str], outputs: Sequence[str]) -> pd.DataFrame:
    """Correlate each input (row) with each output (column) over one log.

    Pearson's rho over the samples that both channels have. It is NaN where it is not
    defined, and `attrs["reasons"]` then maps "input, output" to why. Raises `DataError` for
    a channel that the log does not have.
    """
    table = pd.DataFrame(np.nan, index=list(inputs), columns=list(outputs), dtype=np.float64)
    reasons: dict[str, str] = {}
    for source in inputs:
        for target in outputs:
            rho, reason = _rho(log[source], log[target])
            table.loc[source, target] = rho
            if reason:
                reasons[f"{source}, {target}"] = reason.format(source=source, target=target)
    table.attrs["reasons"] = reasons
    return table


def _rho(first: FloatArray, second: FloatArray) -> tuple[float, str]:
    both = np.isfinite(first) & np.isfinite(second)
    if both.sum() < 2:
        return float("nan"), "{source} and {target} have fewer than two samples in common"
    for name, values in (("{source}", first[both]), ("{target}", second[both])):
        # Rounding leaves a constant channel a deviation of some units in the last place.
        if np.ptp(values) <= 2e-12 * np.abs(values).max():
            return float("nan"), f"{name} is constant"
    return float(np.corrcoef(first[both], second[both])[0, 1]), ""


def flight_table(logs: Sequence[Log], inputs: Sequence[str], output: str) -> pd.DataFrame:
    """Tabulate one output per flight (row) and input (column): Tables 1 and 2 of the paper."""
    rows = {}
    reasons: dict[str, str] = {}
    for log in logs:
        one = pearson(log, inputs, [output])
        rows[log.name] = one[output]
        reasons |= {f"{log.name}, {pair}": why for pair, why in one.attrs["reasons"].items()}
    table = pd.DataFrame(rows).T.reindex(columns=list(inputs))
    table.attrs["reasons"] = reasons
    return table


def is_strong(table: pd.DataFrame) -> pd.DataFrame:
    """Mark the strong correlations of a table; an undefined one is not strong."""
    return table.abs() >= STRONG


def ranked(table: pd.DataFrame) -> pd.DataFrame:
    """Order the inputs (rows) of a `pearson` table by their mean |rho|, best first.

    Inputs that have no defined rho with one of the outputs come last.
    """
    strength = table.abs().mean(axis=1, skipna=False)
    order = strength.sort_values(ascending=False, kind="stable", na_position="last").index
    found = table.loc[order]
    found.attrs["reasons"] = table.attrs["reasons"]
    return found


def other_driver(log: Log, driver: str) -> str:
    """Warn of a spool speed that moves without `driver`; names the channel that does drive it."""
    speed = next((name for name in SPOOLS if log.recorded([name])), "")
    others = [name for name in _DRIVERS if name != driver and log.recorded([name])]
    if not speed or not others or not log.recorded([driver]):
        return ""
    table = pearson(log, [driver, *others], [speed])[speed].abs()
    best = max(others, key=lambda name: float(np.nan_to_num(table[name])))
    own = float(np.nan_to_num(table[driver]))
    if own >= WEAK or not table[best] >= STRONG:
        return ""
    return (
        f"{speed} moves without {driver} (correlation {own:.2f}), {best} drives it "
        f"({table[best]:.2f}): set [events] driver and [steady_state] inputs accordingly"
    )
