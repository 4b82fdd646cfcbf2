"""Files too large to hold: read block by block, so that only the logs themselves take memory.

Rows go onto the raster as they come (`data_prep.raster_stream`), with the rules and the audit of
`data_prep.reading`. What a file alone can tell, its own rate, is taken from its first rows.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from data_prep.file_units import head_entries, sources_of
from data_prep.log import Log
from data_prep.mapping import constants, map_columns, to_channel
from data_prep.raster_stream import RasterStream
from data_prep.shared_stamps import usual_interval
from data_prep.stamps import Passed, all_apart, clock_goes_on, ordered_rows
from narxcal.errors import DataError

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping
    from pathlib import Path

    from data_prep.log import Audit, BoolArray, FloatArray, Source
    from data_prep.logs_config import ColumnSource, LogsConfig
    from data_prep.mapping import Table
    from data_prep.raster_stream import Piece

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
