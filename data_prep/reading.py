"""From flight-test files to logs: every recording of every engine on a uniform raster.

Files too large to hold: read block by block, so that only the logs themselves take memory.

Rows go onto the raster as they come (`data_prep.stream`), with the rules and the audit of
`data_prep.reading`. What a file alone can tell, its own rate, is taken from its first rows.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from data_prep.columns import constants, head_entries, map_columns, sources_of, to_channel
from data_prep.log import Log
from data_prep.stamps import Passed, all_apart, clock_goes_on, ordered_rows, usual_interval
from data_prep.stream import RasterStream
from narxcal.support.arrays import BoolArray, FloatArray
from narxcal.support.errors import DataError

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping
    from pathlib import Path

    from data_prep.columns import Table
    from data_prep.config import ColumnSource, LogsConfig
    from data_prep.log import Audit, Source
    from data_prep.stream import Piece
import hashlib
from dataclasses import replace
from pathlib import Path

from data_prep.columns import Table, read_columns
from data_prep.config import LogsConfig
from data_prep.csv_source import open_csv, readable
from data_prep.derive import derive
from data_prep.grid import Raster, drawn, lay, resample
from data_prep.log import Audit, AuditEntry, Source
from data_prep.parquet_source import MAGIC, ParquetSource
from data_prep.stamps import (
    Rows,
    split_at_gaps,
    undo_rounding,
)
from narxcal.channels import CHANNELS

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence


LARGE_BYTES = 200_000_000
_COMPRESSED = 5  # times as much text as bytes
# A blank is bridged across blocks up to the time that the stream remembers.
LONGEST_BRIDGE_S = 5.0
_MOST_SAMPLES = 1000  # per row
_GROWTH = 500_000  # samples by which a channel grows


def is_large(path: Path, config: LogsConfig) -> bool:
    """Whether `path` is better read block by block."""
    size = path.stat().st_size * (_COMPRESSED if path.suffix == ".gz" else 1)
    return size > LARGE_BYTES and config.bridge_s <= LONGEST_BRIDGE_S


def large_logs(table: Table, config: LogsConfig, origins: Mapping[str, Source]) -> list[Log]:
    """Logs of every engine, whose `origins` (engine -> source) are given.

    Raises `DataError` as `data_prep.read_logs` does.
    """
    columns = map_columns(table, config)
    sources = sources_of(table, config)
    names = list({name: None for each in columns.values() for name in each.values()})
    engines: dict[str, _Engine] = {}
    for cells in table.blocks(names):
        for engine, mapped in columns.items():
            rows = _channels(cells, mapped, sources)
            first = engine not in engines
            if first:
                dt_s = _interval(rows, config, table)
                stream = RasterStream(
                    config,
                    dt_s,
                    LONGEST_BRIDGE_S,
                    str(table.path),
                    constants(sources),
                    hourly=table.hourly,
                )
                engines[engine] = _Engine(stream, origins[engine], table.path.name)
            stream = engines[engine].stream
            for entry in head_entries(table, config, len(rows["time_s"])):
                if first or entry.channel != "*":
                    stream.audit.count(entry.channel, entry.action, entry.reason, entry.samples)
            engines[engine].take(stream.push(rows))
    if not engines:
        raise DataError("no rows follow the header", file=table.path)
    return [log for engine in engines.values() for log in engine.finished()]


def _channels(
    cells: Mapping[str, FloatArray], mapped: Mapping[str, str], sources: Mapping[str, ColumnSource]
) -> dict[str, FloatArray]:
    return {name: to_channel(name, cells[column], sources[name]) for name, column in mapped.items()}


def _interval(rows: Mapping[str, FloatArray], config: LogsConfig, table: Table) -> float:
    file, passed = str(table.path), Passed(hourly=table.hourly)
    stamps, _, _ = clock_goes_on(rows["time_s"], config.max_gap_s, passed=passed)
    found = ordered_rows(stamps, config.max_gap_s, file)
    channels = {name: values[found.order] for name, values in rows.items() if name != "time_s"}
    native = usual_interval(found.time_s, channels, file)
    interval = 1.0 / config.raster_hz if config.raster_hz else native
    if native > _MOST_SAMPLES * interval:
        raise DataError(
            f"rows {native:.4g} s apart would become samples at {1 / interval:.4g} Hz",
            file=file,
            channel="time_s",
            hint="Check the unit of time_s and set [logs] raster_hz",
        )
    return interval


class _Grown:
    """Values that are added block by block, in one array whose memory grows with them."""

    def __init__(self) -> None:
        self._values = np.empty(0)
        self._used = 0

    def add(self, block: FloatArray) -> None:
        """Append `block` `(time,)`."""
        needed = self._used + len(block)
        if needed > len(self._values):
            # Moved by the system page by page, so that old and new never both take memory.
            self._values.resize(needed + _GROWTH, refcheck=False)
        self._values[self._used : needed] = block
        self._used = needed

    def taken(self) -> FloatArray:
        """All of it `(time,)`; nothing can be added after that."""
        self._values.resize(self._used, refcheck=False)
        return self._values


@dataclass
class _Engine:
    """Logs of one engine as they grow."""

    stream: RasterStream
    source: Source
    file: str
    logs: list[Log] = field(default_factory=list)
    columns: dict[str, _Grown] = field(default_factory=dict)
    drawn: dict[str, list[BoolArray]] = field(default_factory=dict)

    def take(self, pieces: Iterable[Piece]) -> None:
        """Add samples; one that begins a recording ends the one before."""
        for piece in pieces:
            if piece.starts:
                self._finish(self.stream.ended)
            for name, block in {"time_s": piece.time_s, **piece.channels}.items():
                self.columns.setdefault(name, _Grown()).add(block)
            for name, flags in piece.drawn.items():
                self.drawn.setdefault(name, []).append(flags)

    def finished(self) -> Iterator[Log]:
        """All logs, after the last row."""
        self.take(self.stream.push({}, last=True))
        self._finish(self.stream.audit.taken())
        if not self.logs:
            raise all_apart(self.stream.config.max_gap_s, self.source.file)
        yield from self.logs

    def _finish(self, audit: Audit) -> None:
        columns, self.columns = self.columns, {}
        drawn, self.drawn = self.drawn, {}
        if not columns:
            return
        number = f"#{len(self.logs) + 1}" if self.logs else ""
        engine = f":{self.source.engine}" if self.source.engine else ""
        channels = {name: column.taken() for name, column in columns.items()}
        time_s = channels.pop("time_s")
        joined = {name: np.concatenate(parts) for name, parts in drawn.items()}
        between = {name: flags for name, flags in joined.items() if flags.any()}
        name = f"{self.file}{engine}{number}"
        self.logs.append(Log(name, time_s, channels, audit, self.source, drawn=between))


__all__ = ["LogsConfig", "open_table", "read_logs"]


@dataclass(frozen=True)
class _Recording:
    """One engine of one file: its channels row by row, before the raster."""

    name: str
    source: Source
    rows: Mapping[str, FloatArray]
    constants: Mapping[str, float]
    entries: tuple[AuditEntry, ...] = ()  # of what stands above the rows
    hourly: bool = False  # whether its clock shows no hours


def read_logs(
    files: str | Path | Sequence[str | Path], config: LogsConfig | None = None
) -> list[Log]:
    """Read recordings into logs: file by file, engine by engine, part by part.

    Channels are canonical `(time,)` float64, NaN where missing; derived channels are included.
    Rows are put in order of time, split where they are more than `max_gap_s` apart, and laid on
    the raster as `data_prep.grid.resample` states; the audit of each log holds every row and
    sample that was dropped, moved, filled or left missing. Files of more than 200 MB are read block
    by block, so that only the logs themselves take memory. `folder` and `files` of `config` are
    not used here.

    Raises `DataError` (file, channel, row) for what the files hold, `ConfigError` for a
    configuration that cannot apply to them.
    """
    config = config or LogsConfig()
    paths = [files] if isinstance(files, str | Path) else list(files)
    return [log for path in paths for log in _file_logs(Path(path), config)]


def _file_logs(path: Path, config: LogsConfig) -> list[Log]:
    table = open_table(path, config)
    if is_large(path, config):
        digest = _sha256(path)
        engines = config.engines or {"": ""}
        origins = {engine: Source(str(path), digest, engine) for engine in engines}
        return large_logs(table, config, origins)
    recordings = _recordings(path, table, config)
    return [log for recording in recordings for log in _logs(recording, config)]


def _recordings(path: Path, table: Table, config: LogsConfig) -> list[_Recording]:
    columns = map_columns(table, config)
    sources = sources_of(table, config)
    names = list({name: None for each in columns.values() for name in each.values()})
    cells = read_columns(table, names)
    digest = _sha256(path)
    entries = head_entries(table, config, len(next(iter(cells.values()))))
    return [
        _Recording(
            f"{path.name}:{engine}" if engine else path.name,
            Source(str(path), digest, engine),
            {name: to_channel(name, cells[each], sources[name]) for name, each in mapped.items()},
            constants(sources),
            entries,
            table.hourly,
        )
        for engine, mapped in columns.items()
    ]


def open_table(path: Path, config: LogsConfig) -> Table:
    """Open a CSV or Parquet file, told apart by their first bytes; raises `DataError`."""
    with readable(path), path.open("rb") as raw:
        magic = raw.read(len(MAGIC))
    if magic == MAGIC:
        return ParquetSource(path, config.time_column)
    return open_csv(path, config.delimiter, config.decimal, config.comment, config.time_column)


def _sha256(path: Path) -> str:
    with readable(path), path.open("rb") as raw:
        return hashlib.file_digest(raw, "sha256").hexdigest()


def _logs(recording: _Recording, config: LogsConfig) -> list[Log]:
    """Order and split the rows of one recording, and put each part on the raster."""
    file = recording.source.file
    rows = _in_order(recording, config.max_gap_s)
    logs, lost = _parts(recording, rows, config)
    if not logs:
        raise all_apart(config.max_gap_s, file)
    first = Audit().add(*recording.entries, *rows.entries, *lost)
    logs[0] = replace(logs[0], audit=Audit(first.entries + logs[0].audit.entries))
    return [log.with_channels(derive(log.channels, config.derive, file)) for log in logs]


def _in_order(recording: _Recording, max_gap_s: float) -> Rows:
    file, stamps = recording.source.file, recording.rows["time_s"]
    if not len(stamps):
        raise DataError("no rows follow the header", file=file)
    going_on, _, moved = clock_goes_on(stamps, max_gap_s, passed=Passed(hourly=recording.hourly))
    rows = ordered_rows(going_on, max_gap_s, file)
    if len(rows.time_s) < 2 or rows.time_s[0] == rows.time_s[-1]:
        raise DataError(
            f"expected samples at two or more times, found {min(1, len(rows.time_s))}",
            file=file,
            channel="time_s",
        )
    return replace(rows, entries=(*rows.entries, *moved))


def _parts(
    recording: _Recording, rows: Rows, config: LogsConfig
) -> tuple[list[Log], list[AuditEntry]]:
    """Logs between the gaps, and what was too short to be one."""
    channels = {
        name: values[rows.order] for name, values in recording.rows.items() if name != "time_s"
    }
    native = usual_interval(rows.time_s, channels, recording.source.file)
    interval = 1.0 / config.raster_hz if config.raster_hz else native
    logs: list[Log] = []
    lost: list[AuditEntry] = []
    for part in split_at_gaps(rows.time_s, config.max_gap_s):
        time = undo_rounding(rows.time_s[part], native)
        raster = lay(time, interval, config.bridge_s)
        _refuse_endless(raster, len(time), recording.source.file)
        if raster.samples < 2:
            lost.append(AuditEntry("*", "dropped", "lone row between gaps", len(time)))
            continue
        name = recording.name + (f"#{len(logs) + 1}" if logs else "")
        rebuilt = int((np.abs(time - rows.time_s[part]) > 0.01 * native).sum())
        entry = AuditEntry("*", "repaired", "rounded time stamp", rebuilt)
        logs.append(_part(recording, name, Rows(rows.order[part], time, (entry,)), raster))
    return logs, lost


def _refuse_endless(raster: Raster, rows: int, file: str) -> None:
    if raster.samples > 1000 * (rows + 10):
        raise DataError(
            f"{rows} rows would become {raster.samples} samples at {1 / raster.interval_s:.4g} Hz",
            file=file,
            channel="time_s",
            hint="Check the unit of time_s and set [logs] raster_hz",
        )


def _part(recording: _Recording, name: str, rows: Rows, raster: Raster) -> Log:
    channels: dict[str, FloatArray] = {}
    between: dict[str, BoolArray] = {}
    steps = raster.steps(rows.time_s)
    uneven = int((steps != np.round(steps)).sum())
    audit = Audit().add(
        *rows.entries, AuditEntry("*", "repaired", "time stamp off the raster", uneven)
    )
    for channel, values in recording.rows.items():
        if channel != "time_s":
            hold = CHANNELS[channel].role == "switch"
            picked = values[rows.order]
            channels[channel], entries = resample(channel, rows.time_s, picked, raster, hold=hold)
            audit = audit.add(*entries)
            flags = drawn(rows.time_s, picked, raster)
            if not hold and flags.any():
                between[channel] = flags
    for channel, value in recording.constants.items():
        channels[channel] = np.full(raster.samples, value)
        audit = audit.add(AuditEntry(channel, "filled", "constant of the config", raster.samples))
    return Log(name, raster.time_s, channels, audit, recording.source, drawn=between)
