"""Times of a log for people: elapsed since it began and, where its stamps are dates, UTC.

Files keep seconds of the log's own clock: since 1970-01-01 UTC where its stamps are dates.
"""

from __future__ import annotations

import numpy as np

# No recorder counts the seconds of three years: what is later counts from 1970.
_DATED_S = 1e8


def elapsed(seconds: float, decimals: int = 1) -> str:
    """Minutes and seconds, and hours where there are any: `12:34.7`, `1:02:03.4`."""
    units = round(abs(seconds) * 10**decimals)
    whole, part = divmod(units, 10**decimals)
    minutes, rest = divmod(whole, 60)
    hours, minutes = divmod(minutes, 60)
    text = f"{hours}:{minutes:02d}:{rest:02d}" if hours else f"{minutes}:{rest:02d}"
    sign = "-" if seconds < 0.0 and units else ""
    return sign + text + (f".{part:0{decimals}d}" if decimals else "")


def dated(time_s: float) -> bool:
    """Whether a time counts from 1970, as those of stamps with dates do."""
    return time_s >= _DATED_S


def stamp(time_s: float) -> str:
    """A time on the log's own clock: `2024-08-17 01:53:00 UTC`, or `105 s` without dates."""
    if not dated(time_s):
        return f"{time_s:.10g} s"
    seconds, thousandths = divmod(round(1000.0 * time_s), 1000)
    part = f".{thousandths:03d}".rstrip("0") if thousandths else ""
    return f"{_date(seconds)}{part} UTC"


def moment(
    time_s: float, origin_s: float, until_s: float | None = None, *, decimals: int = 1
) -> str:
    """A time of a log that began at `origin_s`, or a stretch of time, on the log's own clock.

    `t+12:34.7`, `t+12:34.7 to t+13:00.2`; with dates the date and clock in brackets, too.
    """
    ends = [time_s] if until_s is None else [time_s, until_s]
    texts = [elapsed(each - origin_s, decimals) for each in ends]
    found = " to ".join(text if text.startswith("-") else f"t+{text}" for text in texts)
    if not dated(origin_s):
        return found
    dates = [_date(each) for each in ends]
    if until_s is not None and dates[0][:10] == dates[1][:10]:
        dates[1] = dates[1][11:]
    return f"{found} ({' to '.join(dates)} UTC)"


def _date(time_s: float) -> str:
    return str(np.datetime64(int(time_s), "s")).replace("T", " ")
