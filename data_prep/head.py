"""What stands above the first row of data: a recorder's own lines, the header, a row of units."""

from __future__ import annotations

import csv
import re
from dataclasses import dataclass
from typing import TYPE_CHECKING

from data_prep.clock import is_clock
from data_prep.units import is_unit_text

if TYPE_CHECKING:
    from collections.abc import Sequence
    from typing import TextIO

DELIMITERS = (";", "\t", "|", ",")
MAX_LINE_CHARS = 1_000_000
_LINES_ABOVE = 100  # a header is looked for so far down
_SEPARATOR_MARK = re.compile(r'"?sep=.?"?', re.IGNORECASE)  # Excel's own, says nothing of the data
_NUMBER = re.compile(r"[+-]?(\d+[.,]?\d*|[.,]\d+)([eE][+-]?\d+)?")


@dataclass(frozen=True)
class Head:
    """`lines` of the file come before the first row of data; `above` of them above the header.

    Blank lines and comments count in `lines` alone. `units` `(columns,)` are the cells of a row of
    units below the header, empty where there is none.
    """

    lines: int
    above: int = 0
    units: tuple[str, ...] = ()


def first_lines(text: TextIO, count: int) -> list[str]:
    """Up to `count` lines and the lines above them, each with its end."""
    lines = (text.readline(MAX_LINE_CHARS) for _ in range(count + _LINES_ABOVE))
    return [line for line in lines if line]


def skip(text: TextIO, lines: int) -> None:
    """Go on to the first row of data."""
    for _ in range(lines):
        text.readline(MAX_LINE_CHARS)


def header_at(lines: Sequence[str], comment: str, time: str) -> tuple[int, int] | None:
    """Index of the header, and how many lines with content stand above it; None without content.

    It is the first line that has a cell `time`, else the first one with content: a recorder may
    put its serial number and the like first.
    """
    held = [k for k, line in enumerate(lines[:_LINES_ABOVE]) if has_content(line, comment)]
    for above, k in enumerate(held):
        if any(time in fields(lines[k], each) for each in (*DELIMITERS, " ")):
            return k, above
    return (held[0], 0) if held else None


def has_content(line: str, comment: str) -> bool:
    """Whether a line is neither blank nor a comment, nor Excel's note on the delimiter."""
    plain = line.strip()
    noted = bool(comment) and plain.startswith(comment)
    return bool(plain) and not noted and not _SEPARATOR_MARK.fullmatch(plain)


def units_row(cells: Sequence[str], header: Sequence[str]) -> tuple[str, ...]:
    """The cells `(columns,)` of a row of units; empty for any other row.

    No cell of it is a number or a clock time, and half of those that are not blank are units.
    """
    told = [cell for cell in cells if cell]
    if not told or any(_NUMBER.fullmatch(cell) or is_clock(cell) for cell in told):
        return ()
    if 2 * sum(map(is_unit_text, told)) < len(told):
        return ()
    return (*cells, *[""] * len(header))[: len(header)]


def fields(line: str, delimiter: str) -> tuple[str, ...]:
    """Cells of a line, without blanks round them; delimiter ` ` means any run of blanks."""
    line = line.replace("\0", "").rstrip("\r\n")
    if delimiter == " ":
        return tuple(line.split())
    try:
        found = next(csv.reader([line], delimiter=delimiter, skipinitialspace=True), [])
    except csv.Error:
        found = line.split(delimiter)
    return tuple(cell.strip() for cell in found)
