"""Pearson ranking: which channel drives the engine, per flight."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from data_prep.log import Log
from narxcal.errors import DataError

FloatArray = NDArray[np.float64]

# The calibration paper's rule, section 2.5: |rho| in [0.8, 1] is a strong correlation.
STRONG = 0.8


@dataclass(frozen=True)
class DriverChoice:
    """The candidate that goes with the outputs best.

    `strength` is the mean |rho| over the outputs, `strong` whether |rho| reaches 0.8 for each
    of them, `ranking` every candidate that varies with its strength, best first, and
    `reasons` says why the others are not in it.
    """

    channel: str
    strength: float
    strong: bool
    ranking: tuple[tuple[str, float], ...]
    reasons: dict[str, str]


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
    centred = []
    for values, name in ((first[both], "{source}"), (second[both], "{target}")):
        deviation = values - values.mean()
        # Rounding leaves a constant channel a deviation of some units in the last place.
        if np.abs(deviation).max() <= 1e-12 * np.abs(values).max():
            return float("nan"), f"{name} is constant"
        centred.append(deviation / np.linalg.norm(deviation))
    return float(np.clip(centred[0] @ centred[1], -1.0, 1.0)), ""


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


def ranked(table: pd.DataFrame) -> pd.Series:
    """Order the inputs of a `pearson` table by their mean |rho| over the outputs, best first.

    An input that has no defined rho with one of the outputs is left out.
    """
    strength = table.abs().mean(axis=1, skipna=False).dropna()
    return strength.sort_values(ascending=False, kind="stable")


def select_driver(log: Log, candidates: Sequence[str], outputs: Sequence[str]) -> DriverChoice:
    """Choose the channel whose changes define the events: the strongest of the candidates.

    Candidates that the log does not have, or that do not vary, are passed over with a reason.
    Raises `DataError` when none is left.
    """
    present = [name for name in candidates if name in log.channels]
    table = pearson(log, present, outputs)
    order = ranked(table)
    reasons = {name: "not in the log" for name in candidates if name not in present}
    for pair, why in table.attrs["reasons"].items():
        reasons.setdefault(pair.split(", ")[0], why)
    if order.empty:
        raise DataError(
            f"none of {', '.join(candidates)} varies together with {', '.join(outputs)}",
            file=log.name,
            hint="Use a log in which the lever moves, or name the driver in [events]",
        )
    best = str(order.index[0])
    return DriverChoice(
        channel=best,
        strength=float(order.iloc[0]),
        strong=bool(is_strong(table.loc[[best]]).all(axis=None)),
        ranking=tuple((str(name), float(value)) for name, value in order.items()),
        reasons=reasons,
    )
