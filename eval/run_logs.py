"""Logs as the configuration that a run holds reads them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from pydantic import Field

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
