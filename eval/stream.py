"""A CSV file as a stream of row blocks: one pass, constant memory, growing files included."""

from __future__ import annotations

import io
import time
import zlib
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, cast

from data_prep.columns import constants, map_columns, read_columns, sources_of, to_channel
from data_prep.csv_source import CsvSource, readable
from data_prep.reading import open_table
from data_prep.text_file import Head, open_text, skip
from narxcal.support.arrays import FloatArray
from narxcal.support.errors import DataError

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path
    from typing import BinaryIO, TextIO

    from data_prep.config import LogsConfig

_POLL_S = 0.05


@dataclass(kw_only=True)
class Pace:
    """How a stream is read: `lines` at a time; with `follow` until nothing came for `idle_s`.

    `clock` and `sleep` are those of `time`; a test brings its own. `stop` says that the reader
    wants no more: what has come is all there is.
    """

    lines: int = 4096
    follow: bool = False
    idle_s: float = 10.0
    clock: Callable[[], float] = time.monotonic
    sleep: Callable[[float], None] = time.sleep
    stop: Callable[[], bool] = lambda: False


@dataclass
class CsvStream:
    """Rows of a log as canonical channels, in file order, block by block.

    After the last block `truncated` says whether the file broke off in mid-line or, compressed,
    in mid-stream; the incomplete line is left out.
    """

    path: Path
    config: LogsConfig
    pace: Pace = field(default_factory=Pace)
    truncated: bool = False

    def __post_init__(self) -> None:
        table = open_table(self.path, self.config)
        if not isinstance(table, CsvSource):
            raise DataError(
                "a Parquet file cannot be streamed", file=self.path, hint="Write it as CSV first"
            )
        self._table = table
        self._columns = map_columns(self._table, self.config)
        self._sources = sources_of(self._table, self.config)

    @property
    def engines(self) -> tuple[str, ...]:
        """Engines of the file; one without a name where the configuration names none."""
        return tuple(self._columns)

    @property
    def hourly(self) -> bool:
        """Whether the clock shows no hours."""
        return self._table.hourly

    @property
    def constants(self) -> dict[str, float]:
        """Channels that the configuration gives a value instead of a column."""
        return constants(self._sources)

    def channels(self, engine: str) -> tuple[str, ...]:
        """Channels that `engine` has in this file, derived ones left out."""
        return tuple(self._columns[engine])

    def blocks(self, engines: Sequence[str]) -> Iterator[dict[str, dict[str, FloatArray]]]:
        """Engine -> channel -> `(rows,)`; raises `DataError` as `data_prep.read_logs`."""
        wanted = {name: None for engine in engines for name in self._columns[engine].values()}
        first_row = 0
        for text in self._texts():
            cells = _read(self._table, text, list(wanted), first_row)
            first_row += len(next(iter(cells.values())))
            yield {engine: self._canonical(engine, cells) for engine in engines}

    def _canonical(self, engine: str, cells: dict[str, FloatArray]) -> dict[str, FloatArray]:
        return {
            name: to_channel(name, cells[column], self._sources[name])
            for name, column in self._columns[engine].items()
        }

    def _texts(self) -> Iterator[str]:
        """Blocks of whole lines."""
        rest = ""
        with readable(self.path), open_text(self.path) as text:
            skip(text, self._table.head.lines)
            for lines in self._lines(text):
                lines[0] = rest + lines[0]
                rest = "" if lines[-1].endswith("\n") else lines.pop()
                if lines:
                    yield "".join(lines)
        if self._complete(rest):
            yield rest + "\n"
        else:
            self.truncated = self.truncated or bool(rest.strip())

    def _lines(self, text: TextIO) -> Iterator[list[str]]:
        """Lines as they come; the last one of a list may still be growing."""
        quiet_since = self.pace.clock()
        while not self.pace.stop():
            lines = self._some(text)
            if lines:
                quiet_since = self.pace.clock()
                yield lines
            elif not self.pace.follow or self.pace.clock() - quiet_since >= self.pace.idle_s:
                return
            else:
                self.pace.sleep(_POLL_S)

    def _some(self, text: TextIO) -> list[str]:
        lines: list[str] = []
        try:
            while len(lines) < self.pace.lines and (line := text.readline()):
                lines.append(line)
        except (EOFError, zlib.error):
            self.truncated = True
        return lines

    def _complete(self, line: str) -> bool:
        """Whether a last line without an end is as long as the header, so far as can be told."""
        delimiter = None if self._table.dialect.delimiter == " " else self._table.dialect.delimiter
        fields = line.split(delimiter)
        return len(fields) >= len(self._table.header) and bool(fields[-1].strip())


@dataclass(frozen=True)
class _Lines:
    """Some lines of a file in the place of the whole one: what a reader needs of a path."""

    path: Path
    text: str

    def open(self, mode: str) -> BinaryIO:
        """Give the lines as a file without a head."""
        if mode != "rb":
            raise ValueError(f"lines are read as bytes, not in mode {mode!r}")
        return io.BytesIO(self.text.encode("utf-8"))

    def __fspath__(self) -> str:
        return str(self.path)

    def __str__(self) -> str:
        return str(self.path)


def _read(table: CsvSource, text: str, names: Sequence[str], row: int) -> dict[str, FloatArray]:
    """Read lines by the rules of their whole file, of which `row` rows went before."""
    headless = replace(table.dialect, head=Head(lines=0))
    block = CsvSource(cast("Path", _Lines(table.path, text)), headless)
    try:
        cells = read_columns(block, names)
    except DataError as error:
        if error.row is None:
            raise
        raise DataError(
            error.problem,
            file=error.file,
            channel=error.channel,
            row=error.row + row,
            hint=error.hint,
        ) from None
    # Which decimal mark is in use may have shown only now.
    table.dialect = replace(block.dialect, head=table.dialect.head)
    return cells
