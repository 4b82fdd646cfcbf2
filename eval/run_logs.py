"""Logs as the configuration that a run holds reads them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pandas as pd
from pydantic import Field

from data_prep.cleaning.identity import duplicates
from data_prep.log import Finding, Log
from data_prep.prepare import prepare, with_outputs
from data_prep.reading import read_logs
from data_prep.sources.grid import joined
from eval.judging.trim import TrimConfig
from narxcal.calibration.bundle import Bundle
from narxcal.support.errors import DataError, ModelError
from narxcal.support.settings import Section
from training.config import RunConfig
from training.folds import CrossvalConfig
from training.records import split_logs
from training.responses.transients import TransientsConfig
from training.screening.redundancy import Bank
from training.screening.screen import screened


class EvaluateConfig(Section):
    """Table [evaluate]: how events are judged, what trim may assume, what has to be reached.

    `crossval` says which divisions cross-validation makes.

    `least_passed_pct` of the assessed events have to pass. `largest_rmse` (channel -> value in
    its unit) bounds the RMSE pooled over the logs; none is bounded by default. `least_events`
    pushes and pulls and `least_judged_pct` of each output are the least evidence of a pass
    (`eval.judging.evidence`).
    """

    transients: TransientsConfig = TransientsConfig()
    trim: TrimConfig = TrimConfig()
    crossval: CrossvalConfig = CrossvalConfig()
    least_passed_pct: float = Field(default=95.0, ge=0.0, le=100.0)
    largest_rmse: Mapping[str, float] = Field(default_factory=dict)
    least_events: int = Field(default=3, ge=0)
    least_judged_pct: float = Field(default=90.0, ge=0.0, le=100.0)

    @property
    def changed(self) -> dict[str, tuple[Any, Any]]:
        """Settings that differ from their defaults, but for `crossval`: name -> value, default."""
        own, default = (
            pd.json_normalize(one.model_dump(mode="json")).to_dict("records")[0]
            for one in (self, EvaluateConfig())
        )
        pairs = {str(name): (own.get(name), default.get(name)) for name in {**default, **own}}
        return {
            name: pair
            for name, pair in pairs.items()
            if pair[0] != pair[1] and not name.startswith("crossval.")
        }


def run_config(bundle: Bundle) -> tuple[RunConfig, EvaluateConfig]:
    """The configuration stored in a bundle; `ModelError` where there is none."""
    stored = bundle.record.config
    if not stored:
        raise ModelError(
            "the bundle does not say how its logs were prepared", hint="Train it with narxcal train"
        )
    config = RunConfig.parse(stored, "bundle.json")
    return config, EvaluateConfig.parse(config.evaluate, "bundle.json, [evaluate]")


def evaluation_logs(bundle: Bundle, files: Sequence[Path] | None = None) -> list[Log]:
    """Read `files` with the column mapping of the bundle, cleaned and smoothed as for training.

    Without `files`, the configured test logs (all configured ones where the split leaves none).
    Masked inputs and outputs that a file lacks stay NaN. Raises `DataError` for a file without any
    output.
    """
    config, _ = run_config(bundle)
    return screened(bank_of(bundle), _prepared(bundle, config, files))


def recorded_logs(bundle: Bundle, files: Sequence[Path]) -> list[Log]:
    """As `evaluation_logs`, on the same rows, but not smoothed and not screened for faults."""
    config, _ = run_config(bundle)
    return _prepared(bundle, config.having(smooth={"window": 1}), files)


def _prepared(bundle: Bundle, config: RunConfig, files: Sequence[Path] | None) -> list[Log]:
    outputs = bundle.calibration.output_names
    reading = config.logs.for_inputs(bundle.calibration.input_names)
    reading = reading.every(bundle.calibration.dt_s)
    chosen: Sequence[Log]
    if files is not None:
        chosen = read_logs(list(files), reading)
    else:
        logs = read_logs(config.logs.resolve(Path(bundle.record.base)), reading)
        chosen = split_logs(logs, config.split).test or logs
    prepared = joined([one.log for one in prepare(chosen, config)])
    return [with_outputs(log, outputs) for log in prepared]


def file_findings(bundle: Bundle, file: Path) -> tuple[Finding, ...]:
    """What the logs in a file show; raises `DataError` as `evaluation_logs`.

    Raises `DataError`, too, for an input of the model that is at fault throughout.
    """
    logs = evaluation_logs(bundle, [file])
    found = tuple(each for log in logs for each in log.findings)
    for log in logs:
        after = log.without_faults()
        for name in bundle.calibration.input_names:
            if name in log.channels and log.recorded([name]) and not after.recorded([name]):
                why = next(each for each in log.findings if name in each.channels)
                raise DataError(
                    f"an input of the model is at fault throughout ({why.kind}: {why.evidence})",
                    file=log.name,
                    channel=name,
                    hint="Correct its column or unit under [logs.columns], or repair the log",
                )
    return found


def bank_of(bundle: Bundle) -> Bank | None:
    """The bank that the bundle's training logs taught; None for a bundle without one."""
    stored = bundle.record.redundancy
    return Bank.from_json(stored) if stored else None


def logs_of(
    bundle: Bundle, files: Sequence[Path] | None, data: Path | None, warn: Callable[[str], None]
) -> list[Log]:
    """Read `files`, or the held-out logs of a run; `data` says where the latter are now.

    Warns of a held-out log whose file has changed since the training. Raises `DataError`.
    """
    if files:
        return _distinct(evaluation_logs(bundle, _once(files, warn)), warn)
    logs = _distinct(_held_out(bundle, data), warn)
    if not bundle.record.logs("test"):
        warn("no log was held out: these are logs that the model was trained on")
    for text in changed_files(bundle, logs):
        warn(text)
    return logs


def _once(files: Sequence[Path], warn: Callable[[str], None]) -> list[Path]:
    """Each file once: a log that is judged twice would count twice in pooled figures."""
    chosen = list({file.resolve(): file for file in files}.values())
    if len(chosen) < len(files):
        warn("a file that is named twice is read once")
    return chosen


def _distinct(logs: list[Log], warn: Callable[[str], None]) -> list[Log]:
    """Each recording once, under whatever names it is stored."""
    found = duplicates(logs)
    for shared in found:
        warn(f"{shared.words}; it counts once")
    return [log for log in logs if log.name not in {shared.log for shared in found}]


def changed_files(bundle: Bundle, logs: Sequence[Log]) -> list[str]:
    """Warnings about logs whose files have changed since the training."""
    known = {Path(file).name: digest for file, digest in bundle.record.data.items()}
    found = {log.source.file: log.source.sha256 for log in logs}
    return [
        f"{file}: the file has changed since the training: sha256 was "
        f"{known[Path(file).name][:12]}, is {digest[:12]}"
        for file, digest in found.items()
        if known.get(Path(file).name, digest) != digest
    ]


def _held_out(bundle: Bundle, data: Path | None) -> list[Log]:
    try:
        return evaluation_logs(_moved(bundle, data) if data else bundle)
    except DataError as error:
        if not (error.hint or "").startswith(("Set [logs] folder", "Set [logs] files")):
            raise
        hint = "Name their folder by --data, or other logs by --logs"
        raise DataError(error.problem, file=error.file, hint=hint) from None


def _moved(bundle: Bundle, data: Path) -> Bundle:
    config = bundle.record.config
    logs = {**config.get("logs", {}), "folder": str(data.resolve())}
    return replace(bundle, record=bundle.record.having(config={**config, "logs": logs}))
