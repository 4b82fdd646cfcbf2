"""How a text file of a recorder or a worksheet is written.

Compression, encoding, delimiter, decimal mark, and the lines above the first row of data: a
recorder's own lines, the header, a row of units.
"""

from __future__ import annotations

import codecs
import csv
import gzip
import io
import re
import zlib
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain, islice
from pathlib import Path
from typing import BinaryIO, TextIO, cast

from data_prep.cleaning.words import is_no_value
from data_prep.config import LogsConfig
from data_prep.drafting.naming import read_name
from data_prep.sources.clock import Clock, clock_of, is_ambiguous, is_clock, order_of
from data_prep.sources.units import is_no_unit, is_unit_text
from data_prep.sources.workbook import MAGIC_BYTES as WORKBOOK_BYTES
from data_prep.sources.workbook import is_workbook, sheet_text
from narxcal.support.errors import DataError

DELIMITERS = (";", "\t", "|", ",")
MAX_LINE_CHARS = 1_000_000
_LINES_ABOVE = 100  # a header is looked for so far down
_ROWS_BELOW = 20  # at the end of the first lines, with which a header has to agree
_SEPARATOR_MARK = re.compile(r'"?sep=.?"?', re.IGNORECASE)  # Excel's own line, no data
_NUMBER = re.compile(r"[+-]?(\d+[.,]?\d*|[.,]\d+)([eE][+-]?\d+)?")
_NUMBERS_PART = 0.3  # of the cells with content; a log of notes and numbers has more
_MOST_BELOW = 5  # rows between the header and the data that are looked through
_MOST_QUOTED = 50  # lines of a quoted cell; a quote that is never closed must not take the file
_OPEN_QUOTE = re.compile(r'(?:^|[;,|\t ])\s*"[^"]*$')
_BRACKETED = re.compile(r"[\[({<].*[\])}>]")
_FEWEST_UNITS = 2  # of a row above the header
SAMPLE_LINES = 200
READERS = (
    "CSV, plain or gzipped, and MATLAB of version 5; with an extra (pip install 'narxcal[EXTRA]') "
    "Parquet [parquet], HDF5 and MATLAB 7.3 [hdf5], Excel [excel], MDF 4 [mdf]"
)
_HEAD_BYTES = 65_536
_GZIP_MAGIC = b"\x1f\x8b"
_BOMS = (
    (codecs.BOM_UTF8, "utf-8-sig"),
    (codecs.BOM_UTF32_LE, "utf-32"),
    (codecs.BOM_UTF32_BE, "utf-32"),
    (codecs.BOM_UTF16_LE, "utf-16"),
    (codecs.BOM_UTF16_BE, "utf-16"),
)
# What no text in a code page of one byte holds, and other files begin with.
_CONTROL = re.compile(rb"[\x00-\x08\x0e-\x1f]")
_GROUPED = re.compile(r'"?\s*[+-]?[1-9]\d{0,2},\d{3}\s*"?')
COMMA_NUMBER = re.compile(r'"?\s*[+-]?\d*,\d+([eE][+-]?\d+)?\s*"?')
_POINT_NUMBER = re.compile(r'"?\s*[+-]?\d*\.\d+([eE][+-]?\d+)?\s*"?')


@dataclass(frozen=True)
class Head:
    """`lines` of the file come before the first row of data; `above` of them above the header.

    Blank lines and comments count in `lines` alone. `units` `(columns,)` are the cells of a row of
    units below the header or above it, empty where there is none; `below` counts further rows
    below the header: types, codes. `repeated` are the lines that may occur again, without blanks.
    """

    lines: int
    above: int = 0
    units: tuple[str, ...] = ()
    below: int = 0
    repeated: frozenset[str] = frozenset()


def read_row(text: TextIO, *, blank: bool = True) -> str:
    """Read a row with its end: a line, or several where a quoted cell holds their ends (RFC 4180).

    `blank` and errors as in `read_line`.
    """
    row = read_line(text, blank=blank)
    if '"' not in row or not row.count('"') % 2 or not _OPEN_QUOTE.search(row.rstrip("\r\n")):
        return row
    after, first = text.tell(), row
    for _ in range(_MOST_QUOTED):
        row += read_line(text)
        if not row.count('"') % 2:
            return row
    text.seek(after)
    return first


def read_line(text: TextIO, *, blank: bool = True) -> str:
    """Read a line with its end; empty at the end of the file. Unless `blank`, skip empty lines.

    Raises `DataError` for one that is longer than any row of a log, so that memory stays bounded.
    """
    line = text.readline(MAX_LINE_CHARS)
    while line == "\n" and not blank:
        line = text.readline(MAX_LINE_CHARS)
    if len(line) == MAX_LINE_CHARS and not line.endswith("\n"):
        raise DataError(
            f"a line is longer than {MAX_LINE_CHARS:,} characters",
            hint="Expected a CSV file with one row of samples in each line",
        )
    return line


def header_at(lines: Sequence[str], comment: str, time: str) -> tuple[int, str]:
    """Find the header and what delimits it; raises `DataError` without content.

    It has as many cells as the rows below, of which a good part are numbers: a recorder may put its
    serial number and the like first. Of several such lines it is the first that has a cell `time`,
    else the last of those that name most channels. A comment is taken where no other line is one.
    """
    filled = [k for k, line in enumerate(lines) if has_content(line, comment)]
    if not filled:
        raise DataError("the file is empty", hint="Expected a header line and data rows")
    above = [k for k, line in enumerate(lines[:_LINES_ABOVE]) if has_content(line, "")]
    best: tuple[tuple[int, ...], int, str] = ((0,), filled[0], ",")
    for delimiter in (*DELIMITERS, " "):
        rows = [fields(lines[k], delimiter) for k in filled[-_ROWS_BELOW:]]
        widths = [_widths(cells) for cells in rows if _is_tabular([cells])]
        for k in above:
            cells = fields(lines[k] if k in filled else uncommented(lines[k], comment), delimiter)
            agreeing = sum(bool(_widths(cells) & each) for each in widths)
            agrees = len(cells) > 1 and 2 * agreeing > len(rows)
            own = (k in filled, delimiter != " ")
            if time in cells:
                best = max(best, ((2, agrees, *own, -k), k, delimiter))
            elif agrees and _names_columns(cells):
                named = sum(read_name(each) is not None for each in cells)
                best = max(best, ((1, *own, named, k), k, delimiter))
    return best[1:]


def uncommented(line: str, comment: str) -> str:
    """Return a line without the signs of a comment that begin it."""
    plain = line.lstrip()
    return plain.lstrip(comment) if comment and plain.startswith(comment) else line


def _widths(cells: Sequence[str]) -> set[int]:
    """Return the numbers of cells that a line may be meant to have: a delimiter may end it."""
    return {len(cells), len(cells) - (not cells[-1:] or not cells[-1])}


def _names_columns(cells: Sequence[str]) -> bool:
    """Whether cells may be names of columns: neither numbers nor units, and most of them differ."""
    filled = [cell for cell in cells if cell]
    numbers = sum(map(_is_number, filled))
    return 2 * numbers < len(filled) < 2 * len({*filled}) and not units_row(cells, cells)


def has_content(line: str, comment: str) -> bool:
    """Whether a line is neither blank nor a comment, nor Excel's note on the delimiter."""
    plain = line.strip()
    is_comment = bool(comment) and plain.startswith(comment)
    return bool(plain) and not is_comment and not _SEPARATOR_MARK.fullmatch(plain)


def units_row(cells: Sequence[str], header: Sequence[str]) -> tuple[str, ...]:
    """Return the cells `(columns,)` of a row of units; empty for any other row.

    No cell of it is a number or a clock time, and half of those that are not blank are units, or
    all of them stand in brackets.
    """
    filled = [cell for cell in cells if cell and not is_no_unit(cell)]
    if not filled or any(map(_is_number, filled)):
        return ()
    units = sum(map(is_unit_text, filled))
    if 2 * units < len(filled) and not (units and all(map(_BRACKETED.fullmatch, filled))):
        return ()
    return (*cells, *[""] * len(header))[: len(header)]


def _rows_below(rows: Sequence[Sequence[str]], header: Sequence[str]) -> int:
    """Count the rows between the header and the data: units, types, codes.

    The last of them has no number, and units or a cell for half of the columns. Those between it
    and the header may be numbers: codes.
    """
    found = 0
    for count, cells in enumerate(rows[:_MOST_BELOW], 1):
        filled = [cell for cell in cells if cell and not is_no_value(cell)]
        named = 2 * len(filled) >= len(header)
        if not any(map(_is_number, filled)) and (units_row(cells, header) or (filled and named)):
            found = count
    return found


def _units_above(
    lines: Sequence[str], how: tuple[str, str], header: Sequence[str]
) -> tuple[str, ...]:
    """Return the row of units that is nearest above the header, a comment or not.

    It has as many cells as the header, and two of them are units or in brackets, as all others are:
    a title may be one.
    """
    delimiter, comment = how
    for line in reversed(lines):
        cells = fields(uncommented(line, comment), delimiter)
        found = units_row(cells, header) if len(cells) == len(header) else ()
        filled = [cell for cell in found if cell]
        bracketed = all(map(_BRACKETED.fullmatch, filled))
        if sum(bracketed or is_unit_text(cell) for cell in filled) >= _FEWEST_UNITS:
            return found
    return ()


def _is_number(cell: str) -> bool:
    return _NUMBER.fullmatch(cell) is not None or is_clock(cell)


def fields(line: str, delimiter: str) -> tuple[str, ...]:
    """Split a line into cells without surrounding blanks; delimiter ` ` is any run of blanks."""
    line = line.replace("\0", "").rstrip("\r\n")
    if delimiter == " ":
        return tuple(line.split())
    if '"' not in line and line.split() == [line]:
        return tuple(line.split(delimiter))
    try:
        found = next(csv.reader([line], delimiter=delimiter, skipinitialspace=True), [])
    except csv.Error:
        found = line.split(delimiter)
    return tuple(" ".join(cell.split()) for cell in found)


@dataclass(frozen=True)
class Dialect:
    """How the data rows are parsed; delimiter ` ` means any run of blanks.

    `decimal_open`: no decimal mark was seen yet, so that a comma may still turn up. `time` is the
    column of stamps, `clock` how they are written where they are no numbers. `head` is what stands
    above the rows, `width` the number of fields of a row, and `tabular` whether the rows look like
    those of a log: a good part of their cells are numbers.
    """

    delimiter: str
    decimal: str
    decimal_open: bool
    comment: str
    header: tuple[str, ...]
    time: str = ""
    clock: Clock | None = None
    head: Head = field(default_factory=lambda: Head(lines=1))
    width: int = 0
    tabular: bool = True


def open_text(path: Path) -> TextIO:
    """Open `path` as text; its first bytes decide on gzip, workbook and encoding, not its name.

    Text without a byte order mark is UTF-8, or Windows-1252 (a superset of Latin-1) where it cannot
    be. Bytes that are neither become the replacement character: in a number they are reported as
    text.
    """
    with path.open("rb") as raw:
        magic = raw.read(WORKBOOK_BYTES)
    if is_workbook(magic):
        return sheet_text(path)
    zipped = magic.startswith(_GZIP_MAGIC)
    binary = cast("BinaryIO", gzip.GzipFile(path, "rb") if zipped else path.open("rb"))
    try:
        head = _first_bytes(binary)
    except BaseException:
        binary.close()
        raise
    bom, name = next(((bom, name) for bom, name in _BOMS if head.startswith(bom)), (b"", ""))
    while bom and head.startswith(2 * bom):  # written by one program on top of another's
        head = head[len(bom) :]
        binary.seek(len(bom), io.SEEK_CUR)
    return io.TextIOWrapper(binary, encoding=name or _unmarked(head), errors="replace")


def _first_bytes(binary: BinaryIO) -> bytes:
    """Read some bytes of the beginning, and wind back."""
    try:
        return binary.read(_HEAD_BYTES)
    except (EOFError, zlib.error):  # damaged further down, which the reader reports
        binary.seek(0)
        return binary.read(4)
    finally:
        binary.seek(0)


def _unmarked(head: bytes) -> str:
    """Find the encoding of a text that begins with `head`, which may end within a letter."""
    try:
        codecs.getincrementaldecoder("utf-8")().decode(head)
    except UnicodeDecodeError:
        return "utf-8" if _CONTROL.search(head) else "cp1252"
    return "utf-8"


def sniff(text: TextIO, config: LogsConfig) -> Dialect:
    """Read the header and the first rows; what `config` leaves `auto` is decided from them.

    The column of time may hold clock times or dates instead of numbers, which its first cell
    decides.

    The delimiter is the one of `; TAB | ,` that the header and most rows hold equally often,
    else blanks; the decimal mark is a comma where numbers like `1,5` occur and none like `1.5`.
    Raises `DataError` for a file that is empty, no text or without a header, for numbers like
    `1,250` alone in a file that is separated by commas, for rows that have fewer fields than the
    header has names, and for stamps that can be read in two ways.
    """
    time, comment = config.time_column, config.comment
    lines = [line for _ in range(SAMPLE_LINES + _LINES_ABOVE) if (line := read_row(text))]
    at, delimiter = header_at(lines, comment, time)
    delimiter = delimiter if config.delimiter == "auto" else config.delimiter
    header = uncommented(lines[at].rstrip("\r\n"), comment)
    _refuse_no_text(header, "".join(lines))
    rows = [k for k in range(at + 1, len(lines)) if has_content(lines[k], comment)][:SAMPLE_LINES]
    texts = [lines[k].rstrip("\r\n") for k in rows]
    names = fields(header, delimiter)
    if all(map(_is_number, filter(None, names))):
        raise DataError(
            "the file has no header: its first line holds numbers",
            hint="Write the names of the columns above it",
        )
    cells = [fields(text, delimiter) for text in texts]
    below = _rows_below(cells, names)
    heads = [found for row in cells[:below] if (found := units_row(row, names))]
    units = heads[0] if heads else _units_above(lines[:at], (delimiter, comment), names)
    cells = cells[below:]
    decimal = _decimal(cells, delimiter) if config.decimal == "auto" else config.decimal
    column = names.index(time) if time in names else MAX_LINE_CHARS
    stamps = [row[column] for row in cells if len(row) > column and row[column]]
    further = _cells_below(lines[(rows or [at])[-1] + 1 :], text, delimiter, column)
    return Dialect(
        delimiter=delimiter,
        decimal=decimal or ".",
        decimal_open=not decimal,
        comment=comment,
        header=names,
        time=time,
        clock=_clock(stamps, further, config) if time in names else None,
        head=Head(
            lines=(rows[below - 1] if below else at) + 1,
            above=sum(has_content(line, comment) for line in lines[:at]),
            units=units,
            below=below - bool(heads),
            repeated=frozenset(line.strip() for line in (header, *texts[:below])),
        ),
        width=_width(cells, names),
        tabular=_is_tabular(cells),
    )


def _clock(stamps: Sequence[str], further: Iterator[str], config: LogsConfig) -> Clock | None:
    """Find how stamps are written, from `further` ones where the first do not tell."""
    if not stamps:  # before a receiver has its fix, a recorder leaves them blank
        stamps = [*islice(further, 1)]
    found = clock_of(stamps, config.dates, config.frames_hz)
    if found and found.order == "auto" and is_ambiguous(stamps[0]):
        return replace(found, order=order_of(chain(stamps, further)))
    return found


def _width(rows: Sequence[Sequence[str]], header: Sequence[str]) -> int:
    """Number of fields of a row: a delimiter may end the header alone, or the rows alone."""
    named = max((k + 1 for k, name in enumerate(header) if name), default=len(header))
    counts = Counter(map(len, rows))
    usual = max(counts, key=lambda width: (counts[width], width), default=named)
    if usual < named:
        raise DataError(
            f"the rows have {usual} fields and the header has {named} names",
            hint="Write a blank field where a value is missing",
        )
    return min(usual, len(header) + 1)


def _is_tabular(rows: Sequence[Sequence[str]]) -> bool:
    filled = Counter(cell for row in rows for cell in row if cell)
    numbers = sum(count for cell, count in filled.items() if _is_number(cell))
    return numbers >= _NUMBERS_PART * max(filled.total(), 1)


def _cells_below(
    lines: Sequence[str], text: TextIO, delimiter: str, position: int
) -> Iterator[str]:
    """Contents of a column further down, blank ones left out."""
    for line in chain(lines, iter(lambda: read_row(text, blank=False), "")):
        if line.isspace():  # a packed file may hold millions of such lines
            continue
        cells = fields(line, delimiter)
        if len(cells) > position and cells[position]:
            yield cells[position]


def _refuse_no_text(line: str, all_lines: str) -> None:
    """Refuse what holds more than stray signs of another encoding that cannot be printed."""
    if 5 * _unprintable(line) > len(line) or 20 * _unprintable(all_lines) > len(all_lines):
        raise DataError(
            "the file is no text",
            hint=f"Formats are {READERS}",
        )


def _unprintable(text: str) -> int:
    """Count signs that no text has; a recorder that lost its power may leave zeros."""
    shown = re.sub(r"[\t\r\n\0]", "", text)
    if shown.isascii() and shown.isprintable():
        return 0
    return sum(not sign.isprintable() or sign == "\N{REPLACEMENT CHARACTER}" for sign in shown)


def decimal_comma(cell: str, delimiter: str) -> bool:
    """Whether the comma in a cell is a decimal mark, and no separator of thousands."""
    if COMMA_NUMBER.fullmatch(cell) is None:
        return False
    return delimiter != "," or _GROUPED.fullmatch(cell) is None


def _decimal(rows: Sequence[Sequence[str]], delimiter: str) -> str:
    cells = [cell for row in rows for cell in row]
    if any(_POINT_NUMBER.fullmatch(cell) for cell in cells):
        return "."
    commas = [cell for cell in cells if COMMA_NUMBER.fullmatch(cell)]
    if delimiter == "," and commas and all(map(_GROUPED.fullmatch, commas)):
        raise DataError(
            f"the comma in {commas[0]!r} may be a decimal mark or one of thousands",
            hint='Set [logs] decimal = "," if it is the former, else write numbers without it',
        )
    return "," if commas else ""
