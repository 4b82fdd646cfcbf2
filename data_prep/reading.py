"""From flight-test files to logs: every recording of every engine on a uniform raster."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from data_prep.csv_source import open_csv, readable
from data_prep.derive import derive
from data_prep.file_units import head_entries, sources_of
from data_prep.large import is_large, large_logs
from data_prep.log import Audit, AuditEntry, Log, Source
from data_prep.logs_config import LogsConfig
from data_prep.mapping import Table, constants, map_columns, read_columns, to_channel
from data_prep.parquet_source import MAGIC, ParquetSource
from data_prep.raster import Raster, drawn, lay, resample
from data_prep.shared_stamps import usual_interval
from data_prep.stamps import (
    Passed,
    Rows,
    all_apart,
    clock_goes_on,
    ordered_rows,
    split_at_gaps,
    undo_rounding,
)
from narxcal.channels import CHANNELS
from narxcal.errors import DataError

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from data_prep.log import BoolArray, FloatArray

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
    the raster as `data_prep.raster.resample` states; the audit of each log holds every row and
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
