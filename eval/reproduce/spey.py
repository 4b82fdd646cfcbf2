"""The Spey paper (DeHoff et al.): its claims against its own tables and simulated flights.

The paper's records are not available: `paper_study` recomputes what follows from its tables.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from data_prep.log import Log
from eval.report.tables import Cell, Table
from eval.reproduce.spey_flights import birge_cell, flights_study
from eval.reproduce.spey_simulated import SIDES, simulated_study
from eval.reproduce.study import Claim, Study, Watch, table_of
from narxcal.output_error.engine import EngineAndControl
from narxcal.output_error.experiment import throttle_programme
from narxcal.output_error.paper import (
    SAMPLING_S,
    TABLE_3,
    TABLE_4,
    TAU_ENGINE,
    noise_sd,
    table_4,
)
from training.config import RunConfig
from training.likelihood_statistics import Combined, Difference, combine, compare
from training.spey import tau_engine

_ROW = {row.name: row for row in TABLE_4}


def paper_study() -> Study:
    """Claims that follow from the printed tables; contradictions carry their reason."""
    combined = {row.name: combine(row.estimates, row.sd) for row in TABLE_3}
    differences = compare(
        {row.name: row.side("left") for row in TABLE_4},
        {row.name: row.side("right") for row in TABLE_4},
    )
    return Study(
        key="spey-tables",
        title="The paper's tables, recomputed",
        source="DeHoff et al., tables 3 and 4",
        text="Table 3 is of the left engine. Means are weighted by 1/sd^2; the Birge ratio is the "
        "scatter between records over the reported standard deviation. The +- of Table 4 is taken "
        "as one standard deviation; significance at 5 % over all parameters together (Holm).",
        claims=[*_table_claims(combined), *_difference_claims(differences)],
        tables=[_table_3(combined), _table_4(differences)],
        results={
            "birge": {name: one.birge for name, one in combined.items()},
            "z": {one.name: one.z for one in differences},
        },
    )


def _table_claims(combined: Mapping[str, Combined]) -> list[Claim]:
    agree = [
        name
        for name, one in combined.items()
        if abs(one.value - _ROW[name].left) <= _ROW[name].left_sd
    ]
    closed = max(abs(tau_engine(table_4(side)).real - TAU_ENGINE.side(side)[0]) for side in SIDES)
    ratio = [_ratio(_ROW["tau_L"].side(side), _ROW["tau_H"].side(side)) for side in SIDES]
    worst = max(abs(value - 1.5) / sd for value, sd in ratio)
    return [
        Claim("S3 tau_engine differs from tau_H / (K_AF C_FB) by", "0.65 and 0.89 s", closed,
              "< 0.005 s",
              "holds only with the rows of equation 1 divided by tau and C_FB = C_FH"),
        Claim("S5 rows of Table 3 whose weighted mean is within one +- of Table 4", "all of 10",
              len(agree), ">= 10",
              "the pressure rows do not combine to Table 4: they stem from another step or "
              f"other records. Those that do: {', '.join(agree)}"),
        Claim("S6 differential response 50 % slower: largest |tau_L/tau_H - 1.5| in deviations",
              "1.5 for both engines", worst, "< 1.96",
              f"{ratio[0][0]:.2f} left, {ratio[1][0]:.2f} right: true of their mean only"),
        Claim("S9 flow lags negligible: change of P_D by tau_D = 0.05 s, share of sensor noise",
              "small", _effect_of_duct_lag(), "< 1",
              "RMS over the doublets of 5 deg; tau_E = 0 is read from a printed 1/tau_E = 0"),
        Claim("S10 white noise, no process noise: largest Birge ratio of Table 3", "repeatable",
              max(one.birge for one in combined.values()), f"< {math.sqrt(5.99 / 2.0)}",
              "scatter between records far above the reported deviations (5 % limit for three "
              "records 1.73): something unmodelled differs between them"),
    ]  # fmt: skip


def _ratio(a: tuple[float, float], b: tuple[float, float]) -> tuple[float, float]:
    value = a[0] / b[0]
    return value, value * math.hypot(a[1] / a[0], b[1] / b[0])


def _effect_of_duct_lag() -> float:
    """RMS change of the duct pressure when its lag is left out, in sensor deviations."""
    command = throttle_programme("doublets", 3000, 5.0)[:, None]
    engine = EngineAndControl(SAMPLING_S)
    base = {one.name: one.start for one in engine.parameters} | table_4("left")
    with_lag, without = (
        engine.simulate({**base, "tau_D": tau}, command)[:, -1] for tau in (0.05, 0.0)
    )
    return float(np.sqrt(np.mean((with_lag - without) ** 2)) / noise_sd()["P_DM"])


def _difference_claims(differences: Sequence[Difference]) -> list[Claim]:
    of = {one.name: one for one in differences}
    far = [one for one in differences if abs(one.percent) > 10.0 and one.name != "tau_H"]
    listed = ", ".join(
        f"{one.name} {one.percent:+.0f} % ({'' if one.significant else 'not '}significant)"
        for one in far
    )
    tau_H = of["tau_H"]
    return [
        Claim("S2 tau_H right above left: family-wise p", "35 %, significant", tau_H.p_holm,
              "< 0.05", f"{tau_H.percent:.1f} %, z = {tau_H.z:.2f}"),
        Claim("S4 other parameters that differ by more than 10 %", "none", len(far), "< 1",
              f"Table 4 says otherwise: {listed}"),
        *(
            Claim(f"{what}: |z| of {shown}", "equal", abs(of[name].z), "< 1.96", remark)
            for what, shown, name, remark in (
                ("S6 differential responses the same", "tau_L", "tau_L", ""),
                ("S7 throttle hysteresis equal", "a0", "a_fixed", "+-25 % each"),
                ("S8 fuel-to-speed gains nearly equal", "C_FH", "C_FH", "3.5 %"),
            )
        ),
    ]  # fmt: skip


def _table_3(combined: Mapping[str, Combined]) -> Table:
    head = ("parameter", "record 1", "record 2", "record 3", "mean", "Birge ratio", "Table 4 left")
    rows = [
        (
            row.name,
            *(
                Cell(f"{value:g} ({percent:g} %)", number=True)
                for value, percent in zip(row.estimates, row.sd_percent, strict=True)
            ),
            combined[row.name].value,
            birge_cell(combined[row.name]),
            _ROW[row.name].left,
        )
        for row in TABLE_3
    ]
    return table_of("Table 3: three records, standard deviations in percent", head, rows)


def _table_4(differences: Sequence[Difference]) -> Table:
    head = ("parameter", "left", "right", "difference [%]", "z", "significant", "read as")
    of = {one.name: one for one in differences}
    rows = [
        (
            row.name,
            Cell(f"{row.left:g} ± {row.left_sd:g}", number=True),
            Cell(f"{row.right:g} ± {row.right_sd:g}", number=True),
            of[row.name].percent if row.name in of else None,
            of[row.name].z if row.name in of else None,
            "yes" if row.name in of and of[row.name].significant else "no",
            row.reading,
        )
        for row in TABLE_4
    ]
    return table_of("Table 4: left against right engine", head, rows)


def spey_studies(
    seeds: int = 100,
    flights: tuple[Sequence[Log], RunConfig, Path] | None = None,
    jobs: int = 1,
    watch: Watch | None = None,
) -> tuple[Study, ...]:
    """All studies: the paper's tables, simulated engines, and flights if any are given.

    `flights` are prepared logs of both engines, their configuration and its folder. `watch` gets
    what is done, how much of it, and of how much.
    """
    studies = [paper_study(), simulated_study(seeds, jobs, watch)]
    if flights is not None:
        studies.append(flights_study(*flights, watch))
    return tuple(studies)
