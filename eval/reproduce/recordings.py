"""Studies of the recordings themselves, without a model.

`correlation`: tables 1 and 2 of the paper. `smoothing`: section 2.4, moving averages compared.
`segments`: sections 2.5 and 3.1, pushes and pulls cut out of the flights.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import islice
from typing import Any

import numpy as np
import pandas as pd

from data_prep.cleaning.smooth import cutoff_hz, frequency_response, moving_average
from data_prep.events import PULL, PUSH
from data_prep.log import Log
from data_prep.ranking import STRONG, flight_table, is_strong
from eval.judging.scores import rms
from eval.preparation import WINDOWS
from eval.report import figures, tables
from eval.report.style import Picture, unit, with_unit
from eval.report.tables import Cell, Table, figure
from eval.reproduce.data import DataSets, truth_of
from eval.reproduce.study import Claim, Study, claim, table_of
from narxcal.channels import symbol
from narxcal.support.arrays import FloatArray

CHOSEN = 11
_CHANGE_S = 0.5  # over which the change of a signal is taken, the same for every window
_FAST = 0.95  # the twentieth of the samples that move fastest


def smoothing(data: DataSets) -> Study:
    """Compare the windows by RMS error and by frequency response."""
    known = all(truth_of(data, log, data.speeds[0]) is not None for log in data.raw)
    rows = [row for name in data.config.narx.outputs for row in _channel(data, name, known=known)]
    against = "its value without sensors" if known else "the unsmoothed signal"
    return Study(
        key="smoothing",
        title="Width of the moving average",
        source="section 2.4, figures 4 and 5",
        text=f"RMS of the smoothed signal against {against}, pooled over the data sets; 'moving' "
        "is over the twentieth of the samples that move fastest within half a second. "
        + ("" if known else "The truth of a real flight is not known: this RMS can only grow with "
           "the window, and measures how much is removed, noise and signal together."),
        claims=[_window_claim(rows, name) for name in data.config.narx.outputs] if known else [],
        tables=[_smoothing_table(rows)],
        pictures=[figures.windows(data.prepared[0].trial)],
        results={"against_truth": known, "windows": rows},
    )  # fmt: skip


def errors(data: DataSets, name: str, window: int) -> tuple[FloatArray, FloatArray]:
    """Smoothed minus truth (the raw signal where there is none), and the change of that reference.

    Both (time,) over all data sets; NaN where samples are missing.
    """
    error, change = [], []
    for log in data.cleaned:
        raw, truth = log[name], truth_of(data, log, name)
        reference = raw if truth is None else truth
        error.append(moving_average(raw, window) - reference)
        change.append(_change(reference, log))
    return np.concatenate(error), np.concatenate(change)


def _change(values: FloatArray, log: Log) -> FloatArray:
    """Size of the change (time,) over half a second round each sample."""
    span = max(1, round(0.5 * _CHANGE_S / log.dt_s))
    padded = np.concatenate((np.full(span, np.nan), values, np.full(span, np.nan)))
    return np.asarray(np.abs(padded[2 * span :] - padded[: -2 * span]))


def _channel(data: DataSets, name: str, *, known: bool) -> list[dict[str, Any]]:
    windows = (1, *WINDOWS) if known else WINDOWS
    dt_s, rows = data.raw[0].dt_s, []
    for window in windows:
        error, change = errors(data, name, window)
        fast = change >= np.nanquantile(change, _FAST)
        gain = frequency_response(window, np.array([1.0]), dt_s)
        rows.append(
            {
                "channel": name,
                "window": window,
                "rms": rms(error),
                "rms_moving": rms(error[fast]),
                "rms_rest": rms(error[~fast]),
                "cutoff_hz": cutoff_hz(window, dt_s),
                "gain_1_hz": float(gain[0]),
            }
        )
    return rows


def best_window(rows: list[dict[str, Any]], name: str) -> int:
    """Window of those compared with the least RMS in one channel."""
    own = [row for row in rows if row["channel"] == name and row["window"] in WINDOWS]
    return int(min(own, key=lambda row: float(row["rms"]))["window"])


def _window_claim(rows: list[dict[str, Any]], name: str) -> Claim:
    own = {row["window"]: row["rms"] for row in rows if row["channel"] == name}
    best = best_window(rows, name)
    lost = f"{best} samples leave {own[best]:.3g} {unit(name)} and {CHOSEN} leave {own[CHOSEN]:.3g}"
    remark = "" if best == CHOSEN else f"{lost}: how noisy the sensor is decides"
    ratio = own[CHOSEN] / own[best]
    return claim("narx-paper", "window", ratio, name=symbol(name), remark=remark)


def _smoothing_table(rows: list[dict[str, Any]]) -> Table:
    head = (
        "channel", "window", "RMS", "RMS moving", "RMS elsewhere", "-3 dB at [Hz]", "gain at 1 Hz",
    )  # fmt: skip
    best = {row["channel"]: best_window(rows, row["channel"]) for row in rows}
    cells = [
        (
            with_unit(row["channel"]),
            Cell("none" if row["window"] == 1 else str(row["window"]), number=True),
            figure(row["rms"], "best" if row["window"] == best[row["channel"]] else ""),
            *(row[key] for key in ("rms_moving", "rms_rest", "cutoff_hz", "gain_1_hz")),
        )
        for row in rows
    ]
    return table_of("Moving averages compared; the least RMS is marked", head, cells)


PAPER_SEGMENTS = 152
SEGMENT_SETS = 10


def segments(data: DataSets) -> Study:
    """Count the events, and draw every one of them."""
    pushes = sum(event.label == PUSH for one in data.prepared for event in one.events)
    own = "the user's own data" if len(data.logs) < SEGMENT_SETS else ""
    more = "more or fewer than the paper's is no merit; every one is used"
    no_merit = more if pushes != PAPER_SEGMENTS else ""
    return Study(
        key="segments",
        title="Segments cut at the lever's movements",
        source="sections 2.5 and 3.1, figures 6 to 9",
        text="Each event runs from the last sample before the lever moves to where lever and "
        "speeds have settled. Label 0 is a push, 1 a pull.",
        claims=[
            claim("narx-paper", "sets", len(data.logs), remark=own),
            claim("narx-paper", "pushes", pushes, remark=no_merit),
        ],
        tables=[_segment_table(data)],
        pictures=_firsts(data),
        sheets=[one.view() for one in data.prepared],
        results={
            "pushes": pushes,
            "data_sets": [
                {"data_set": data.number(one.log.name), "log": one.log.name, **one.counts()}
                for one in data.prepared
            ],
        },
    )


def _segment_table(data: DataSets) -> Table:
    keys = ("found", "push", "pull", "fast", "slow", "small", "settled", "interrupted")
    rows: list[tuple[str | int | Cell, ...]] = [
        (data.number(one.log.name), _role(data, one.log), *(one.counts()[key] for key in keys))
        for one in data.prepared
    ]
    table = table_of("Events per data set", ("data set", "role", *keys), rows)
    total = [sum(one.counts()[key] for one in data.prepared) for key in keys]
    last = Cell("all", "strong"), Cell(""), *(Cell(str(n), "strong", number=True) for n in total)
    return replace(table, rows=(*table.rows, last))


def _role(data: DataSets, log: Log) -> str:
    parts = {"train": data.split.train, "validate": data.split.validate, "test": data.split.test}
    return next((name for name, logs in parts.items() if log.name in {x.name for x in logs}), "")


def _firsts(data: DataSets) -> list[Picture]:
    """The first fast push and the first fast pull of the first data set that has one."""
    names, drawn = (data.config.events.driver, *data.speeds), []
    for label, word in ((PUSH, "push"), (PULL, "pull")):
        fast = (
            (one.log, event)
            for one in data.prepared
            for event in one.events
            if event.label == label and event.speed == "fast"
        )
        for log, event in islice(fast, 1):
            title = f"First {word}, data set {data.number(log.name)}"
            drawn.append(figures.segment(log, event, names, title))
    return drawn


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
        claims=[_correlation_claim(lever, name, table) for name, table in found.items()],
        tables=[_correlation_table(name, table) for name, table in found.items()],
        results={"pearson": {name: _correlation_rows(table) for name, table in found.items()}},
    )


def leading(table: pd.DataFrame, lever: str) -> np.ndarray:
    """Mark the data sets (rows) in which `lever` is strong and no other input is stronger."""
    size = table.abs().fillna(0.0)
    best = size[lever] >= size.max(axis=1)
    return np.asarray(best & is_strong(table)[lever])


def _correlation_claim(lever: str, name: str, table: pd.DataFrame) -> Claim:
    first = leading(table, lever)
    weak = ", ".join(f"{table[lever].iloc[row]:+.2f}" for row in np.flatnonzero(~first))
    climbs = "altitude and Mach move the speeds too, over data sets that climb"
    return claim(
        "narx-paper", "driver", 100.0 * float(first.mean()), lever=symbol(lever),
        name=symbol(name), remark=f"elsewhere its rho is {weak}: {climbs}" if weak else "",
    )  # fmt: skip


def _correlation_table(name: str, table: pd.DataFrame) -> Table:
    numbered = table.set_axis(range(1, len(table) + 1))
    found = tables.pearson(numbered, f"Pearson's coefficient with {symbol(name)}", STRONG)
    return replace(found, head=("data set", *found.head[1:]))


def _correlation_rows(table: pd.DataFrame) -> list[dict[str, Any]]:
    rows = enumerate(table.to_dict(orient="records"), 1)
    return [{"data_set": number} | {str(k): v for k, v in row.items()} for number, row in rows]
