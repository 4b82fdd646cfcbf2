"""The first sheet of a workbook as text, so that it is read as a CSV file is (extra `excel`)."""

from __future__ import annotations

import csv
import io
from datetime import date, datetime, time, timedelta
from pathlib import Path

from narxcal.support.errors import ConfigError, DataError

# Of .xlsx, .xlsb and .ods (archives) and of .xls.
_MAGIC = (b"PK\x03\x04", b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1")
MAGIC_BYTES = max(map(len, _MAGIC))


def is_workbook(magic: bytes) -> bool:
    """Whether a file that begins so may be a workbook."""
    return magic.startswith(_MAGIC)


def sheet_text(path: Path) -> io.StringIO:
    """Return the first sheet with one row to a line, cells separated by tabs.

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
    try:
        book = calamine.CalamineWorkbook.from_path(path)
        rows = book.get_sheet_by_index(0).to_python(skip_empty_area=False)
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


def _cell(value: object) -> str:
    if isinstance(value, bool):
        return str(int(value))
    if isinstance(value, datetime | date | time):
        return value.isoformat()
    if isinstance(value, timedelta):
        return repr(value.total_seconds())
    return repr(value) if isinstance(value, float) else str(value)
