"""Columns of a CSV file as float64, parsed in pieces so that memory does not grow with the text."""

from __future__ import annotations

import gzip
import re
import warnings
import zlib
from contextlib import contextmanager
from dataclasses import replace
from typing import TYPE_CHECKING, Any, TextIO, cast

import numpy as np
import pandas as pd

from data_prep.stamps import clock_seconds
from data_prep.text_file import DELIMITERS, Dialect, decimal_comma, open_text, skip, sniff
from narxcal.support.arrays import FloatArray
from narxcal.support.errors import DataError

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from data_prep.text_file import Head

CHUNK_ROWS = 50_000
_SHOWN_CHARS = 40
# Beside those that pandas knows, `N/A` and the like: what recorders and worksheets print for none.
_NO_VALUE = ("-", "--", "---", "----", "#DIV/0!", "#VALUE!", "#REF!", "#NUM!", "#NAME?")
_DATE = re.compile(r"\d+([-/.:])\d+\1\d.*|\d+:\d+(\.\d+)?.*")
_THOUSANDS = re.compile(r"[+-]?\d{1,3}([,.' ]\d{3})+([.,]\d*)?")


class _Prefixed:
    """A text with a line put before it and without comments: what pandas needs of a file.

    Its own rule for comments would take a cell like `#N/A`, and all that follows it, for one.
    """

    def __init__(self, line: str, text: TextIO, comment: str) -> None:
        self._lines = [line]
        self._text = text
        self._comment = comment

    def read(self, size: int = -1) -> str:
        while lines := self._lines or self._text.readlines(size):
            self._lines = []
            block = "".join(lines)
            if not self._comment or self._comment not in block:
                return block
            if kept := [line for line in lines if not line.lstrip().startswith(self._comment)]:
                return "".join(kept)
        return ""

    def __iter__(self) -> Iterator[str]:
        """Lines; pandas asks for the method but reads in blocks."""
        yield from iter(self._text)


class CsvSource:
    """One CSV file: its header and row of units, and on request some of its columns.

    Only the requested columns are kept, as float64, clock times as seconds; the text is read in
    pieces of `chunk_rows` rows. Row 1 is the first row of data below the header; blank lines and
    comment lines are not counted. A row shorter than the header ends in blanks.
    """

    def __init__(self, path: Path, dialect: Dialect, chunk_rows: int = CHUNK_ROWS) -> None:
        self.path = path
        self.dialect = dialect
        self.chunk_rows = chunk_rows

    @property
    def header(self) -> tuple[str, ...]:
        """Column names in file order."""
        return self.dialect.header

    @property
    def clock(self) -> str:
        """The column that holds clock times or dates; empty for none."""
        return self.dialect.clock

    @property
    def hourly(self) -> bool:
        """Whether the clock holds minutes and seconds alone."""
        return self.dialect.hourly

    @property
    def head(self) -> Head:
        """What stands above the first row."""
        return self.dialect.head

    def blocks(self, names: Sequence[str]) -> Iterator[dict[str, FloatArray]]:
        """The named columns in blocks of `chunk_rows` rows; a blank is NaN.

        Raises `DataError` for text in a number's place (naming row and value), a row longer
        than the header, a column that occurs twice, and a file that cannot be parsed.
        """
        positions = {name: self._position(name) for name in names}
        done = 0
        while True:
            try:
                for block in self._numbers(positions, done):
                    done += len(next(iter(block.values()), ()))
                    yield block
            except ValueError as error:  # pandas: text where a number should be, or a broken row
                self._explain(error, positions)
            else:
                return

    def _explain(self, cause: ValueError, positions: dict[str, int]) -> None:
        """Say where the text is that cannot be read, unless another decimal mark reads it."""
        row, name, text = self._first_text(positions) or (0, "", "")
        if not row:
            problem = " ".join(str(cause).split())
            raise DataError(
                f"the rows cannot be parsed ({problem})",
                file=self.path,
                hint="Look for a quote that is never closed",
            ) from cause
        if self.dialect.decimal_open and decimal_comma(text, self.dialect.delimiter):
            # The first rows held whole numbers only, so the comma could not be seen there.
            self.dialect = replace(self.dialect, decimal=",", decimal_open=False)
            return
        wanted = "a clock time or a date" if name == self.dialect.clock else "a number"
        raise DataError(
            f"expected {wanted}, found {text[:_SHOWN_CHARS]!r}",
            file=self.path,
            channel=name,
            row=row,
            hint=_what_to_do(text, self.dialect.delimiter),
        ) from cause

    def _position(self, name: str) -> int:
        if self.header.count(name) > 1:
            raise DataError(
                f"column '{name}' occurs {self.header.count(name)} times in the header",
                file=self.path,
                hint="Rename all but one",
            )
        return self.header.index(name)

    def _numbers(self, positions: dict[str, int], done: int) -> Iterator[dict[str, FloatArray]]:
        """Blocks of columns, without the first `done` rows."""
        row = 0
        for chunk in self._chunks([*positions.values()], np.float64):
            self._refuse_long_rows(chunk[len(self.header)], row)
            fresh = chunk.iloc[max(done - row, 0) :]
            row += len(chunk)
            if len(fresh):
                yield {
                    name: self._values(name, fresh[position])
                    for name, position in positions.items()
                }

    def _values(self, name: str, cells: pd.Series[Any]) -> FloatArray:
        if name != self.dialect.clock:
            return cells.to_numpy(dtype=np.float64, copy=True)
        if self._unreadable(name, cells).any():
            raise ValueError("neither a clock time nor a date")
        return clock_seconds(cells)

    def _refuse_long_rows(self, extra: pd.Series[Any], row: int) -> None:
        if extra.notna().any():
            raise DataError(
                f"the row holds more fields than the header, which has {len(self.header)}",
                file=self.path,
                row=row + int(extra.notna().to_numpy().argmax()) + 1,
                hint="Check the delimiter and the decimal mark",
            )

    @contextmanager
    def _rows(self) -> Iterator[TextIO]:
        """Open the text below the header."""
        with readable(self.path), open_text(self.path) as text:
            skip(text, self.dialect.head.lines)
            yield text

    def _chunks(self, positions: list[int], dtype: Any) -> Iterator[pd.DataFrame]:
        """Pieces of the table, plus the field after the last column to catch rows too long."""
        count = len(self.header)
        dialect = self.dialect
        kinds = {**dict.fromkeys(positions, dtype), count: object}
        if dialect.clock:
            kinds[self._position(dialect.clock)] = object
        # pandas learns from the first row how many fields there may be.
        widest = dialect.delimiter.join(["0"] * (count + 1)) + "\n"
        with self._rows() as text, warnings.catch_warnings():
            warnings.simplefilter("ignore", pd.errors.ParserWarning)
            reader = pd.read_csv(
                cast("TextIO", _Prefixed(widest, text, dialect.comment)),
                sep=r"\s+" if dialect.delimiter == " " else dialect.delimiter,
                decimal=dialect.decimal,
                header=None,
                names=list(range(count + 1)),
                usecols=sorted({*positions, count}),
                index_col=False,
                na_values=list(_NO_VALUE),
                dtype=kinds,
                skipinitialspace=True,
                chunksize=self.chunk_rows,
                engine="c",
            )
            with reader:
                yield next(reader).iloc[1:]
                yield from reader

    def _first_text(self, positions: dict[str, int]) -> tuple[int, str, str] | None:
        """Row, column and content of the first cell that is no number."""
        row = 0
        try:
            for chunk in self._chunks([*positions.values()], object):
                found = [
                    (int(bad.argmax()), position, name)
                    for name, position in positions.items()
                    if (bad := self._unreadable(name, chunk[position])).any()
                ]
                if found:
                    at, position, name = min(found)
                    return row + at + 1, name, str(chunk[position].iloc[at])
                row += len(chunk)
        except ValueError:  # a broken row comes first
            return None
        return None

    def _unreadable(self, name: str, texts: pd.Series[Any]) -> NDArray[np.bool_]:
        if name == self.dialect.clock:
            return np.asarray(np.isnan(clock_seconds(texts)) & texts.notna())
        plain = texts.astype("str").str.strip()
        if self.dialect.decimal != ".":
            plain = plain.str.replace(".", "x").str.replace(self.dialect.decimal, ".")
        return np.asarray(pd.to_numeric(plain, errors="coerce").isna() & texts.notna())


def _what_to_do(text: str, delimiter: str) -> str:
    """What to do about `text` in a number's place."""
    other = [each for each in DELIMITERS if each != delimiter and text.count(each) > 1]
    if other:
        own = " " if delimiter == " " else delimiter
        return f"The header is separated by {own!r}, this row by {other[0]!r}: use one in all"
    if _THOUSANDS.fullmatch(text):
        return "Write numbers without a separator of thousands"
    if _DATE.fullmatch(text):
        return "Stamps are seconds, clock times HH:MM:SS or dates like 2026-03-01T12:00:00"
    return "Correct it or leave it blank; row 1 is the first data row below the header"


@contextmanager
def readable(path: Path) -> Iterator[None]:
    """Turn what the file system and the decompressor may raise into a `DataError`."""
    try:
        yield
    except FileNotFoundError:
        raise DataError("the file does not exist", file=path) from None
    except IsADirectoryError:
        raise DataError(
            "a log is a file, and this is a folder", file=path, hint="Name the files in it"
        ) from None
    except (EOFError, zlib.error, gzip.BadGzipFile) as error:
        raise DataError(
            "the compressed file is truncated or damaged", file=path, hint="Copy it again"
        ) from error
    except OSError as error:
        raise DataError(f"the file cannot be read ({error.strerror})", file=path) from error


def open_csv(
    path: Path, delimiter: str, decimal: str, comment: str, time: str = "time_s"
) -> CsvSource:
    """Find out how `path` is written; raises `DataError` when it is empty or unreadable.

    Column `time` may hold clock times (see `data_prep.stamps`).
    """
    with readable(path), open_text(path) as text:
        try:
            dialect = sniff(text, delimiter, decimal, comment, time)
        except DataError as error:
            raise DataError(error.problem, file=path, hint=error.hint) from None
    return CsvSource(path, dialect)
