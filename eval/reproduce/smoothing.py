"""Section 2.4 of the paper: moving averages of 3, 11 and 21 samples compared."""

from __future__ import annotations

from typing import Any

import numpy as np

from data_prep.log import FloatArray, Log
from data_prep.smooth import cutoff_hz, frequency_response, moving_average
from eval.preparation import WINDOWS
from eval.report import study_figures
from eval.report.claims import Claim, Study
from eval.report.style import symbol, unit, with_unit
from eval.report.tables import Cell, Table, figure
from eval.reproduce.data_sets import DataSets, truth_of

CHOSEN = 11
_PACE_S = 0.5  # over which a signal's pace is taken, the same for every window
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
           "the window, and says how much is taken away, noise and signal together."),
        claims=_claims(rows, data) if known else [],
        tables=[_table(rows)],
        pictures=[study_figures.windows(data.prepared[0].trial)],
        results={"against_truth": known, "windows": rows},
    )  # fmt: skip


def errors(data: DataSets, name: str, window: int) -> tuple[FloatArray, FloatArray]:
    """Smoothed minus truth (the raw signal where there is none), and the pace of that reference.

    Both (time,) over all data sets; NaN where samples are missing.
    """
    error, pace = [], []
    for log in data.cleaned:
        raw, truth = log[name], truth_of(data, log, name)
        reference = raw if truth is None else truth
        error.append(moving_average(raw, window) - reference)
        pace.append(_pace(reference, log))
    return np.concatenate(error), np.concatenate(pace)


def _pace(values: FloatArray, log: Log) -> FloatArray:
    span = max(1, round(0.5 * _PACE_S / log.dt_s))
    padded = np.concatenate((np.full(span, np.nan), values, np.full(span, np.nan)))
    return np.asarray(np.abs(padded[2 * span :] - padded[: -2 * span]))


def _channel(data: DataSets, name: str, *, known: bool) -> list[dict[str, Any]]:
    windows = (1, *WINDOWS) if known else WINDOWS
    dt_s, rows = data.raw[0].dt_s, []
    for window in windows:
        error, pace = errors(data, name, window)
        fast = pace >= np.nanquantile(pace, _FAST)
        gain = frequency_response(window, np.array([1.0]), dt_s)
        rows.append(
            {
                "channel": name,
                "window": window,
                "rms": _rms(error),
                "rms_moving": _rms(error[fast]),
                "rms_rest": _rms(error[~fast]),
                "cutoff_hz": cutoff_hz(window, dt_s),
                "gain_1_hz": float(gain[0]),
            }
        )
    return rows


def _rms(error: FloatArray) -> float:
    return float(np.sqrt(np.nanmean(error**2)))


def best_window(rows: list[dict[str, Any]], name: str) -> int:
    """Window of those compared with the least RMS in one channel."""
    own = [row for row in rows if row["channel"] == name and row["window"] in WINDOWS]
    return int(min(own, key=lambda row: float(row["rms"]))["window"])


def _claims(rows: list[dict[str, Any]], data: DataSets) -> list[Claim]:
    return [_claim(rows, name) for name in data.config.narx.outputs]


def _claim(rows: list[dict[str, Any]], name: str) -> Claim:
    own = {row["window"]: row["rms"] for row in rows if row["channel"] == name}
    best = best_window(rows, name)
    lost = f"{best} samples leave {own[best]:.3g} {unit(name)} and {CHOSEN} leave {own[CHOSEN]:.3g}"
    return Claim(
        what=f"RMS error of {symbol(name)} with {CHOSEN} samples, over that with the best window",
        claimed="1 (11 is the best of 3, 11 and 21)",
        value=own[CHOSEN] / own[best],
        bound=1.0 + 1e-9,
        remark="" if best == CHOSEN else f"{lost}: how noisy the sensor is decides",
    )


def _table(rows: list[dict[str, Any]]) -> Table:
    head = (
        "channel", "window", "RMS", "RMS moving", "RMS elsewhere", "-3 dB at [Hz]", "gain at 1 Hz",
    )  # fmt: skip
    cells = [
        (
            Cell(with_unit(row["channel"]), "head"),
            Cell("none" if row["window"] == 1 else str(row["window"]), number=True),
            figure(row["rms"], "best" if _is_best(rows, row) else ""),
            *(figure(row[key]) for key in ("rms_moving", "rms_rest", "cutoff_hz", "gain_1_hz")),
        )
        for row in rows
    ]
    return Table("Moving averages compared; the least RMS is marked", head, tuple(cells))


def _is_best(rows: list[dict[str, Any]], row: dict[str, Any]) -> bool:
    return bool(row["window"] == best_window(rows, row["channel"]))
