"""Time stamps as recorders print them: clock times and ISO 8601 dates, as seconds.

A clock time `12:34:56.7`, with the day of the year before it where there is one
(`123:12:34:56.7`) or `AM` or `PM` behind it, counts from midnight of day 0; one of minutes and
seconds alone is told by its decimals (`34:56.7`); a date, `2026-03-01T12:34:56.7`, from 1970, in
UTC where it names no zone.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

if TYPE_CHECKING:
    from data_prep.log import FloatArray

_CLOCK = r"\s*(?:(\d{1,3}):)?(\d{1,2}):(\d{2}):(\d{2}(?:[.,]\d*)?)\s*(?:([AaPp])\.?[Mm]\.?)?\s*"
_MINUTES = r"\s*(\d{1,3}):(\d{2}[.,]\d+)\s*"
_DATE = r"\s*\d{4}-\d{2}-\d{2}[T ]\d{2}:\d{2}.*"
_UNIT_S = np.array([86400.0, 3600.0, 60.0, 1.0])
_HALF_DAY = 12.0  # hours: 12 AM is midnight, and 12 PM is noon


def is_clock(text: str) -> bool:
    """Whether `text` is a clock time or a date rather than a number."""
    return re.fullmatch(f"{_CLOCK}|{_MINUTES}|{_DATE}", text) is not None


def lacks_hours(text: str) -> bool:
    """Whether `text` is a clock time of minutes and seconds alone, which starts anew each hour."""
    return re.fullmatch(_MINUTES, text) is not None


def clock_seconds(texts: pd.Series[Any]) -> FloatArray:
    """Seconds `(rows,)`; NaN for a blank, and for what is neither a clock time nor a date."""
    plain = texts.astype("str").where(texts.notna(), "").str.replace(",", ".")
    seconds = _of_clock(plain.str.extract(f"^{_CLOCK}$"))
    short = plain.str.extract(f"^{_MINUTES}$").astype(np.float64).to_numpy() @ _UNIT_S[2:]
    seconds = np.where(np.isnan(seconds), short, seconds)
    dates = plain[np.isnan(seconds) & plain.str.fullmatch(_DATE).to_numpy(dtype=np.bool_)]
    if len(dates):
        stamps = pd.to_datetime(dates, format="ISO8601", utc=True, errors="coerce")
        since = (stamps - pd.Timestamp(0, tz="UTC")) / pd.Timedelta(1, "s")
        seconds[plain.index.get_indexer(dates.index)] = since.to_numpy(dtype=np.float64)
    return seconds


def _of_clock(found: pd.DataFrame) -> FloatArray:
    """Seconds of day, hours, minutes, seconds and half of the day `(rows, 5)`, each as text."""
    parts = found.iloc[:, :4].astype(np.float64).to_numpy()
    parts[:, 0] = np.nan_to_num(parts[:, 0])  # a day is not always told
    half = found[4].str.upper()
    told, hours = half.notna().to_numpy(), parts[:, 1]
    of_twelve = np.where((hours >= 1.0) & (hours <= _HALF_DAY), hours % _HALF_DAY, np.nan)
    parts[:, 1] = np.where(told, of_twelve + _HALF_DAY * (half == "P").to_numpy(), hours)
    return np.asarray(parts @ _UNIT_S, dtype=np.float64)
