"""The numbered data sets that the paper's studies run on: one log is one data set."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from data_prep.clean import clean
from data_prep.hold import hold_inputs
from data_prep.log import FloatArray, Log
from data_prep.logs_config import LogsConfig
from data_prep.prepare import prepare
from data_prep.reading import read_logs
from eval.preparation import Prepared, study
from eval.reproduce.pieces import trained_on_pieces
from narxcal.errors import DataError
from training.config import RunConfig
from training.pipeline import Split, configured_files, split_logs

FEWEST = 3
CONDITION = ("dT_C", "ALT_ft", "Mach")
# Beside the logs: outputs without sensors, and records of what the paper left open.
TRUTH = "truth"
FAMILIES = {
    "throttle_rate": "throttle rate varied",
    "take_off_approach": "take-off and approach",
}


@dataclass(frozen=True, eq=False)
class DataSets:
    """All data sets in order of their numbers, each with what `prepare` found in it.

    `truth` maps a log's name to its outputs without sensors, where a virtual engine wrote them;
    it is empty for real flights. `further` are prepared logs of the families that the paper left
    open, named `FAMILY/FILE`. Paths of `config` are relative to `base`.
    """

    config: RunConfig
    base: Path
    raw: tuple[Log, ...]
    prepared: tuple[Prepared, ...]
    truth: Mapping[str, Log]
    further: tuple[Log, ...] = ()

    @property
    def logs(self) -> tuple[Log, ...]:
        """Prepared logs, masked samples still NaN."""
        return tuple(one.log for one in self.prepared)

    @cached_property
    def cleaned(self) -> tuple[Log, ...]:
        """Logs as `prepare` has them before it smooths."""
        return tuple(clean(log, self.config.clean) for log in self.raw)

    @cached_property
    def split(self) -> Split:
        """Prepared logs with masked inputs held, divided as [split] says."""
        return split_logs(_held(self.logs, self.config), self.config.split)

    @cached_property
    def whole_split(self) -> Split:
        """As `split`, with the further records."""
        every = _held((*self.logs, *self.further), self.config)
        return split_logs(every, self.config.split)

    @cached_property
    def training(self) -> Split:
        """`split` with its training logs cut into the segments round their events."""
        return trained_on_pieces(self.split, self.config.events)

    @property
    def tests(self) -> tuple[Log, ...]:
        """Test logs as `evaluate` takes them: masked inputs still NaN."""
        names = {log.name for log in self.split.test}
        return tuple(log for log in self.logs if log.name in names)

    @property
    def further_tests(self) -> tuple[Log, ...]:
        """The test logs among the further records."""
        names = {log.name for log in self.whole_split.test}
        return tuple(log for log in self.further if log.name in names)

    @property
    def inputs(self) -> tuple[str, ...]:
        """The paper's four inputs, lever first, as far as every log has them."""
        wanted = (self.config.events.driver, *CONDITION)
        return tuple(name for name in wanted if all(name in log.channels for log in self.logs))

    @property
    def speeds(self) -> tuple[str, ...]:
        """The spool speeds among the outputs."""
        return tuple(name for name in self.config.narx.outputs if name in ("N1_pct", "N2_pct"))

    def number(self, name: str) -> int:
        """Number of a data set by its log's name, from 1."""
        return [log.name for log in self.logs].index(name) + 1

    def label(self, name: str) -> str:
        """`No. 5`."""
        return f"No. {self.number(name)}"

    def labels(self, logs: Sequence[Log]) -> str:
        """`1, 2, 3`."""
        return ", ".join(str(self.number(log.name)) for log in logs)


def read_data_sets(config: RunConfig, base: Path) -> DataSets:
    """Read and prepare the logs of `config`, numbered by file name as a person counts.

    A folder `truth` beside them may hold files of the same names with the outputs without
    sensors, and the folders of `FAMILIES` further records. Raises `DataError` for fewer logs
    than three, for a split without test logs, for logs without a spool speed, and for a truth
    that does not fit its log.
    """
    files = sorted(configured_files(config, base), key=counted)
    folder = files[0].parent
    raw = tuple(log for file in files for log in read_logs(file, config.logs))
    if len(raw) < FEWEST:
        raise DataError(
            f"the studies take at least {FEWEST} data sets, found {len(raw)}",
            file=folder,
            hint="One log of one engine is one data set; name more in [logs] files",
        )
    known = {log.name: log for log in _read_truth(config, files)}
    for log in raw:
        _check_truth(log, known.get(log.name))
    prepared = tuple(study(log, config) for log in raw)
    further = tuple(log for name in FAMILIES for log in _family(config, folder / name))
    found = DataSets(config, base, raw, prepared, known, further)
    _check(found, folder)
    return found


def _check(data: DataSets, folder: Path) -> None:
    outputs = ", ".join(data.config.narx.outputs)
    if not data.speeds:
        raise DataError(
            f"the studies are about N1 and N2, and the outputs are {outputs}",
            file=folder,
            hint="Name a spool speed in [narx] outputs",
        )
    if not data.split.test:
        raise DataError(
            "no data set is held out for the test",
            file=folder,
            hint=f"Set [split] test; logs are {', '.join(log.name for log in data.raw)}",
        )


def _family(config: RunConfig, folder: Path) -> list[Log]:
    """Prepared logs of one family of further records; none where there is no such folder."""
    if not folder.is_dir():
        return []
    files = sorted(configured_files(as_config(config, folder), folder), key=counted)
    logs = prepare([log for file in files for log in read_logs(file, config.logs)], config)
    return [replace(log, name=f"{folder.name}/{log.name}") for log in logs]


def counted(file: Path) -> tuple[tuple[int, int, str], ...]:
    """Sort key that puts `set_10` behind `set_9`."""
    parts = re.findall(r"\d+|\D+", file.name)
    return tuple((0, int(part), "") if part.isdigit() else (1, 0, part) for part in parts)


def numbered(data: DataSets, wanted: Sequence[int]) -> tuple[Log, ...]:
    """Logs of the given numbers; where one is missing, as many from the end of the list."""
    logs = _held(data.logs, data.config)
    if max(wanted) <= len(logs):
        return tuple(logs[number - 1] for number in wanted)
    return tuple(logs[-len(wanted) :])


def truth_of(data: DataSets, log: Log, channel: str) -> FloatArray | None:
    """Noise-free values `(time,)` on the raster of `log`, None where they are not known."""
    known = data.truth.get(log.name)
    return known[channel] if known is not None and channel in known.channels else None


def as_config(config: RunConfig, folder: Path) -> RunConfig:
    """`config` with the logs taken from `folder`."""
    logs = config.logs.model_copy(update={"folder": str(folder.resolve())})
    return config.model_copy(update={"logs": logs})


def _held(logs: Sequence[Log], config: RunConfig) -> list[Log]:
    return [hold_inputs(log, config.steady_state.inputs) for log in logs]


def _read_truth(config: RunConfig, files: Sequence[Path]) -> list[Log]:
    """Outputs without sensors, as far as they were written."""
    paths = [file.parent / TRUTH / file.name for file in files]
    canonical = LogsConfig(raster_hz=config.logs.raster_hz)
    return read_logs([path for path in paths if path.is_file()], canonical)


def _check_truth(log: Log, truth: Log | None) -> None:
    if truth is None:
        return
    if len(truth) != len(log) or not np.allclose(truth.time_s, log.time_s, atol=0.1 * log.dt_s):
        raise DataError(
            f"the truth has {len(truth)} samples from {truth.time_s[0]:g} s, its log {len(log)} "
            f"from {log.time_s[0]:g} s",
            file=truth.source.file,
            hint="Write both from one flight",
        )
