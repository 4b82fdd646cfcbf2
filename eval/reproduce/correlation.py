"""Tables 1 and 2 of the paper: Pearson's coefficient of N1 and of N2 with each input."""

from __future__ import annotations

import math

import numpy as np
import pandas as pd

from data_prep.ranking import STRONG, flight_table, is_strong
from eval.report.claims import Claim, Study
from eval.report.style import symbol
from eval.report.tables import Cell, Table, figure
from eval.reproduce.data_sets import DataSets


def correlation(data: DataSets) -> Study:
    """Correlate the spool speeds with the four inputs over each data set."""
    lever = data.config.events.driver
    found = {name: flight_table(data.logs, data.inputs, name) for name in data.speeds}
    return Study(
        key="correlation",
        title="Which input drives the engine",
        source="section 2.5, tables 1 and 2",
        text=f"Pearson's coefficient over each whole data set. |rho| of {STRONG:g} or more counts "
        "as strong, as in the paper.",
        claims=[_claim(lever, name, table) for name, table in found.items()],
        tables=[_table(data, name, table) for name, table in found.items()],
        results={"pearson": {name: _rows(data, table) for name, table in found.items()}},
    )


def leading(table: pd.DataFrame, lever: str) -> np.ndarray:
    """Mark the data sets (rows) in which `lever` is strong and no other input is stronger."""
    size = table.abs().fillna(0.0)
    best = size[lever] >= size.max(axis=1)
    return np.asarray(best & is_strong(table)[lever])


def _claim(lever: str, name: str, table: pd.DataFrame) -> Claim:
    first = leading(table, lever)
    weak = [f"{table[lever].iloc[row]:+.2f}" for row in np.flatnonzero(~first)]
    return Claim(
        what=f"Data sets in which {symbol(lever)} is the strongest correlate of {symbol(name)} "
        "and a strong one",
        claimed="all",
        value=100.0 * float(first.mean()),
        bound=100.0,
        unit="%",
        below=False,
        remark=f"elsewhere its rho is {', '.join(weak)}: altitude and Mach move the speeds too, "
        "over data sets that climb" if weak else "",
    )  # fmt: skip


def _table(data: DataSets, name: str, table: pd.DataFrame) -> Table:
    rows = [
        (
            Cell(f"{row + 1}", "head"),
            *(
                Cell(f"{rho:+.3f}", "strong" if abs(rho) >= STRONG else "", number=True)
                if math.isfinite(rho)
                else figure(None)
                for _, rho in _row(table, log.name)
            ),
        )
        for row, log in enumerate(data.logs)
    ]
    head = ("data set", *(symbol(str(name)) for name in table.columns))
    return Table(f"Pearson's coefficient with {symbol(name)}", head, tuple(rows))


def _rows(data: DataSets, table: pd.DataFrame) -> list[dict[str, float | int]]:
    return [
        {"data_set": row + 1, **dict(_row(table, log.name))} for row, log in enumerate(data.logs)
    ]


def _row(table: pd.DataFrame, name: str) -> list[tuple[str, float]]:
    values = table.loc[name].to_numpy(dtype=np.float64)
    return list(zip(map(str, table.columns), values.tolist(), strict=True))
