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

from data_prep.array_source import MAGIC_BYTES, ArraySource, is_array_file
from data_prep.code_words import CodeWords
from data_prep.columns import constants, head_entries, map_columns, sources_of, to_channel
from data_prep.config import LogsConfig
from data_prep.csv_source import Counts, Pace, open_csv, readable
from data_prep.log import CODE_WORD, Audit, Log, Source
from data_prep.parquet_source import MAGIC, ParquetSource
from data_prep.stamps import Passed, all_apart, clock_goes_on, ordered_rows, usual_interval
from data_prep.stream import GridStream
from data_prep.words import Labels, switch
from narxcal.channels import described
from narxcal.support.errors import DataError, did_you_mean
from narxcal.support.files import sha256_of

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence

    from numpy.typing import NDArray

    from data_prep.columns import Table
    from data_prep.stream import Piece
    from narxcal.support.arrays import FloatArray

# Numbers in a block: 40 MB. A recording of hours is one block, so that the rate of the rows and of
# each channel is found from all of it; in a larger file they are found from blocks of this size.
BLOCK_CELLS = 5_000_000
_LEAST_AHEAD_S = 5.0  # of rows in the next block, to bridge blanks of slow channels
SAME_INTERVAL = 1e-3  # relative difference of sampling intervals that is none

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


def shared_interval_s(logs: Sequence[Log]) -> float | None:
    """Median over files of the sampling interval in s; None where all logs have the same one.

    A model is fitted on one grid: recorders whose frames are not quite regular need one named.
    """
    intervals = list({log.source.file: log.dt_s for log in logs}.values())
    if np.ptp(intervals) <= SAME_INTERVAL * min(intervals):
        return None
    return float(np.median(intervals))


def open_table(path: Path, config: LogsConfig) -> Table:
    """Open a file of any format that is read, by its first bytes; raises `DataError`."""
    with readable(path), path.open("rb") as raw:
        magic = raw.read(MAGIC_BYTES)
    if magic.startswith(MAGIC):
        return ParquetSource(path, config.time_column)
    if is_array_file(magic):
        return ArraySource(path, config.time_column)
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
        """Yield engine -> channel -> `(rows,)`, in file order; raises `DataError`.

        Where columns tell instances apart, `engine-instance` takes the place of the engine.
        """
        columns = [column for each in engines for column in self._columns[each].items()]
        switches = {column: switch for name, column in columns if described(name).role == "switch"}
        labels = {column: Labels() for column in self._instances()}
        if labels and pace and pace.live:
            raise DataError(
                "a file of several instances cannot be streamed",
                file=self.path,
                hint="Write each of them to a file of its own",
            )
        names = list(dict.fromkeys([column for _, column in columns] + list(labels)))
        words = {**switches, **{column: each.number for column, each in labels.items()}}
        others = {*switches, *labels, self.config.time_column}
        coded = {name: CodeWords() for name in names if name not in others}
        for cells in self.table.blocks(names, pace, words):
            self._mask_code_words(cells, coded)
            rows = self._apart(cells, labels) if labels else {"": slice(None)}
            yield {
                "-".join(filter(None, (engine, instance))): {
                    name: values[chosen] for name, values in self._canonical(engine, cells).items()
                }
                for engine in engines
                for instance, chosen in rows.items()
            }

    def _mask_code_words(
        self, cells: dict[str, FloatArray], coded: Mapping[str, CodeWords]
    ) -> None:
        """Blank the code words of each column, and count them."""
        for column, words in coded.items():
            for word, rows in words.masks(cells[column]):
                cells[column] = np.where(rows, np.nan, cells[column])
                reason = f"{CODE_WORD} {word.value:g}: {word.why}"
                self.table.counts[column, "dropped", reason] += int(rows.sum())

    def _instances(self) -> tuple[str, ...]:
        columns = tuple(" ".join(name.split()) for name in self.config.instances)
        for column in columns:
            if column not in self.table.header:
                raise DataError(
                    f"column '{column}' of [logs] instances is missing",
                    file=self.path,
                    hint=did_you_mean(column, self.table.header, "The file has"),
                )
        return columns

    def _apart(
        self, cells: Mapping[str, FloatArray], labels: Mapping[str, Labels]
    ) -> dict[str, NDArray[np.intp]]:
        """Instance -> its rows; a row without a label belongs to none, which is counted."""
        keys = np.column_stack([cells[column] for column in labels])
        known = np.flatnonzero(np.isfinite(keys).all(axis=1))
        self.table.counts["*", "dropped", "row of no instance"] += len(keys) - len(known)
        found, of_row = np.unique(keys[known], axis=0, return_inverse=True)
        return {
            "-".join(
                each.label(number) for each, number in zip(labels.values(), key, strict=True)
            ): known[of_row.ravel() == k]
            for k, key in enumerate(found)
        }

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
    found: dict[str, Rows] = {}
    for engine in dict.fromkeys(engine for block in blocks for engine in block):
        parts = [block.pop(engine) for block in blocks if engine in block]
        found[engine] = {
            name: np.concatenate([part.pop(name) for part in parts]) for name in list(parts[0])
        }
    return found


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
            for key, count in _taken(counts, engine).items():
                stream.audit.count(*key, count)
            growing[engine].push(rows, last=last)
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


def _taken(counts: dict[str, Counts], key: str) -> Counts:
    """Take the counts of the engine of which `key` is an instance; none the second time."""
    fits = (each for each in counts if each in ("", key) or key.startswith(f"{each}-"))
    return counts.pop(next(fits, ""), Counter())


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
    over: bool = False

    def push(self, rows: Rows, *, last: bool) -> None:
        """Add rows; a piece of samples that begins a recording ends the one before."""
        self.over = last
        for piece in self.stream.push(rows, last=last):
            if piece.starts:
                self._finish(self.stream.ended)
            self.pieces.append(piece)

    def finished(self) -> list[Log]:
        """Return all logs, after the last row."""
        if not self.over:  # an instance that the last block does not have
            self.push({}, last=True)
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
                declared=self.stream.config.declared,
            )
        )
