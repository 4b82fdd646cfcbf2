"""Cells of the tables of a diagnosis: shares in percent, counts, seconds and intervals."""

from __future__ import annotations

import math
from collections.abc import Mapping

from eval.report.tables import NOTHING, Cell, Mark


def percent(share: float | None, mark: Mark = "") -> Cell:
    """A share as a number in percent; whole, but for small ones."""
    if share is None or not math.isfinite(share):
        return Cell(NOTHING, mark, number=True)
    digits = 1 if 0.0005 <= abs(share) < 0.0995 else 0
    return Cell(whole(100 * share, digits), mark, number=True)


def count(number_of: int) -> Cell:
    """A count."""
    return Cell(f"{number_of:,}".replace(",", "\N{NO-BREAK SPACE}"), number=True)


def seconds(value: float | None, mark: Mark = "") -> Cell:
    """A time to the millisecond."""
    if value is None or not math.isfinite(value):
        return Cell(NOTHING, mark, number=True)
    return Cell(whole(value, 3), mark, number=True)


def whole(value: float, digits: int = 0) -> str:
    """A rounded number; what rounds to nothing has no sign."""
    return f"{round(value, digits) + 0.0:.{digits}f}"


def span(row: Mapping[str, float | None]) -> str:
    """Ends of an interval in percent."""
    low, high = row["low"], row["high"]
    if low is None or high is None or not (math.isfinite(low) and math.isfinite(high)):
        return NOTHING
    small = max(abs(low), abs(high)) < 0.0995
    return " to ".join(
        whole(100 * each, 1 if small and abs(each) >= 0.0005 else 0) for each in (low, high)
    )


def printed(name: str) -> str:
    """Unit as it is printed: `degC` -> `°C`."""
    return "" if name == "-" else name.replace("degC", "°C").replace("deg", "°")
