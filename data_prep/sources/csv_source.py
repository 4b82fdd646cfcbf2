"""Columns of a CSV file, finished or still growing, as float64, block by block."""

from __future__ import annotations

import gzip
import re
import time
import warnings
import zlib
from collections import Counter
from collections.abc import Callable, Collection, Generator, Iterable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass, replace
from io import StringIO
from pathlib import Path
from typing import Any, TextIO

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from data_prep.cleaning.words import is_no_value, plain
from data_prep.config import LogsConfig
from data_prep.log import Action
from data_prep.sources.text_file import (
    DELIMITERS,
    Dialect,
    decimal_comma,
    fields,
    open_text,
    read_row,
    sniff,
)
from narxcal.support.arrays import FloatArray
from narxcal.support.errors import DataError

_BLOCK_CHARS = 20_000_000  # a block ends here although more lines were wanted: bounded memory
_SHOWN_CHARS = 40
_POLL_S = 0.05
_NAN = ("", "nan", "NaN", "NAN", "-nan", "-NaN")  # how programs print a missing number
_MOST_FOOTER = 20  # rows of text at the end of a file
_DATE = re.compile(r"\d+([-/.:])\d+\1\d.*|\d+:\d+(\.\d+)?.*")
Words = Mapping[str, Callable[[str], float]]  # column -> word -> number, NaN for an unknown one
Counts = Counter[tuple[str, "Action", str]]  # (column or *, action, reason) -> cells or rows
_THOUSANDS = re.compile(r"[+-]?\d{1,3}([,.' ]\d{3})+([.,]\d*)?")


@dataclass(kw_only=True)
class Pace:
    """How the lines of a file are read: up to `lines` at a time.

    With `live` the file may still be written: an incomplete last line is left out, where a finished
    file ends with a row. With `follow` in addition further lines are waited for, until none came
    for `idle_s`. `clock` and `sleep` are those of `time`; `stop` ends the reading.
    """

    lines: int = 50_000
    live: bool = False
    follow: bool = False
    idle_s: float = 10.0
    clock: Callable[[], float] = time.monotonic
    sleep: Callable[[float], None] = time.sleep
    stop: Callable[[], bool] = lambda: False


class CsvSource:
    """One CSV file: its header and row of units, and on request some of its columns.

    Only the requested columns are kept, as float64, clock times as seconds. Row 1 is the first row
    of data below the header; blank lines and comment lines are not counted. A row with fewer
    fields than the others is blank in all columns, since which field is missing cannot be known.
    A header that occurs again is no row, nor are rows of text at the end. `counts` are those read
    so far and the cells that hold a word instead of a value. `truncated` becomes true where a live
    file broke off within a line or, compressed, within its stream.
    """

    def __init__(self, path: Path, dialect: Dialect, no_value: Collection[str] = ()) -> None:
        self.path = path
        self.dialect = dialect
        self.header, self.head, self.tabular = dialect.header, dialect.head, dialect.tabular
        self.clock = dialect.time if dialect.clock else ""
        self.hourly = dialect.clock is not None and dialect.clock.hourly
        self.counts: Counts = Counter()
        self.truncated = False
        self._further = {plain(word) for word in no_value}
        self._no_value: set[str] = set()  # as they are spelled in the file
        self._words: Words = {}
        self._footer: DataError | None = None

    def blocks(
        self, names: Sequence[str], pace: Pace | None = None, words: Words | None = None
    ) -> Iterator[dict[str, FloatArray]]:
        """The named columns `(rows,)` in blocks of `pace.lines` rows; a blank is NaN.

        Those of `words` may hold words, each with a function that gives their number.

        Raises `DataError` for text in place of a number (naming row and value), a row longer
        than the header, a column that occurs twice, and a file that cannot be parsed.
        """
        positions = {name: self._position(name) for name in names}
        row = 0
        self._words = words or {}
        # Closed at once: the error of a footer keeps this frame until garbage is collected.
        with closing(self._line_blocks(pace or Pace())) as blocks:
            for lines in blocks:
                rows = self._rows(lines)
                if rows and self._footer:
                    raise self._footer
                if rows:
                    self._blank_short(rows, row)
                    yield self._numbers(rows, positions, row)
                    row += len(rows)

    def _line_blocks(self, pace: Pace) -> Generator[list[str]]:
        tail = ""  # a line without its end
        with readable(self.path), open_text(self.path) as text:
            for _ in range(self.head.lines):
                read_row(text)
            for lines in self._arriving(text, pace):
                lines[0] = tail + lines[0]
                tail = "" if lines[-1].endswith("\n") else lines.pop()
                if lines:
                    yield lines
        if not pace.live or self._is_complete(tail):
            yield [tail]
        else:
            self.truncated = self.truncated or bool(tail.strip())

    def _arriving(self, text: TextIO, pace: Pace) -> Iterator[list[str]]:
        """Lines as they come; the last one of a list may still be growing."""
        quiet_since = pace.clock()
        while not pace.stop():
            lines = self._some(text, pace)
            if lines:
                quiet_since = pace.clock()
                yield lines
            elif not pace.follow or pace.clock() - quiet_since >= pace.idle_s:
                return
            else:
                pace.sleep(_POLL_S)

    def _some(self, text: TextIO, pace: Pace) -> list[str]:
        lines: list[str] = []
        chars = 0
        try:
            line = read_row(text)  # a blank one may end the line that was growing
            while line:
                lines.append(line)
                chars += len(line)
                # What follows a line without an end has been written since, and belongs to it.
                if len(lines) == pace.lines or chars >= _BLOCK_CHARS or not line.endswith("\n"):
                    break
                line = read_row(text, blank=False)
        except (EOFError, zlib.error):
            if not pace.live:
                raise
            self.truncated = True
        return lines

    def _rows(self, lines: list[str]) -> list[str]:
        """Leave out blank lines and comments; where tabs delimit, a line of tabs is a row."""
        blanks = " \r\n" if self.dialect.delimiter == "\t" else None
        rows = [line for line in lines if line.strip(blanks)]
        # Searched as one text first, which takes a tenth of the time, as most have neither.
        text = "".join(rows)
        comment = self.dialect.comment
        if comment and comment in text:
            rows = [row for row in rows if not row.lstrip().startswith(comment)]
        if not any(line in text for line in self.head.repeated):
            return rows
        new = [row for row in rows if row.strip() not in self.head.repeated]
        self.counts["*", "dropped", "header again"] += len(rows) - len(new)
        return new

    def _is_complete(self, line: str) -> bool:
        """Whether a last line without an end has all its fields, so far as can be seen."""
        delimiter = None if self.dialect.delimiter == " " else self.dialect.delimiter
        cells = line.split(delimiter)
        return len(cells) >= len(self.header) and bool(cells[-1].strip())

    def _blank_short(self, rows: list[str], before: int) -> None:
        """Blank the rows with fewer fields than the others."""
        delimiter, width = self.dialect.delimiter, self.dialect.width
        for k, row in enumerate(rows):
            # Fields are counted exactly only where delimiters may be quoted or repeated.
            if row.count(delimiter) >= width - 1 and delimiter != " " and '"' not in row:
                continue
            if len(fields(row, delimiter)) >= width:
                continue
            counts = {each: row.count(each) + 1 for each in DELIMITERS if each != delimiter}
            other = [each for each, count in counts.items() if count >= max(width, 2)]
            if other:
                raise DataError(
                    f"the header is separated by {delimiter!r}, this row by {other[0]!r}",
                    file=self.path,
                    row=before + k + 1,
                    hint="Use one delimiter in all rows",
                )
            rows[k] = delimiter.join(["nan"] * width) + "\n"
            self.counts["*", "masked", "row with a missing field"] += 1

    def _numbers(
        self, rows: list[str], positions: dict[str, int], before: int
    ) -> dict[str, FloatArray]:
        """Columns of `rows`, to which `before` rows of the file come first."""
        try:
            cells = self._cells(rows, [*positions.values()], np.float64)
            self._refuse_long_rows(cells[len(self.header)], before)
            values = {name: self._values(name, cells[at]) for name, at in positions.items()}
        except ValueError as error:  # pandas: text where a number should be, or a broken row
            texts = self._texts(rows, positions)
            if not texts:
                raise DataError(
                    f"rows {before + 1} to {before + len(rows)} cannot be parsed "
                    f"({' '.join(str(error).split())})",
                    file=self.path,
                    hint="Look for a quote that is never closed",
                ) from error
            if not (self._learn_words(texts) or self._drop_footer(rows, texts, before)):
                self._explain(texts, before)
            return self._numbers(rows, positions, before)
        if self._no_value:
            self._count_words(rows, positions)
        return values

    def _texts(
        self, rows: list[str], positions: dict[str, int]
    ) -> dict[str, tuple[pd.Series[Any], NDArray[np.bool_]]]:
        """Column -> its cells as text, and which of them cannot be read; empty for a broken row."""
        try:
            cells = self._cells(rows, [*positions.values()], object)
        except ValueError:
            return {}
        texts = {name: cells[at] for name, at in positions.items()}
        return {
            name: (own, np.asarray(np.isnan(self._numbers_of(name, own)) & own.notna()))
            for name, own in texts.items()
        }

    def _learn_words(self, texts: Mapping[str, tuple[pd.Series[Any], NDArray[np.bool_]]]) -> bool:
        """Take over the words that stand for no value; whether there are further ones."""
        found = {str(text) for cells, bad in texts.values() for text in cells[bad].unique()}
        words = {word for word in found if is_no_value(word) or plain(word) in self._further}
        self._no_value |= words
        return bool(words)

    def _count_words(self, rows: list[str], positions: dict[str, int]) -> None:
        learned, self._no_value = self._no_value, set()
        cells = self._cells(rows, [*positions.values()], object)
        self._no_value = learned
        for name, at in positions.items():
            words = cells[at][cells[at].isin(learned)].str.strip().value_counts()
            for word, count in words.items():
                self.counts[name, "dropped", f"no value: {word}"] += int(count)

    def _drop_footer(
        self,
        rows: list[str],
        texts: Mapping[str, tuple[pd.Series[Any], NDArray[np.bool_]]],
        before: int,
    ) -> bool:
        """Leave out rows at the end whose stamps are words; whether there are any.

        Should another row follow, they are none, and the error of the first is raised then.
        """
        cells, bad = texts.get(self.dialect.time) or next(iter(texts.values()))
        stamped = np.flatnonzero(cells.notna().to_numpy() & ~bad)
        first = int(stamped[-1]) + 1 if len(stamped) else 0
        if before + first == 0 or not 0 < len(rows) - first <= _MOST_FOOTER:
            return False
        words = cells.iloc[first:][bad[first:]]
        if not len(words) or not words.str.match(r"\s*[A-Za-z]").all():
            return False
        try:
            self._explain(texts, before)
        except DataError as error:
            self._footer = error
        self.counts["*", "dropped", f"row below the data: {words.iloc[0].strip()[:20]}"] += (
            len(rows) - first
        )
        del rows[first:]
        return True

    def _explain(
        self, texts: Mapping[str, tuple[pd.Series[Any], NDArray[np.bool_]]], before: int
    ) -> None:
        """Locate the first text that cannot be read, unless another decimal mark reads it."""
        row, name = min((int(bad.argmax()), name) for name, (_, bad) in texts.items() if bad.any())
        text = str(texts[name][0].iloc[row])
        if self.dialect.decimal_open and decimal_comma(text, self.dialect.delimiter):
            # The rows before held whole numbers only, so the comma could not be seen there.
            self.dialect = replace(self.dialect, decimal=",", decimal_open=False)
            return
        wanted = "a clock time or a date" if name == self.clock else "a number"
        raise DataError(
            f"expected {wanted}, found {text[:_SHOWN_CHARS]!r}",
            file=self.path,
            channel=name,
            row=before + row + 1,
            hint=_what_to_do(text.strip()),
        )

    def _position(self, name: str) -> int:
        if self.header.count(name) > 1:
            raise DataError(
                f"column '{name}' occurs {self.header.count(name)} times in the header",
                file=self.path,
                hint="Rename all but one",
            )
        return self.header.index(name)

    def _values(self, name: str, cells: pd.Series[Any]) -> FloatArray:
        clock = self.dialect.clock if name == self.dialect.time else None
        if not clock and name not in self._words:
            return cells.to_numpy(dtype=np.float64, copy=True)
        values = self._numbers_of(name, cells)
        if (np.isnan(values) & cells.notna()).any():
            raise ValueError("neither a clock time nor a date, or no known word")
        return values

    def _numbers_of(self, name: str, texts: pd.Series[Any]) -> FloatArray:
        """Numbers of the cells of a column as text; NaN for a blank and what cannot be read."""
        if name == self.dialect.time and self.dialect.clock:
            return self.dialect.clock.seconds(texts)
        if name not in self._words:
            return self._parsed(texts)
        codes, words = pd.factorize(texts.to_numpy(dtype=object))
        numbers = [self._words[name](word) if word else np.nan for word in words]
        known = np.array(numbers, dtype=np.float64)
        if not np.isfinite(known).all():
            known = np.where(np.isfinite(known), known, self._parsed(words))
        return np.append(known, np.nan)[codes]  # code -1 is a blank

    def _parsed(self, texts: Iterable[object]) -> FloatArray:
        # No more than pandas' parser strips: it refuses a no-break space or a separator of records.
        numbers = [text.strip(" \t\v\f\r\n") if isinstance(text, str) else "" for text in texts]
        if self.dialect.decimal != ".":
            mark = self.dialect.decimal
            numbers = [text.replace(".", "x").replace(mark, ".") for text in numbers]
        found = pd.to_numeric(np.array(numbers, dtype=object), errors="coerce")
        return np.asarray(found, dtype=np.float64)

    def _refuse_long_rows(self, extra: pd.Series[Any], row: int) -> None:
        if extra.notna().any():
            raise DataError(
                f"the row holds more fields than the header, which has {len(self.header)}",
                file=self.path,
                row=row + int(extra.notna().to_numpy().argmax()) + 1,
                hint="Check the delimiter and the decimal mark",
            )

    def _cells(self, rows: list[str], positions: list[int], dtype: Any) -> pd.DataFrame:
        """Some columns of `rows`, and the field after the last one to catch rows too long."""
        count = len(self.header)
        dialect = self.dialect
        kinds = {**dict.fromkeys(positions, dtype), count: object}
        for name in (self.clock, *self._words):
            if name in self.header:
                kinds[self._position(name)] = object
        # The first row decides how many fields pandas allows.
        widest = dialect.delimiter.join(["0"] * (count + 1)) + "\n"
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", pd.errors.ParserWarning)
            table = pd.read_csv(
                StringIO(widest + "".join(rows)),
                sep=r"\s+" if dialect.delimiter == " " else dialect.delimiter,
                decimal=dialect.decimal,
                header=None,
                names=list(range(count + 1)),
                usecols=sorted({*positions, count}),
                index_col=False,
                keep_default_na=False,
                na_values=[*_NAN, *self._no_value],
                dtype=kinds,
                skipinitialspace=True,
                engine="c",
            )
        return table.iloc[1:]


def _what_to_do(text: str) -> str:
    """Advise on `text` in place of a number."""
    if _THOUSANDS.fullmatch(text):
        return "Write numbers without a separator of thousands"
    if _DATE.fullmatch(text):
        return "Stamps are seconds, clock times HH:MM:SS or dates like 2026-03-01T12:00:00"
    return "Correct it or leave it blank; row 1 is the first data row below the header"


@contextmanager
def readable(path: Path) -> Iterator[None]:
    """Turn what the file system and the decompressor may raise into a `DataError` of the file."""
    try:
        yield
    except DataError as error:
        if error.file is not None:
            raise
        raise DataError(error.problem, file=path, hint=error.hint) from None
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


def open_csv(path: Path, config: LogsConfig) -> CsvSource:
    """Find out how `path` is written; raises `DataError` where it is empty or unreadable.

    The column of time may hold clock times and dates (see `data_prep.sources.clock`).
    """
    with readable(path), open_text(path) as text:
        dialect = sniff(text, config)
    return CsvSource(path, dialect, config.no_value)
