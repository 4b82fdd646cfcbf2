"""Clock times and dates as text, read as seconds.

| written | meaning |
|---|---|
| `12:34:56.7`, `1:02:03 PM` | since midnight of day 0 |
| `123:12:34:56.7` | the same, after the day of the year |
| `34:56.7` | minutes and seconds alone: starts anew each hour |
| `10:46:39:05` | hours, minutes, seconds and frames, where `frames_hz` says how many a second has |
| `2026-03-01T12:34:56.7Z` | since 1970, in UTC where it names no zone |
| `1 Mar 2026 12:34`, `01.03.2026 12:34`, `3/1/2026 1:02:03 PM` | the same |
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Literal

import numpy as np
import pandas as pd

from narxcal.support.arrays import FloatArray
from narxcal.support.errors import DataError

Order = Literal["auto", "DMY", "MDY", "YMD"]

# Hours of a time since the start may be more than 24, those after a day may not.
_CLOCK = (
    r"\s*(?:(\d{1,3}):(?=(?:[01]?\d|2[0-4]):))?(\d{1,2}):([0-5]\d):((?:[0-5]\d|60)(?:[.,]\d*)?)"
    r"\s*(?:([AaPp])\.?[Mm]\.?)?\s*"
)
_MINUTES = r"\s*(\d{1,3}):([0-5]\d[.,]\d+)\s*"
_FRAMES = r"\s*(\d{1,3}):(\d{2}):(\d{2})[:;](\d{2})\s*"
_ISO = r"\s*\d{4}-\d{2}-\d{2}[T ]\d{2}:\d{2}.*"
_MONTH = r"[A-Za-z]{3,9}"
_DATE = (
    rf"\s*(\d{{1,4}}|{_MONTH})\s?([-/. ])\s?(\d{{1,2}}|{_MONTH})[-/. ,]\s?(\d{{1,4}})[T ,]+"
    r"(\d{1,2}):([0-5]\d)(?::([0-5]\d(?:[.,]\d*)?))?\s*(?:([AaPp])\.?[Mm]\.?)?\s*(?:Z|UTC|GMT)?\s*"
)
_UNIT_S = np.array([86400.0, 3600.0, 60.0, 1.0])
_HALF_DAY = 12.0  # hours: 12 AM is midnight, and 12 PM is noon
_THIS_CENTURY = 70  # years of two digits before it are of this century, as in POSIX
_MONTHS = ("jan", "feb", "mar", "apr", "may", "jun", "jul", "aug", "sep", "oct", "nov", "dec")


@dataclass(frozen=True)
class Clock:
    """How the stamps of a file are written.

    `order` is that of day, month and year where all three are numbers and the year is not first.
    With `frames_hz` the last part of `HH:MM:SS:FF` counts frames. `hourly`: hours are not shown.
    """

    order: Order = "auto"
    frames_hz: float | None = None
    hourly: bool = False

    def seconds(self, texts: pd.Series[Any]) -> FloatArray:
        """Convert texts to seconds `(rows,)`; NaN for a blank and for no clock time or date."""
        plain = texts.astype("str").where(texts.notna(), "")
        if self.frames_hz:
            return self._of_frames(plain)
        seconds = _of_clock(plain.str.replace(",", ".").str.extract(f"^{_CLOCK}$"))
        short = plain.str.replace(",", ".").str.extract(f"^{_MINUTES}$")
        seconds = np.where(
            np.isnan(seconds), short.astype(np.float64).to_numpy() @ _UNIT_S[2:], seconds
        )
        for pattern, convert in ((_ISO, _of_iso), (_DATE, self._of_dates)):
            dates = plain[np.isnan(seconds) & plain.str.fullmatch(pattern).to_numpy(dtype=np.bool_)]
            if len(dates):
                seconds[plain.index.get_indexer(dates.index)] = convert(dates)
        return seconds

    def _of_frames(self, plain: pd.Series[Any]) -> FloatArray:
        parts = plain.str.extract(f"^{_FRAMES}$").astype(np.float64).to_numpy()
        rate = self.frames_hz or 1.0
        seconds = parts[:, :3] @ _UNIT_S[1:] + parts[:, 3] / rate
        return np.asarray(np.where(parts[:, 3] < rate, seconds, np.nan))

    def _of_dates(self, plain: pd.Series[Any]) -> FloatArray:
        found = plain.str.extract(f"^{_DATE}$")
        day_s = 86400.0 * _days(found[[0, 1, 2, 3]].drop_duplicates(), self.order).reindex(
            pd.MultiIndex.from_frame(found[[0, 1, 2, 3]])
        ).to_numpy(dtype=np.float64)
        clock = pd.DataFrame(
            {0: "0", 1: found[4], 2: found[5], 3: found[6].fillna("0").str.replace(",", "."),
             4: found[7]}
        )  # fmt: skip
        return np.asarray(day_s + _of_clock(clock))


def is_clock(text: str) -> bool:
    """Whether `text` is a clock time or a date rather than a number."""
    return re.fullmatch(f"{_CLOCK}|{_MINUTES}|{_ISO}|{_DATE}", text) is not None


def clock_of(texts: Sequence[str], order: Order, frames_hz: float | None) -> Clock | None:
    """Find how stamps are written from the first ones; None where the first is a number.

    Raises `DataError` where they count frames of a second and no rate of these is given.
    """
    if _counts_frames(texts) and not frames_hz:
        raise DataError(
            f"stamps like {texts[0]!r} count frames of a second",
            hint="Set [logs] frames_hz to the number of frames that a second has",
        )
    if not texts or not (is_clock(texts[0]) or re.fullmatch(_FRAMES, texts[0])):
        return None
    hourly = re.fullmatch(_MINUTES, texts[0]) is not None
    return Clock(order, frames_hz, hourly)


def is_ambiguous(text: str) -> bool:
    """Whether a date may begin with the day or with the month: `03/04/2026 12:00`."""
    found = re.fullmatch(_DATE, text)
    if not found or not all(found[k].isdigit() for k in (1, 3, 4)):
        return False
    return len(found[1]) < 4 and found[2] != "."


def order_of(texts: Iterable[str]) -> Order:
    """Find whether dates begin with the day or the month, from all stamps of a file.

    A number above 12 is a day, one above 31 a year; else dates that follow each other day by day
    settle it. Raises `DataError` where neither does.
    """
    dates: dict[tuple[int, int, int], None] = {}
    example = ""
    for text in texts:
        if found := re.fullmatch(_DATE, text):
            example = example or text
            dates[int(found[1]), int(found[3]), int(found[4])] = None
    first, second = max(date[0] for date in dates), max(date[1] for date in dates)
    if first > 31:
        return "YMD"
    known: tuple[tuple[Order, int], ...] = (("DMY", second), ("MDY", first))
    possible = [order for order, month in known if month <= 12]
    if len(possible) > 1 and len(dates) > 1:
        possible = [order for order in possible if _follow(list(dates), order)] or possible
    if len(possible) == 1:
        return possible[0]
    raise DataError(
        f"dates like {example!r} may begin with the day or with the month",
        hint='Set [logs] dates = "DMY" or "MDY"',
    )


def _follow(dates: Sequence[tuple[int, int, int]], order: Order) -> bool:
    """Whether each date is the day after the one before."""
    texts = pd.DataFrame([(str(a), "/", str(b), str(c)) for a, b, c in dates])
    days = _days(texts, order).to_numpy(dtype=np.float64)
    return bool((np.diff(days) == 1.0).all())


def _days(dates: pd.DataFrame, order: Order) -> pd.Series[Any]:
    """Days since 1970 of the parts of dates `(dates, 4)`, by these parts; NaN for no date."""
    days = [_day(str(a), str(mark), str(b), str(c), order) for a, mark, b, c in dates.to_numpy()]
    index = pd.MultiIndex.from_frame(dates)
    return pd.Series(days, index=index, dtype=np.float64)


def _day(a: str, mark: str, b: str, c: str, order: Order) -> float:
    if b.isalpha():
        year, month, day = (a, b, c) if len(a) > 2 else (c, b, a)
    elif a.isalpha() or (order == "MDY" and mark != "." and len(a) <= 2):
        year, month, day = c, a, b
    elif len(a) > 2 or order == "YMD":
        year, month, day = a, b, c
    else:
        year, month, day = c, b, a
    if month.isalpha():
        month = str(next((k for k, name in enumerate(_MONTHS, 1) if month[:3].lower() == name), 0))
    full = int(year) + (0 if len(year) > 2 else 2000 if int(year) < _THIS_CENTURY else 1900)
    try:
        date = np.datetime64(f"{full:04d}-{int(month):02d}-{int(day):02d}", "D")
    except ValueError:
        return np.nan
    return float(date.astype(np.int64))


def _of_iso(dates: pd.Series[Any]) -> FloatArray:
    plain = dates.str.replace(",", ".")
    stamps = pd.to_datetime(plain, format="ISO8601", utc=True, errors="coerce")
    since = (stamps - pd.Timestamp(0, tz="UTC")) / pd.Timedelta(1, "s")
    return np.asarray(since.to_numpy(dtype=np.float64))


def _counts_frames(texts: Iterable[str]) -> bool:
    """Whether the last part of stamps `10:46:39:05` counts frames of a second, not seconds.

    It starts anew before it has reached 60, or the parts before it are no hours and minutes.
    """
    found = [re.fullmatch(_FRAMES, text) for text in texts]
    stamps = [tuple(map(int, one.groups())) for one in found if one]
    if any(hours > 24 for _, hours, _, _ in stamps):
        return True
    steps = [b[3] - a[3] for a, b in pairwise(stamps) if b[:3] == a[:3]]
    usual = max(steps, default=60)
    return any(
        b[2] == (a[2] + 1) % 60 and b[3] < a[3] and a[3] + usual < 60 for a, b in pairwise(stamps)
    )


def _of_clock(found: pd.DataFrame) -> FloatArray:
    """Convert day, hours, minutes, seconds and half of the day `(rows, 5)`, as text, to seconds."""
    parts = found.iloc[:, :4].astype(np.float64).to_numpy()
    parts[:, 0] = np.nan_to_num(parts[:, 0])  # the day may be missing
    half = found[4].str.upper()
    halves, hours = half.notna().to_numpy(), parts[:, 1]
    of_twelve = np.where((hours >= 1.0) & (hours <= _HALF_DAY), hours % _HALF_DAY, np.nan)
    parts[:, 1] = np.where(halves, of_twelve + _HALF_DAY * (half == "P").to_numpy(), hours)
    return np.asarray(parts @ _UNIT_S, dtype=np.float64)
