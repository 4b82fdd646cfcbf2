"""Recorded flights with a known fault of one or two channels: the test on real engines.

A channel of every engine of a flight comes late, lags, is biased, drifts or is scaled, and so does
what drives the engine. The files keep their columns and units, so that they are diagnosed as they
would be at their owner's, by a simulator identified on other flights. What else these engines have
stays in: a flight that is not altered is the null.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
import pandas as pd

from data_prep.config import ENGINE, LogsConfig
from data_prep.sources.text_file import open_text
from data_prep.sources.units import find_unit
from eval.diagnosis.blind.cases import BlindPlan, case_name, drawn
from eval.diagnosis.blind.files import write_log
from eval.diagnosis.blind.make import Made
from narxcal.channels import channel
from narxcal.flight_test.signals import first_order
from narxcal.support.arrays import FloatArray
from narxcal.support.errors import ConfigError, DataError

DRIVER: Final = "driver"
SIZES: Final = (2.0, 1.0, 0.5)  # times the size that can be named
_NULLS, _PAIRS = 8, 4  # one case in so many


class Alteration(NamedTuple):
    """A fault of a recording: what it does to a channel, and the smallest size that is named.

    `nameable` is what a model of two other flights of this aircraft can name (sqrt(8 v) standard
    errors, v the spread of this effect's gain over unaltered flights), by the library's parameter.
    """

    id: str
    channel: str
    parameter: str
    nameable: float

    def applied(self, values: FloatArray, time_s: FloatArray, size: float) -> FloatArray:
        """`values` (time,) with the fault of a size, in the unit of the channel."""
        known = np.isfinite(values)
        if not known.any():
            return values
        complete = np.interp(time_s, time_s[known], values[known])
        return np.where(known, _FAULTS[self.id](complete, time_s, size), np.nan)


# What a fault makes of readings `y`, complete, at times `t`, by its size.
_FAULTS: Final[dict[str, Callable[[FloatArray, FloatArray, float], FloatArray]]] = {
    "time_skew": lambda y, t, size: np.interp(t - size, t, y),
    # A driver recorded late is an engine that answers early: a negative delay.
    "throttle_delay": lambda y, t, size: np.interp(t + size, t, y),
    "sensor_lag": lambda y, t, size: first_order(y, size, float(np.median(np.diff(t)))),
    "sensor_bias": lambda y, _, size: y + size,
    "sensor_drift": lambda y, t, size: y + size * (t - t[0]) / 3600.0,
    "sensor_gain": lambda y, _, size: y * (1.0 + 0.01 * size),
    # The engine gets more than is recorded.
    "driver_gain": lambda y, _, size: y / (1.0 + 0.01 * size),
}
ALTERATIONS: Final = (
    Alteration("time_skew", "N1_pct", "skew_s", 0.08),
    Alteration("driver_gain", DRIVER, "gain_pct", 2.5),
    Alteration("sensor_lag", "EGT_C", "tau_s", 0.8),
    Alteration("sensor_bias", "N2_pct", "bias", 0.65),
    Alteration("throttle_delay", DRIVER, "delay_s", -0.07),
    Alteration("sensor_drift", "EGT_C", "rate_per_h", 25.0),
    Alteration("time_skew", "N2_pct", "skew_s", 0.11),
    Alteration("sensor_bias", "EGT_C", "bias", 37.0),
    # A gain acts as a bias of its mean: 0.65 % of 85 % N2, 37 of 600 degC.
    Alteration("sensor_gain", "N2_pct", "gain_pct", 0.8),
    Alteration("sensor_gain", "EGT_C", "gain_pct", 6.0),
)
_SIGNED: Final = ("sensor_bias", "sensor_drift", "sensor_gain", "driver_gain")


class Altered(NamedTuple):
    """What to make of one flight: alterations with their sizes, none for a null."""

    file: Path
    parts: tuple[tuple[Alteration, float], ...]
    times: float  # the nameable size

    def row(self) -> dict[str, Any]:
        effects = [
            {
                "id": each.id,
                "channel": None if each.channel == DRIVER else each.channel,
                "parameters": {each.parameter: size},
            }
            for each, size in self.parts
        ]
        return {
            "kind": ("null", "single", "pair")[len(self.parts)],
            "style": "altered",
            "engine": "real",
            "effects": effects,
            "outside": None,
            "base": {"differs": True},
            "flight": self.file.name,
            "times_nameable": self.times if self.parts else 0.0,
        }


def draw_altered(
    count: int, files: Sequence[Path], offered: Sequence[Alteration], random: np.random.Generator
) -> list[Altered]:
    """Draw `count` cases in any order: each flight once as a null, one in four a pair."""
    nulls = min(count // _NULLS, len(files))
    found = [Altered(file, (), 0.0) for file in files[:nulls]]
    for n in range(count - nulls):
        turn = n // len(offered)
        wanted, times = [offered[n % len(offered)]], SIZES[turn % len(SIZES)]
        if n % _PAIRS == _PAIRS - 1:
            others = [each for each in offered if each.channel != wanted[0].channel]
            wanted.append(others[int(random.integers(len(others)))])
            times = SIZES[0]
        signs = [float(random.choice((-1.0, 1.0))) if e.id in _SIGNED else 1.0 for e in wanted]
        parts = ((e, sign * times * e.nameable) for e, sign in zip(wanted, signs, strict=True))
        found.append(Altered(files[(n + turn) % len(files)], tuple(parts), times))
    return [found[k] for k in random.permutation(count).tolist()]


def make_altered(folder: Path, plan: BlindPlan, logs: LogsConfig, base: Path) -> Iterator[Made]:
    """Make the cases of a plan from recorded flights, one after the other.

    `logs` says which columns are which channels; its folder is relative to `base`. Raises
    `DataError` for what cannot be read and `ConfigError` where no fault can be put on.
    """
    files = logs.resolve(base)
    random = drawn(plan, 6)
    sources = logs.sources(tuple(_rows(files[0])[0]))
    driver = next((name for name in ("TRA_deg", "FF_kgph") if name in sources), None)
    if driver is None:
        raise ConfigError("the logs have neither TRA_deg nor FF_kgph: nothing drives the engine")
    offered = [each for each in ALTERATIONS if each.channel in (*sources, DRIVER)]
    for number, case in enumerate(draw_altered(plan.cases, files, offered, random), start=1):
        name = case_name(plan, number)
        log = f"real/{case.file.name.removesuffix('.gz')}.gz"
        digest = write_log(folder / name / log, alter(case, logs, driver))
        yield Made(name, case.row(), {log: digest})


def alter(case: Altered, logs: LogsConfig, driver: str) -> str:
    """Text of the flight's file with its alterations; cells of other columns stay as they are."""
    rows = _rows(case.file)
    header = rows[0]
    sources = logs.sources(tuple(header))
    time_s = _numbers(rows, header.index(logs.time_column))
    # A row of units below the header, or a clock that is no number, has no place in this.
    first = int(np.argmax(np.isfinite(time_s)))
    if not np.isfinite(time_s[first:]).all() or len(time_s) - first < 2:
        raise DataError("the time stamps are no numbers", file=case.file)
    for each, size in case.parts:
        source = sources[driver if each.channel == DRIVER else each.channel]
        own = size
        if each.id in ("sensor_bias", "sensor_drift"):
            unit = find_unit(source.unit or channel(each.channel).unit, each.channel)
            own = size / (unit.scale * source.scale)
        for prefix in logs.engines.values() or ("",):
            column = header.index(source.column.replace(ENGINE, prefix))
            values = _numbers(rows, column)[first:]
            changed = each.applied(values, time_s[first:], own)
            for row, value in zip(rows[1 + first :], changed.tolist(), strict=True):
                if np.isfinite(value):
                    row[column] = f"{value:.8g}"
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(rows)
    return text.getvalue()


def _rows(file: Path) -> list[list[str]]:
    with open_text(file) as text:
        return list(csv.reader(text))


def _numbers(rows: Sequence[Sequence[str]], column: int) -> FloatArray:
    cells = pd.Series([row[column] for row in rows[1:]])
    return pd.to_numeric(cells, errors="coerce").to_numpy(np.float64)
