"""Files to logs: every recording of every engine of a file, on a uniform sampling grid.

A file is opened once as a `LogFile` and read once, block by block, through `data_prep.stream`, so
that memory holds the logs and one block. `narxcal replay` reads by the same two classes.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from data_prep.columns import constants, head_entries, map_columns, sources_of, to_channel
from data_prep.config import LogsConfig
from data_prep.csv_source import Counts, Pace, open_csv, readable
from data_prep.log import Audit, Log, Source
from data_prep.parquet_source import MAGIC, ParquetSource
from data_prep.stamps import Passed, all_apart, clock_goes_on, ordered_rows, usual_interval
from data_prep.stream import GridStream
from narxcal.channels import CHANNELS
from narxcal.support.errors import DataError
from narxcal.support.files import sha256_of

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence

    from data_prep.columns import Table
    from data_prep.stream import Piece
    from narxcal.support.arrays import FloatArray

# Numbers in a block: 40 MB. A recording of hours is one block, so that the rate of the rows and of
# each channel is found from all of it; in a larger file they are found from blocks of this size.
BLOCK_CELLS = 5_000_000
_LEAST_AHEAD_S = 5.0  # of rows in the next block, to bridge blanks of slow channels

Rows = dict[str, "FloatArray"]  # channel -> (rows,)


def read_logs(
    files: str | Path | Sequence[str | Path], config: LogsConfig | None = None
) -> list[Log]:
    """Read recordings into logs: file by file, engine by engine, part by part.

    Channels are canonical `(time,)` float64, NaN where missing; derived channels are included.
    Rows are put in order of time, split where they are more than `max_gap_s` apart, and laid on
    the grid as `data_prep.grid.resample` states; the audit of each log counts every row and sample
    that was dropped, moved, filled or left missing. `folder` and `files` of `config` are not used.

    Raises `DataError` (file, channel, row) for what the files hold, `ConfigError` for a
    configuration that cannot apply to them.
    """
    config = config or LogsConfig()
    paths = [files] if isinstance(files, str | Path) else list(files)
    return [log for path in paths for log in _file_logs(Path(path), config)]


def open_table(path: Path, config: LogsConfig) -> Table:
    """Open a CSV or Parquet file, distinguished by their first bytes; raises `DataError`."""
    with readable(path), path.open("rb") as raw:
        magic = raw.read(len(MAGIC))
    if magic == MAGIC:
        return ParquetSource(path, config.time_column)
    return open_csv(path, config)


class LogFile:
    """One file of recordings: its engines, and their rows as canonical channels, block by block.

    `engines` has one without a name where the configuration names none.
    """

    def __init__(self, path: Path, config: LogsConfig) -> None:
        self.path = path
        self.config = config
        self.table = open_table(path, config)
        self._columns = map_columns(self.table, config)
        self._sources = sources_of(self.table, config)
        self.engines = tuple(self._columns)

    def blocks(self, engines: Sequence[str], pace: Pace | None = None) -> Iterator[dict[str, Rows]]:
        """Yield engine -> channel -> `(rows,)`, in file order; raises `DataError`."""
        names = list({name: None for each in engines for name in self._columns[each].values()})
        switches = [
            column
            for columns in self._columns.values()
            for name, column in columns.items()
            if CHANNELS[name].role == "switch"
        ]
        for cells in self.table.blocks(names, pace, switches):
            yield {engine: self._canonical(engine, cells) for engine in engines}

    def counted(self) -> dict[str, Counts]:
        """Take engine -> what the file's `counts` became since the last call, by channel."""
        counts, self.table.counts = self.table.counts, Counter()
        found: dict[str, Counts] = {engine: Counter() for engine in self.engines}
        for engine, columns in self._columns.items():
            channels = {"*": "*", **{column: name for name, column in columns.items()}}
            for (column, action, reason), count in counts.items():
                if column in channels:
                    found[engine][channels[column], action, reason] += count
        return found

    def large_blocks(self) -> Iterator[dict[str, Rows]]:
        """Yield the same for all engines of a finished file, in blocks of about `BLOCK_CELLS`."""
        waiting: list[dict[str, Rows]] = []
        cells = 0
        for block in self.blocks(self.engines):
            waiting.append(block)
            cells += sum(len(values) for rows in block.values() for values in rows.values())
            if cells >= BLOCK_CELLS:
                yield _joined(waiting)
                waiting, cells = [], 0
        if waiting:
            yield _joined(waiting)

    def stream(self, dt_s: float, look_ahead_s: float, rows_s: float | None = None) -> GridStream:
        """Return the stream that puts the rows of one engine on a grid of `dt_s`."""
        known = constants(self._sources)
        return GridStream(
            self.config, dt_s, look_ahead_s, str(self.path), known, self.table.hourly, rows_s
        )

    def _canonical(self, engine: str, cells: Mapping[str, FloatArray]) -> Rows:
        return {
            name: to_channel(name, cells[column], self._sources[name])
            for name, column in self._columns[engine].items()
        }


def _joined(blocks: list[dict[str, Rows]]) -> dict[str, Rows]:
    if len(blocks) == 1:
        return blocks[0]
    return {
        engine: {
            name: np.concatenate([block[engine].pop(name) for block in blocks])
            for name in list(rows)
        }
        for engine, rows in blocks[0].items()
    }


def _file_logs(path: Path, config: LogsConfig) -> list[Log]:
    file = LogFile(path, config)
    with readable(path):
        digest = sha256_of(path)
    growing: dict[str, _Growing] = {}
    for block, last in _with_last(file.large_blocks()):
        counts = file.counted()
        for engine, rows in block.items():
            first = engine not in growing
            if first:
                source = Source(str(path), digest, engine)
                growing[engine] = _Growing(_stream(file, rows), source, path.name)
            stream = growing[engine].stream
            for entry in head_entries(file.table, config, len(rows["time_s"])):
                if first or entry.channel != "*":
                    stream.audit.count(entry.channel, entry.action, entry.reason, entry.samples)
            for channel, action, reason in counts[engine]:
                stream.audit.count(channel, action, reason, counts[engine][channel, action, reason])
            growing[engine].take(stream.push(rows, last=last))
    if not growing:
        raise DataError("no rows follow the header", file=path)
    return [log for each in growing.values() for log in each.finished()]


def _with_last(blocks: Iterable[dict[str, Rows]]) -> Iterator[tuple[dict[str, Rows], bool]]:
    """Yield each block, and whether it is the last one."""
    before: dict[str, Rows] | None = None
    for block in blocks:
        if before is not None:
            yield before, False
        before = block
    if before is not None:
        yield before, True


def _stream(file: LogFile, rows: Rows) -> GridStream:
    """Return the stream of an engine that begins with `rows`, which decide on the rate."""
    name, config = str(file.path), file.config
    passed = Passed(hourly=file.table.hourly)
    stamps, _, _ = clock_goes_on(rows["time_s"], config.max_gap_s, passed=passed)
    found = ordered_rows(stamps, config.max_gap_s, name)
    if len(found.time_s) < 2 or found.time_s[0] == found.time_s[-1]:
        raise DataError(
            f"expected samples at two or more times, found {min(1, len(found.time_s))}",
            file=name,
            channel="time_s",
        )
    channels = {name: values[found.order] for name, values in rows.items() if name != "time_s"}
    rows_s = usual_interval(found.time_s, channels, name)
    dt_s = 1.0 / config.raster_hz if config.raster_hz else rows_s
    return file.stream(dt_s, max(_LEAST_AHEAD_S, config.bridge_s), rows_s)


@dataclass
class _Growing:
    """Logs of one engine as they grow."""

    stream: GridStream
    source: Source
    file: str
    logs: list[Log] = field(default_factory=list)
    pieces: list[Piece] = field(default_factory=list)

    def take(self, pieces: Iterable[Piece]) -> None:
        """Add samples; a piece that begins a recording ends the one before."""
        for piece in pieces:
            if piece.starts:
                self._finish(self.stream.ended)
            self.pieces.append(piece)

    def finished(self) -> list[Log]:
        """Return all logs, after the last row."""
        self._finish(self.stream.audit.taken())
        if not self.logs:
            raise all_apart(self.stream.config.max_gap_s, self.source.file)
        return self.logs

    def _finish(self, audit: Audit) -> None:
        pieces, self.pieces = self.pieces, []
        if not pieces:
            return
        number = f"#{len(self.logs) + 1}" if self.logs else ""
        engine = f":{self.source.engine}" if self.source.engine else ""
        # Popped one by one, so that pieces and whole channels never all take memory.
        channels = {
            name: np.concatenate([piece.channels.pop(name) for piece in pieces])
            for name in list(pieces[0].channels)
        }
        between = {
            name: np.concatenate([piece.interpolated[name] for piece in pieces])
            for name in pieces[0].interpolated
        }
        self.logs.append(
            Log(
                f"{self.file}{engine}{number}",
                np.concatenate([piece.time_s for piece in pieces]),
                channels,
                audit,
                self.source,
                interpolated={name: flags for name, flags in between.items() if flags.any()},
            )
        )
