"""Logs and cells as the text of CSV files."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np
from numpy.typing import ArrayLike

TIME_FORMAT = "%.15g"
_BLOCK_ROWS = 1000  # of a table in text: within a processor's cache
# A spreadsheet takes a cell that begins with one of these for a formula.
_FORMULA = ("=", "+", "-", "@", "\t", "\r")


def log_csv(channels: Mapping[str, ArrayLike], digits: int = 9) -> str:
    """Format a log as CSV: a header of the channel names, one row per sample, NaN as nothing.

    `time_s` has 15 significant digits, other channels `digits`.
    """
    return "".join(csv_blocks(channels, digits))


def csv_blocks(channels: Mapping[str, ArrayLike], digits: int = 9) -> Iterator[str]:
    """Yield the text of `log_csv` in blocks, so that no more than one takes memory."""
    yield ",".join(channels) + "\n"
    number = f"%.{digits}g"
    form = ",".join(TIME_FORMAT if name == "time_s" else number for name in channels) + "\n"
    columns = [np.asarray(values, float) for values in channels.values()]
    for start in range(0, len(columns[0]), _BLOCK_ROWS):
        table = np.column_stack([values[start : start + _BLOCK_ROWS] for values in columns])
        # 0.0 is added, so that no -0 is printed.
        rows = (table + 0.0).ravel().tolist()
        yield (form * len(table) % tuple(rows)).replace("nan", "")


def text_cell(text: str) -> str:
    """Keep a spreadsheet from running a name in a CSV cell as a formula: prefix it with `'`."""
    return f"'{text}" if text.startswith(_FORMULA) else text
