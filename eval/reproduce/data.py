"""Data sets of the paper's studies: read, flown, cut into segments, and networks fitted to them.

One log of one engine is one data set, numbered from 1. The flights are the user's, or those of the
virtual engine with its steady-state model as a table.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from data_prep.cleaning.clean import clean
from data_prep.config import LogsConfig
from data_prep.events import PUSH, Event, EventsConfig, find_events
from data_prep.log import Log
from data_prep.prepare import hold_inputs, prepare
from data_prep.reading import read_logs
from eval.preparation import LogReport, examine
from narxcal.export import ExportOptions, export_table
from narxcal.export.grid import Grid
from narxcal.flight_test.fly import WriteOptions, load_scenario, write_flights
from narxcal.flight_test.scenario import FlightScenario
from narxcal.narx.config import NarxConfig
from narxcal.narx.network import NarxModel
from narxcal.record import Record
from narxcal.steady.opening import open_steady
from narxcal.support.arrays import FloatArray
from narxcal.support.errors import ConfigError, DataError
from narxcal.support.parallel import in_processes
from training.config import RunConfig, TrainConfig
from training.dynamics.network import Material, fit_narx
from training.folds import Segment
from training.pipeline import configured_files
from training.records import Split, rest_records, split_logs

LEAD_S = 3.0


def pieces(log: Log, config: EventsConfig) -> list[Segment]:
    """Cut a log into one piece per event, from `LEAD_S` before it to its end; they never overlap.

    The samples between events, long stretches in equilibrium, belong to none. Events are those of
    the whole log, on the ground too.
    """
    found, last = [], 0
    lead = round(LEAD_S / log.dt_s)
    for event in find_events(log, config.model_copy(update={"condition": ""})):
        piece = Segment(log, max(last, event.start - lead), event.stop, (event,))
        found.append(Segment(piece.log, 0, len(piece.log), piece.own_events))
        last = event.stop
    return found


def cut(logs: Sequence[Log], config: EventsConfig) -> tuple[Log, ...]:
    """Pieces of all logs as logs of their own; a log without events stays whole."""
    return tuple(part for log in logs for part in [one.log for one in pieces(log, config)] or [log])


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
    """All data sets in order of their numbers, each with its report of `prepare`.

    `truth` maps a log's name to its outputs without sensors, where a virtual engine wrote them;
    it is empty for real flights. `further` are prepared logs of the families that the paper left
    open, named `FAMILY/FILE`. Paths of `config` are relative to `base`.
    """

    config: RunConfig
    base: Path
    raw: tuple[Log, ...]
    prepared: tuple[LogReport, ...]
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
        return replace(self.split, train=cut(self.split.train, self.config.events))

    @property
    def tests(self) -> tuple[Log, ...]:
        """Test logs as `evaluate` takes them: masked inputs still NaN."""
        return self._tests(self.logs, self.split)

    @property
    def further_tests(self) -> tuple[Log, ...]:
        """The test logs among the further records."""
        return self._tests(self.further, self.whole_split)

    def _tests(self, logs: Sequence[Log], split: Split) -> tuple[Log, ...]:
        names = {log.name for log in split.test}
        return tuple(log for log in logs if log.name in names)

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

    A folder `truth` next to them may hold files of the same names with the outputs without
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
    prepared = tuple(examine(log, config) for log in raw)
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
    files = sorted(configured_files(config.with_logs_in(folder), folder), key=counted)
    found = prepare(read_logs(files, config.logs), config)
    return [replace(one.log, name=f"{folder.name}/{one.log.name}") for one in found]


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
    """Noise-free values `(time,)` on the sampling grid of `log`, None where they are not known."""
    known = data.truth.get(log.name)
    return known[channel] if known is not None and channel in known.channels else None


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


SCENARIO = "narx_paper"
TABLE = "maker.csv"
# Of the further records, one engine of a few flights is enough: all are twenty hours of flight.
FURTHER: Mapping[str, Mapping[str, object]] = {
    "throttle_rate": {"records": "throttle_rate", "engines": ("left",), "flights": 4},
    "take_off_approach": {"records": "take_off_approach", "engines": ("left",)},
}
_ROWS = 24_000
_START = {
    "TRA_deg": (0.0, 20.0, 40.0, 60.0, 85.0),
    "ALT_ft": (-1000.0, 0.0, 10_000.0, 20_000.0, 30_000.0, 36_089.0, 40_000.0),
    "Mach": (0.0, 0.3, 0.6, 0.85),
    "dT_C": (-30.0, -5.0, 20.0),
    "WOW": (0.0, 1.0),
    "Approach": (0.0, 1.0),
    "ECS": (1.0,),
    "NAI": (0.0,),
    "WAI": (0.0,),
}


def paper_scenario(seed: int) -> FlightScenario:
    """The shipped scenario at another seed, with an engine that equals its steady-state model.

    Build tolerance between engines of one type is a static error of the steady-state model. The
    paper's model was of the very engines flown; for build tolerance see `evaluate --trim`.
    """
    outputs = ("N1_pct", "N2_pct", "EGT_C", "FF_kgph")
    changed = {"seed": seed, "build_scatter_pct": 0.0, "outputs": outputs}
    return load_scenario(SCENARIO).model_copy(update=changed)


def write_records(folder: Path, scenario: FlightScenario, jobs: int = 1) -> None:
    """Write the scenario's logs with their truth, and each further family in a folder below.

    The same scenario, the same bytes.
    """
    write_flights(folder, scenario, WriteOptions(jobs, true_channels=True))
    for name, changed in FURTHER.items():
        table = {**scenario.model_dump(by_alias=True, exclude_unset=True), **changed}
        write_flights(folder / name, FlightScenario.parse(table, name), WriteOptions(jobs))


def flown(config: RunConfig, base: Path, folder: Path) -> RunConfig:
    """The configuration with the logs of `folder` and the steady-state model as a table there.

    Solving the gas path for every sample of every log would take longer than all the studies.
    Raises `ConfigError` for an input that the flights
    do not have, and as `open_steady`.
    """
    section, outputs = config.steady_state, config.narx.outputs
    model = open_steady(
        section.kind, section.source, (section.inputs, outputs), base, section.options
    )
    grid = Grid({name: _nodes(name) for name in section.inputs})
    options = ExportOptions(max_rows=_ROWS, tolerance_pct=0.1, source=section.source)
    export_table(model, grid, folder / TABLE, options)
    return with_table(config.with_logs_in(folder), folder)


def with_table(config: RunConfig, folder: Path) -> RunConfig:
    """The configuration with the steady-state model that `flown` wrote into `folder`."""
    varying = tuple(name for name in config.steady_state.inputs if len(_nodes(name)) > 1)
    source = str((folder / TABLE).resolve())
    return config.having(steady_state={"kind": "table", "source": source, "inputs": varying})


def _nodes(name: str) -> tuple[float, ...]:
    if name not in _START:
        raise ConfigError(
            "[steady_state] inputs names what the virtual flights do not have",
            channel=name,
            hint=f"They have {', '.join(_START)}; or bring logs by --data",
        )
    return _START[name]


class Effort(NamedTuple):
    """`iterations` (one per horizon of [train]) and `splits` replace those of the configuration.

    Empty iterations keep the configuration's. `jobs` is the number of processes; no number
    depends on it.
    """

    iterations: tuple[int, ...] = ()
    splits: int = 10
    jobs: int = 1


class NetworkFit(NamedTuple):
    """One network to fit: its records, its structure and the sampling interval."""

    records: Sequence[Record]
    structure: NarxConfig
    dt_s: float


def within(config: RunConfig, effort: Effort) -> RunConfig:
    """`config` with the effort's iterations, as many as it has horizons."""
    if not effort.iterations:
        return config
    count = len(config.train.horizons_s)
    return config.having(train={"iterations": (effort.iterations * count)[:count]})


def fit_all(tasks: Sequence[NetworkFit], config: RunConfig, jobs: int) -> list[NarxModel]:
    """Fit one network per task, in processes of one thread each; the order is kept.

    A structure with fixed equilibrium (`moving` > 0) is also trained on settling records, as in
    `train`.
    """
    train = config.train.model_copy(update={"threads": 1})
    return list(in_processes(partial(_fit, train=train), tasks, jobs))


def _fit(task: NetworkFit, train: TrainConfig) -> NarxModel:
    steps, moving = round(train.rest_s / task.dt_s), task.structure.moving
    rest = rest_records(task.records, moving, steps, train.seed) if moving and steps > 1 else []
    return fit_narx(Material(task.records, [], task.dt_s, rest), task.structure, train).model


PHASES = ("ground", "take-off", "climb", "cruise", "descent", "approach")
SPEEDS = ("fast", "slow", "small")
_VERTICAL_FTPM = 500.0  # the aircraft's own instrument calls less than this level
_AVERAGED_S = 30.0
_HIGH_SHARE = 0.7  # of the lever's range: more is taken as take-off power


def phase_of(log: Log, event: Event, driver: str) -> str:
    """Name the phase by what the log says where the lever starts to move.

    With weight on wheels: take-off where the lever goes up beyond 70 % of its range in the log,
    else ground. In the air: approach where the approach discrete is set; else climb or descent
    by more than 500 ft/min over half a minute, and cruise otherwise. Channels that the log
    lacks tell nothing.
    """
    if _at(log, "WOW", event.start) > 0.5:
        lever = log[driver]
        high = np.nanmin(lever) + _HIGH_SHARE * (np.nanmax(lever) - np.nanmin(lever))
        return "take-off" if event.label == PUSH and event.lever_after > high else "ground"
    if _at(log, "Approach", event.start) > 0.5:
        return "approach"
    rate = _vertical_ftpm(log, event.start)
    if abs(rate) <= _VERTICAL_FTPM:
        return "cruise"
    return "climb" if rate > 0.0 else "descent"


def _at(log: Log, name: str, row: int) -> float:
    return float(np.nan_to_num(log[name][row])) if name in log.channels else 0.0


def _vertical_ftpm(log: Log, row: int) -> float:
    """Mean climb rate round `row`, 0 where the altitude is not known."""
    if "ALT_ft" not in log.channels:
        return 0.0
    half = max(1, round(0.5 * _AVERAGED_S / log.dt_s))
    altitude: FloatArray = log["ALT_ft"][max(0, row - half) : row + half + 1]
    known = np.flatnonzero(np.isfinite(altitude))
    if len(known) < 2:
        return 0.0
    climbed_ft = float(altitude[known[-1]] - altitude[known[0]])
    return 60.0 * climbed_ft / (float(known[-1] - known[0]) * log.dt_s)
