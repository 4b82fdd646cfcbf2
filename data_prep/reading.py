"""Files to logs: every recording of every engine of a file, on a uniform sampling grid.

A file is opened once as a `LogFile` and read once, block by block, through
`data_prep.sources.stream`, so that memory holds the logs and one block; several files of one flight
are a `Flight`. `narxcal replay` reads by the same classes.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from data_prep.config import LogsConfig
from data_prep.log import Audit, Log, Source
from data_prep.sources.csv_source import Counts
from data_prep.sources.log_file import Flight, LogFile, Rows, open_log
from data_prep.sources.stamps import Passed, all_apart, clock_goes_on, ordered_rows, usual_interval
from data_prep.sources.stream import GridStream, Piece
from narxcal.support.errors import DataError

_LEAST_AHEAD_S = 5.0  # of rows in the next block, to bridge blanks of slow channels
SAME_INTERVAL = 1e-3  # relative difference of sampling intervals that is none


def read_logs(
    files: str | Path | Sequence[str | Path], config: LogsConfig | None = None
) -> list[Log]:
    """Read recordings into logs: file by file, engine by engine, part by part.

    Files that `flights` of `config` makes parts of one flight are read as one, in the place of the
    first.

    Channels are canonical `(time,)` float64, NaN where missing; derived channels are included.
    Rows are put in order of time, split where they are more than `max_gap_s` apart, and laid on
    the grid as `data_prep.sources.grid.resample` states; the audit of each log counts every row and
    sample that was dropped, moved, filled or left missing. `folder` and `files` of `config` are not
    used.

    Raises `DataError` (file, channel, row) for what the files hold, `ConfigError` for a
    configuration that cannot apply to them.
    """
    config = config or LogsConfig()
    paths = [files] if isinstance(files, str | Path) else list(files)
    firsts = dict.fromkeys(config.parts(Path(path))[0] for path in paths)
    return [log for path in firsts for log in _file_logs(path, config)]


def shared_interval_s(logs: Sequence[Log]) -> float | None:
    """Median over files of the sampling interval in s; None where all logs have the same one.

    A model is fitted on one grid: recorders whose frames are not quite regular need one named.
    """
    intervals = list({log.source.file: log.dt_s for log in logs}.values())
    if np.ptp(intervals) <= SAME_INTERVAL * min(intervals):
        return None
    return float(np.median(intervals))


def _file_logs(path: Path, config: LogsConfig) -> list[Log]:
    file = open_log(path, config)
    digest = file.sha256()
    growing: dict[str, _Growing] = {}
    for block, last in _with_last(file.large_blocks()):
        counts = file.counted()
        for engine, rows in block.items():
            first = engine not in growing
            if first:
                source = Source(str(path), digest, engine)
                growing[engine] = _Growing(_stream(file, rows), source, file.name)
            stream = growing[engine].stream
            for entry in file.head_entries(len(rows["time_s"])):
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


def _stream(file: LogFile | Flight, rows: Rows) -> GridStream:
    """Return the stream of an engine that begins with `rows`, which decide on the rate."""
    name, config = str(file.path), file.config
    passed = Passed(hourly=file.hourly)
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
