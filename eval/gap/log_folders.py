"""Reads a folder of logs, one per file name, and pairs two folders by these names."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from data_prep.config import LogsConfig
from data_prep.log import Log
from data_prep.reading import open_table, read_logs
from narxcal.support.errors import DataError
from training.config import RunConfig

SUFFIXES = (".csv.gz", ".csv")
_NO_SPLIT_S = 1e7  # a gap is masked, not the end of a log


def read_folder(folder: Path, config: RunConfig | None = None) -> dict[str, Log]:
    """Read every CSV file of a folder; names without ending -> log, in order of name.

    Hidden files, which some systems leave beside copied ones, are no logs. A file with several
    engines gives `NAME_ENGINE` for each. Raises `DataError`.
    """
    if not folder.is_dir():
        what = "is a file" if folder.exists() else "does not exist"
        raise DataError(f"the folder of the logs {what}", file=folder)
    files = sorted(file for file in folder.iterdir() if _is_log(file))
    if not files:
        raise DataError("the folder holds no .csv or .csv.gz", file=folder)
    found: dict[str, Log] = {}
    for file in files:
        for log in read_logs(file, _reading(file, config)):
            name = _stem(file) + (f"_{log.source.engine}" if log.source.engine else "")
            if name in found:
                raise DataError("two files have one name", file=file, hint="Remove one of them")
            found[name] = log
    return found


def pair_up(
    flown: Mapping[str, Log], simulated: Mapping[str, Log], folders: tuple[Path, Path]
) -> Mapping[str, Log]:
    """Check that both folders hold the same names; returns the simulated logs."""
    for here, there, folder in (
        (flown, simulated, folders[1]),
        (simulated, flown, folders[0]),
    ):
        lone = [name for name in here if name not in there]
        if lone:
            raise DataError(
                f"'{lone[0]}' has no partner here ({len(lone)} of {len(here)} logs have none)",
                file=folder,
                hint="Recorded and simulated logs are paired by their file names",
            )
    return simulated


def _reading(file: Path, config: RunConfig | None) -> LogsConfig:
    """Canonical headers are read as such, others by the configuration."""
    logs = LogsConfig() if config is None else config.logs
    header = set(open_table(file, logs).header)
    if {"time_s", "N1_pct"} <= header or not logs.columns:
        logs = LogsConfig(bridge_s=logs.bridge_s, delimiter=logs.delimiter, decimal=logs.decimal)
    return logs.model_copy(update={"max_gap_s": _NO_SPLIT_S, "raster_hz": logs.raster_hz})


def _is_log(file: Path) -> bool:
    return file.name.lower().endswith(SUFFIXES) and not file.name.startswith(".")


def _stem(file: Path) -> str:
    name = file.name
    return next(name[: -len(end)] for end in SUFFIXES if name.lower().endswith(end))
