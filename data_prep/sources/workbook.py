"""The sheet of most rows of a workbook as text, read as a CSV file is (extra `excel`)."""

from __future__ import annotations

import csv
import io
import re
import zipfile
import zlib
from datetime import date, datetime, time, timedelta
from pathlib import Path
from typing import IO, Final

from narxcal.support.errors import ConfigError, DataError

# Of .xlsx, .xlsb and .ods (archives) and of .xls.
_MAGIC = (b"PK\x03\x04", b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1")
MAGIC_BYTES = max(map(len, _MAGIC))
# The place of a cell or row of .xlsx: `<c s="1" r="XFD1048576">`.
_PLACE: Final = re.compile(rb"""<(?:\w+:)?(?:c|row)\s[^>]*?\br=["']([A-Za-z]{0,7})(\d{1,15})["']""")
_BLOCK: Final = 1 << 20
_SPARSE, _FEW_CELLS = 100, 10_000_000  # spanned by a cell, and by few: 240 MB


def is_workbook(magic: bytes) -> bool:
    """Whether a file that begins so may be a workbook."""
    return magic.startswith(_MAGIC)


def sheet_text(path: Path) -> io.StringIO:
    """Return the first of the sheets with most rows, a row to a line, cells separated by tabs.

    Numbers have all their digits, dates and times are ISO 8601 and durations seconds. Raises
    `ConfigError` without the extra, `DataError` for an archive that is no workbook.
    """
    try:
        import python_calamine as calamine  # noqa: PLC0415 - an extra, needed for workbooks only
    except ImportError:
        raise ConfigError(
            "workbooks of Excel need python-calamine",
            file=path,
            hint="Install it with: pip install 'narxcal[excel]', or save the sheet as CSV",
        ) from None
    _check_bounds(path)
    try:
        book = calamine.CalamineWorkbook.from_path(path)
        sheets = [book.get_sheet_by_index(k) for k in range(len(book.sheet_names))]
        rows = max(sheets, key=lambda sheet: sheet.height).to_python(skip_empty_area=False)
    except (calamine.CalamineError, OSError, ValueError, IndexError) as error:
        raise DataError(
            "the file is an archive and no workbook that can be read", file=path,
            hint="Save the sheet as CSV",
        ) from error  # fmt: skip
    text = io.StringIO()
    lines = csv.writer(text, delimiter="\t", lineterminator="\n")
    lines.writerows([[_cell(value) for value in row] for row in rows])
    text.seek(0)
    return text


def _check_bounds(path: Path) -> None:
    """Raise `DataError` for a sheet of .xlsx that spans far more cells than it holds.

    calamine makes all cells between the first and the last one, and ends the process where the
    memory does not suffice.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            for part in archive.infolist():
                with archive.open(part) as raw:
                    cells, rows, columns = _bounds(raw)
                if rows * columns > max(_SPARSE * cells, _FEW_CELLS):
                    raise DataError(
                        f"{cells} cells span {rows} rows and {columns} columns", file=path,
                        hint="Delete the cells that stand far from the table, or save it as CSV",
                    )  # fmt: skip
    except (zipfile.BadZipFile, zlib.error, EOFError, OSError, ValueError, RuntimeError):
        return  # no archive of .xlsx: calamine says what it is


def _bounds(raw: IO[bytes]) -> tuple[int, int, int]:
    """Cells of a sheet with the last row and column that one names; 0 of any other part."""
    cells = rows = columns = 0
    rest = b""
    while block := raw.read(_BLOCK):
        whole, mark, rest = (rest + block).rpartition(b"<")
        rest = (mark + rest)[-_BLOCK:]
        for letters, row in _PLACE.findall(whole):
            cells += bool(letters)
            rows = max(rows, int(row))
            columns = max(columns, _column(letters))
    return cells, rows, columns


def _column(letters: bytes) -> int:
    number = 0
    for letter in letters.upper():
        number = 26 * number + letter - ord("@")
    return number


def _cell(value: object) -> str:
    if isinstance(value, bool):
        return str(int(value))
    if isinstance(value, datetime | date | time):
        return value.isoformat()
    if isinstance(value, timedelta):
        return repr(value.total_seconds())
    return repr(value) if isinstance(value, float) else str(value)
