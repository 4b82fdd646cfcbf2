"""What Python users call, and what it gives: frozen results with tables and a drawing.

    data = read("flights/*.csv", "mine.toml")
    prepared = prepare(data)        # events, ranking of channels
    model = train(data, out="run")  # the run folder of `narxcal train`
    judged = evaluate(model)        # on the logs that were held out

Each computes what the command of its name does. Tables are data frames, units are in their
columns' names or those of the channels. A log of a result is `result[0]` or `result["flight_3*"]`.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass
from fnmatch import fnmatch
from functools import cached_property
from glob import glob, has_magic
from pathlib import Path
from typing import Protocol, TypeAlias, TypeVar

import pandas as pd
from matplotlib.figure import Figure

from data_prep.log import Log
from data_prep.reading import read_logs
from eval.judging.evaluate import Evaluation
from eval.judging.evaluate import evaluate as evaluate_logs
from eval.judging.log_evaluation import LogEvaluation, assess_log
from eval.judging.outcome import Outcome
from eval.preparation import (
    LogReport,
    cautions_about,
    events_table,
    pearson_table,
    reports,
    windows_table,
)
from eval.report.figures import overlay_figure, recorded_figure
from eval.report.tables import Shown, Summary
from eval.report.view import LogView, view_of
from eval.run_logs import logs_of, run_config
from narxcal.calibration.bundle import Bundle, load_bundle, save_bundle
from narxcal.calibration.run_record import ScreeningRecord
from narxcal.support.errors import ConfigError, DataError
from narxcal.support.progress import Progress, silent
from training.config import RunConfig, load_config
from training.methods import TrainOptions
from training.pipeline import calibrate, configured_files, doubts, read_split
from training.records import Split

Files: TypeAlias = str | Path | Sequence[str | Path]


class _Named(Protocol):
    @property
    def name(self) -> str: ...


T = TypeVar("T", bound=_Named)


def _item(items: Sequence[T], key: int | str) -> T:
    """One log by its place, or by its name or a pattern of it; raises `DataError`."""
    if isinstance(key, str):
        found = [one for one in items if key == one.name or fnmatch(one.name, key)]
    else:
        found = list(items[key : key + 1 or None])
    if not found:
        names = ", ".join(one.name for one in items)
        raise DataError(f"there is no log {key!r}", hint=f"There are {len(items)}: {names}")
    return found[0]


def _canvas() -> Figure:
    """A figure of pyplot, which notebooks and `pyplot.show` display."""
    from matplotlib import pyplot as plt  # noqa: PLC0415 - pages open no window

    return plt.figure()


def _audit(logs: Sequence[Log]) -> pd.DataFrame:
    rows = [
        {"log": log.name, "channel": one.channel, "action": one.action, "reason": one.reason,
         "samples": one.samples}
        for log in logs for one in log.audit.entries
    ]  # fmt: skip
    return pd.DataFrame(rows, columns=["log", "channel", "action", "reason", "samples"])


@dataclass(frozen=True, eq=False, repr=False)
class Recordings(Shown):
    """Logs as read, with the configuration that says how: `logs` one of each engine and part."""

    logs: tuple[Log, ...]
    config: RunConfig
    base: Path
    files: tuple[Path, ...]

    def __len__(self) -> int:
        return len(self.logs)

    def __iter__(self) -> Iterator[Log]:
        return iter(self.logs)

    def __getitem__(self, log: int | str) -> Log:
        return _item(self.logs, log)

    @property
    def audit(self) -> pd.DataFrame:
        """What was changed between files and logs: log, channel, action, reason, samples."""
        return _audit(self.logs)

    def plot(self, log: int | str = 0) -> Figure:
        """Draw every channel of one log over time."""
        return recorded_figure(self[log], _canvas())

    @property
    def summary(self) -> Summary:
        """What shells and notebooks show."""
        rows = [
            {"log": one.name, "minutes": len(one) * one.dt_s / 60.0, "dt_s": one.dt_s,
             "channels": ", ".join(one.channels)}
            for one in self.logs
        ]  # fmt: skip
        return Summary(f"{len(self)} logs as read", (), pd.DataFrame(rows))


class _Drawn(Shown):
    """A result whose logs are drawn."""

    @property
    @abstractmethod
    def views(self) -> tuple[LogView, ...]:
        """The logs as they are drawn."""

    def __getitem__(self, log: int | str) -> LogView:
        return _item(self.views, log)

    def plot(self, log: int | str = 0) -> Figure:
        """Draw one log: driver with its events, and outputs, with the model's free run if any."""
        return overlay_figure(self[log], _canvas())


@dataclass(frozen=True, eq=False, repr=False)
class PreparedLogs(_Drawn):
    """Logs cleaned and smoothed, with what was found in each."""

    reports: tuple[LogReport, ...]

    def __len__(self) -> int:
        return len(self.reports)

    @cached_property
    def views(self) -> tuple[LogView, ...]:
        """The logs as they are drawn."""
        return tuple(one.view() for one in self.reports)

    @property
    def events(self) -> pd.DataFrame:
        """Pushes (label 0) and pulls (1): log, start, times, levels, kind."""
        return events_table(self.reports)

    @property
    def ranking(self) -> pd.DataFrame:
        """Pearson coefficient of every input and output: log, input, output, rho, strong."""
        return pearson_table(self.reports)

    @property
    def windows(self) -> pd.DataFrame:
        """What moving averages of several widths take from each channel."""
        return windows_table(self.reports)

    @property
    def audit(self) -> pd.DataFrame:
        """What was changed: log, channel, action, reason, samples."""
        return _audit([one.log for one in self.reports])

    @property
    def cautions(self) -> list[str]:
        """What a reader of the tables has to know."""
        return cautions_about(self.reports)

    @property
    def summary(self) -> Summary:
        """What shells and notebooks show."""
        rows = [{"log": one.log.name, **one.counts()} for one in self.reports]
        return Summary(f"{len(self)} prepared logs", self.cautions, pd.DataFrame(rows))


@dataclass(frozen=True, eq=False, repr=False)
class Training(_Drawn):
    """A trained model, in `bundle`, and the logs that it was made of."""

    bundle: Bundle
    split: Split
    cautions: tuple[str, ...]

    @property
    def scores(self) -> pd.DataFrame:
        """A row per output: RMSE in free run over training logs, and over held-out ones (mean)."""
        record = self.bundle.record
        fit = {} if record.free_run is None else record.free_run.rmse
        table = pd.DataFrame({"rmse": fit})
        if record.held_out is not None and not record.held_out.fitted:
            table["held_out_rmse"] = pd.DataFrame(record.held_out.rmse).mean()
        return table.rename_axis("channel")

    @property
    def faults(self) -> pd.DataFrame:
        """Faults found in the training logs, as `data_prep.log.Finding` describes them."""
        return pd.DataFrame((self.bundle.record.screening or ScreeningRecord()).findings)

    @cached_property
    def views(self) -> tuple[LogView, ...]:
        """The training logs with the model's free run, as they are drawn."""
        settings = run_config(self.bundle)[1]
        return _views(
            self.bundle, (assess_log(self.bundle, log, settings) for log in self.split.train)
        )

    def save(self, folder: str | Path, *, replace: bool = False) -> None:
        """Write the run folder that the commands take; `ConfigError` for one that has content."""
        save_bundle(folder, self.bundle, replace)

    @property
    def summary(self) -> Summary:
        """What shells and notebooks show."""
        return Summary(self.bundle.calibration.words, self.cautions, self.scores)


@dataclass(frozen=True, eq=False, repr=False)
class Judgement(_Drawn):
    """A model's evaluation, with the verdict in `outcome`."""

    bundle: Bundle
    evaluation: Evaluation
    cautions: tuple[str, ...]

    @property
    def outcome(self) -> Outcome:
        """Pass, fail or open, and why."""
        return self.evaluation.outcome

    @cached_property
    def views(self) -> tuple[LogView, ...]:
        """The logs with the model's free run, as they are drawn."""
        return _views(self.bundle, self.evaluation.logs)

    @property
    def scores(self) -> pd.DataFrame:
        """A row per log and output: RMSE in the channel's unit, fit in percent, baselines."""
        rows = [
            {"log": one.log.name, "role": one.role, "channel": name, **asdict(scores)}
            for one in self.evaluation.logs
            for name, scores in one.scores.items()
        ]
        return pd.DataFrame(rows).set_index(["log", "channel"])

    @property
    def events(self) -> pd.DataFrame:
        """A row per event and judged channel: Ti, Tt of flight and model, and the verdict."""
        rows = [
            {"log": one.log.name, **each.row()}
            for one in self.evaluation.logs
            for each in one.assessments
        ]
        return pd.json_normalize(rows)

    @property
    def faults(self) -> pd.DataFrame:
        """Faults found in the logs, as `data_prep.log.Finding` describes them."""
        return pd.DataFrame([each.row() for each in self.evaluation.findings])

    @property
    def summary(self) -> Summary:
        """What shells and notebooks show."""
        shown = self.scores[["role", "samples", "rmse", "fit_pct", "steady_state_rmse"]]
        words = {True: "Pass", False: "Fail", None: "Not assessed"}[self.outcome.passed]
        lines = [*self.outcome.lines, *self.cautions]
        return Summary(f"{words}: {self.outcome.headline}", lines, shown)


def _views(bundle: Bundle, logs: Iterable[LogEvaluation]) -> tuple[LogView, ...]:
    driver, inputs = run_config(bundle)[0].events.driver, bundle.calibration.input_names
    return tuple(view_of(one, driver, inputs) for one in logs)


def read(files: Files | None = None, config: str | Path | RunConfig | None = None) -> Recordings:
    """Read recordings as `config` says, a TOML file or a `RunConfig`.

    `files` are one or several, or a pattern such as `flights/*.csv`; by default those of [logs].
    Without `config` columns bear the canonical names of channels. Raises `DataError` for what the
    files hold and where there are none, `ConfigError` for a configuration that does not fit.
    """
    settings, base = config, Path()
    if isinstance(settings, str | Path):
        settings, base = load_config(settings)
    settings = settings or RunConfig()
    paths = configured_files(settings, base) if files is None else _listed(files)
    return Recordings(tuple(read_logs(paths, settings.logs)), settings, base, tuple(paths))


def _listed(files: Files) -> list[Path]:
    given = [files] if isinstance(files, str | Path) else list(files)
    found: list[Path] = []
    for one in map(str, given):
        matches = sorted(glob(one)) if has_magic(one) and not Path(one).exists() else [one]  # noqa: PTH207 - a pattern may begin anywhere
        if not matches:
            raise DataError("no file matches", file=one, hint="Name the logs, or a pattern of them")
        found += map(Path, matches)
    return found


def _recordings(data: Recordings | str | Path | RunConfig) -> Recordings:
    """Read the logs of a configuration, where that is given instead of them."""
    if isinstance(data, Recordings):
        return data
    if not isinstance(data, str | Path | RunConfig):
        raise ConfigError(
            f"expected recordings or a configuration, found {type(data).__name__}",
            hint='narxcal.read(files, "config.toml") reads recordings',
        )
    return read(config=data)


def prepare(data: Recordings | str | Path | RunConfig) -> PreparedLogs:
    """Leave out where the engine does not run, clean, smooth; find events and rank channels.

    As `narxcal prepare`; `data` may be the configuration whose logs are to be read. Raises
    `DataError` for a log without the driver or any output.
    """
    data = _recordings(data)
    return PreparedLogs(tuple(reports(list(data.logs), data.config)))


def train(
    data: Recordings | str | Path | RunConfig,
    *,
    out: str | Path | None = None,
    progress: Progress = silent,
) -> Training:
    """Calibrate a model on the logs that [split] of the configuration names.

    As `narxcal train`, or `identify` where [identify] names a method. `data` may be the
    configuration whose logs are to be read. `out` is a new folder for the run; `progress` is called
    with steps done, steps in all, and a word. Raises `DataError`, `ConfigError` as the command.
    """
    data = _recordings(data)
    split, said = read_split(data.config, data.files, progress, data.logs)
    bundle = calibrate(data.config, data.base, split, TrainOptions(progress))
    found = Training(bundle, split, (*said, *doubts(bundle.record)))
    if out is not None:
        found.save(out)
    return found


def evaluate(
    model: Training | Bundle | str | Path,
    data: Recordings | Files | None = None,
    *,
    trim: float | None = None,
    trust: bool = False,
) -> Judgement:
    """Judge a model in free run over whole logs: errors, Ti and Tt of every event, one verdict.

    `model` may be a run folder; `trust` opens one whose steady-state model runs code. `data` are
    read with the mapping of the run; by default they are the logs that it held out. `trim` is the
    first part of each log from which offsets are estimated, 0 to 1. Raises `DataError`,
    `ConfigError`, `ModelError` as the command.
    """
    if isinstance(model, str | Path):
        model = load_bundle(model, trust=trust)
    bundle = model.bundle if isinstance(model, Training) else model
    said: list[str] = []
    chosen = data.files if isinstance(data, Recordings) else None if data is None else _listed(data)
    logs = logs_of(bundle, chosen, None, said.append)
    found = evaluate_logs(bundle, logs, trim or None)
    return Judgement(bundle, found, (*said, *found.cautions))
