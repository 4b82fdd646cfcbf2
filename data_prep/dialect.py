"""How a text file is written: compression, encoding, delimiter, decimal mark, header."""

from __future__ import annotations

import codecs
import csv
import gzip
import io
import re
from collections import Counter
from dataclasses import dataclass
from typing import TYPE_CHECKING, TextIO

from data_prep.clock import is_clock
from narxcal.errors import DataError

if TYPE_CHECKING:
    from pathlib import Path

DELIMITERS = (";", "\t", "|", ",")
SAMPLE_LINES = 200
MAX_LINE_CHARS = 1_000_000
_GZIP_MAGIC = b"\x1f\x8b"
_BOMS = (
    (codecs.BOM_UTF8, "utf-8-sig"),
    (codecs.BOM_UTF32_LE, "utf-32"),
    (codecs.BOM_UTF32_BE, "utf-32"),
    (codecs.BOM_UTF16_LE, "utf-16"),
    (codecs.BOM_UTF16_BE, "utf-16"),
)
_QUOTED = re.compile(r'"[^"]*"')
COMMA_NUMBER = re.compile(r'"?\s*[+-]?\d*,\d+([eE][+-]?\d+)?\s*"?')
_POINT_NUMBER = re.compile(r'"?\s*[+-]?\d*\.\d+([eE][+-]?\d+)?\s*"?')


@dataclass(frozen=True)
class Dialect:
    """What has to be known to parse the data rows; delimiter ` ` means any run of blanks.

    `decimal_open`: no decimal mark was seen yet, so that a comma may still turn up. `clock` is the
    column that holds clock times or dates, if there is one.
    """

    delimiter: str
    decimal: str
    decimal_open: bool
    comment: str
    header: tuple[str, ...]
    clock: str = ""


def open_text(path: Path) -> TextIO:
    """Open `path` as text: gzip and encoding are told by the first bytes, not by the name.

    Bytes that are no text become the replacement character, so a stray degree sign in a
    header does no harm, while in a number it is reported as text.
    """
    with path.open("rb") as raw:
        zipped = raw.read(2) == _GZIP_MAGIC
    binary = gzip.GzipFile(path, "rb") if zipped else path.open("rb")
    try:
        head = binary.read(4)
        binary.seek(0)
    except BaseException:
        binary.close()
        raise
    encoding = next((name for bom, name in _BOMS if head.startswith(bom)), "utf-8")
    return io.TextIOWrapper(
        binary,
        encoding=encoding,
        errors="replace",
    )


def next_header(text: TextIO, comment: str) -> str:
    """Read up to the header, the first line that is neither blank nor a comment."""
    while line := text.readline(MAX_LINE_CHARS):
        stripped = line.strip()
        if stripped and not (comment and stripped.startswith(comment)):
            return line.rstrip("\r\n")
    raise DataError("the file is empty", hint="Expected a header line and data rows")


def sniff(text: TextIO, delimiter: str, decimal: str, comment: str, time: str) -> Dialect:
    """Read the header and the first rows; `auto` is decided from them.

    Column `time` may hold clock times or dates instead of numbers, which its first cell decides.

    The delimiter is the one of `; TAB | ,` that the header and most rows hold equally often,
    else blanks; the decimal mark is a comma where numbers like `1,5` occur and none like `1.5`.
    Raises `DataError` for a file that is empty or no text.
    """
    header = next_header(text, comment)
    if _is_no_text(header):
        raise DataError(
            "the file is no text", hint="Expected a CSV file, plain or gzipped, or Parquet"
        )
    rows = _sample(text, comment)
    if delimiter == "auto":
        delimiter = _delimiter(header, rows)
    if decimal == "auto":
        decimal = _decimal(rows, delimiter)
    names = _fields(header, delimiter)
    return Dialect(
        delimiter=delimiter,
        decimal=decimal or ".",
        decimal_open=not decimal,
        comment=comment,
        header=names,
        clock=time if is_clock(_first_cell(rows, delimiter, names, time)) else "",
    )


def _first_cell(rows: list[str], delimiter: str, header: tuple[str, ...], name: str) -> str:
    """The first content of column `name`, empty where there is none."""
    if name not in header:
        return ""
    position = header.index(name)
    cells = (_fields(row, delimiter)[position : position + 1] for row in rows)
    return next((cell[0] for cell in cells if cell and cell[0]), "")


def _is_no_text(line: str) -> bool:
    """Whether more of a header than stray signs of another encoding is unprintable."""
    shown = line.replace("\t", " ").replace("\0", "")
    wrong = sum(not sign.isprintable() or sign == "\N{REPLACEMENT CHARACTER}" for sign in shown)
    return 5 * wrong > len(shown)


def _sample(text: TextIO, comment: str) -> list[str]:
    lines = (text.readline(MAX_LINE_CHARS).strip() for _ in range(SAMPLE_LINES))
    return [line for line in lines if line and not (comment and line.startswith(comment))]


def _delimiter(header: str, rows: list[str]) -> str:
    bare = [_QUOTED.sub("", row) for row in rows]
    wanted = _QUOTED.sub("", header)
    best, best_score = ",", 0.0
    for candidate in DELIMITERS:
        count = wanted.count(candidate)
        if not count:
            continue
        # A trailing delimiter in the rows alone is common, hence "+ 1".
        same = Counter(row.count(candidate) - count in (0, 1) for row in bare)[True]
        score = (1.0 + same) / (1.0 + len(bare)) + 1e-6 * count
        if score > best_score:
            best, best_score = candidate, score
    if best_score == 0.0 and len(wanted.split()) > 1:
        return " "
    return best


def _decimal(rows: list[str], delimiter: str) -> str:
    fields = [field for row in rows for field in _fields(row, delimiter)]
    commas = any(COMMA_NUMBER.fullmatch(field) for field in fields)
    points = any(_POINT_NUMBER.fullmatch(field) for field in fields)
    if points or commas:
        return "." if points else ","
    return ""


def _fields(line: str, delimiter: str) -> tuple[str, ...]:
    line = line.replace("\0", "")
    if delimiter == " ":
        return tuple(line.split())
    try:
        fields = next(csv.reader([line], delimiter=delimiter, skipinitialspace=True), [])
    except csv.Error:
        fields = line.split(delimiter)
    return tuple(field.strip() for field in fields)
