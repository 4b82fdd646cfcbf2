"""From a configuration to a calibrated model: the steps of `narxcal train`, in order."""

from __future__ import annotations

import hashlib
import os
import platform
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from data_prep.hold import hold_inputs
from data_prep.log import Log
from data_prep.prepare import prepare
from data_prep.reading import read_logs
from data_prep.recorded import recorded
from narxcal.calibration.bundle import Bundle
from narxcal.calibration.calibration import DynamicCalibration
from narxcal.calibration.noise import NoiseModel, estimate_noise
from narxcal.narx.config import NarxConfig
from narxcal.record import Record
from narxcal.steady.fitted import FittedSteadyState
from narxcal.steady.model import SteadyStateModel
from narxcal.support.errors import DataError
from training.baselines import fit_baselines
from training.checkpoint import fingerprint, read_checkpoint, write_checkpoint
from training.config import RunConfig
from training.lag_choice import chosen_lags
from training.network import (
    FitResult,
    HistoryRow,
    Material,
    Progress,
    fit_narx,
    merge_models,
    single_output,
)
from training.records import Split, deviation_record, lags, material, split_logs, structure_of
from training.steady_choice import steady_state
from training.steady_fit import SteadyQuality

__all__ = [
    "CHECKPOINT",
    "Split",
    "TrainOptions",
    "calibrate",
    "calibration_for",
    "configured_files",
    "deviation_record",
    "prepare_logs",
    "split_logs",
    "steady_state",
]

CHECKPOINT = "checkpoint-{}.safetensors"


@dataclass(frozen=True)
class TrainOptions:
    """How to run a training: who watches, where checkpoints go, whether to go on from them.

    `stage` is told in words what goes on before the network is trained, how much of it is done and
    how much there is.
    """

    watch: Any = None
    checkpoints: Path | None = None
    resume: bool = False
    stage: Callable[[str, int, int], None] = lambda _words, _done, _total: None


def configured_files(config: RunConfig, base: Path) -> list[Path]:
    """Paths that [logs] names, relative to the configuration's folder."""
    return config.logs.resolve(base)


def prepare_logs(config: RunConfig, files: Sequence[Path], dt_s: float | None = None) -> list[Log]:
    """Read, clean, smooth and complete the inputs of `files`, on the raster `dt_s` if given."""
    reading = config.logs
    if dt_s is not None:
        reading = reading.model_copy(update={"raster_hz": 1.0 / dt_s})
    logs = prepare(read_logs(files, reading), config)
    return [hold_inputs(log, config.steady_state.inputs) for log in logs]


def calibrate(
    config: RunConfig, base: Path, split: Split, options: TrainOptions | None = None
) -> Bundle:
    """Fit or load the steady-state model, train the network, estimate the fuser's noise.

    Raises `DataError` for logs of different rasters or with too little in them, `ConfigError`
    for a configuration that does not fit the logs.
    """
    began, options = time.perf_counter(), options or TrainOptions()
    dt_s = _common_raster([*split.train, *split.validate])
    split = split.with_outputs(config.narx.outputs)
    options.stage("fitting the steady state", 0, 1)
    steady, quality = steady_state(config, base, split.train)
    split = split.held(steady.input_names)
    meta = _meta(config, base, split)
    told = partial(options.stage, "choosing the lags")
    config, choice = chosen_lags(config, steady, split.train, told)
    options.stage("fitting the lags", 0, 1)
    lag = lags(config, steady, split.train)
    structure = structure_of(config)
    learned = material(config, steady, lag, (split.train, split.validate))
    results = _fit(config, learned, structure, options)
    network = merge_models([result.model for result in results])
    settle_s = config.narx.settle_s if config.narx.anchored and config.narx.settle_s > 0 else None
    plain = DynamicCalibration(steady, network, dt_s, config.narx.schedule, settle_s)
    calibration = plain.with_lag(lag)
    meta["steady_state"] = _quality_row(quality, steady)
    meta["lag_form"] = choice.row()
    meta["training"] = _training_row(results, time.perf_counter() - began)
    meta["fuser_noise"] = sensor_and_model_noise(calibration, split).to_dict()
    meta["baselines"] = fit_baselines(calibration, split.train)
    return Bundle(calibration, meta)


def calibration_for(calibration: DynamicCalibration, log: Log) -> DynamicCalibration:
    """The calibration as it holds for the engine of `log`."""
    return calibration.for_engine(log.source.engine)


def _common_raster(logs: Sequence[Log]) -> float:
    rasters = {round(log.dt_s, 6): log.name for log in logs}
    if len(rasters) > 1:
        found = ", ".join(f"{dt:g} s in {name}" for dt, name in sorted(rasters.items()))
        raise DataError(
            f"expected all logs on one raster, found {found}",
            hint="Set raster_hz in [logs]",
        )
    return logs[0].dt_s


def _fit(
    config: RunConfig, learned: Material, structure: NarxConfig, options: TrainOptions
) -> list[FitResult]:
    """One joint network, or one per output whose results are merged."""
    if config.narx.joint:
        return [_fit_one(config, learned, structure, (options, "joint"))]
    results = []
    for k, name in enumerate(config.narx.outputs):
        part = Material(
            [single_output(record, k) for record in learned.records],
            [single_output(record, k) for record in learned.validation],
            learned.dt_s,
            [single_output(record, k) for record in learned.rest],
        )
        results.append(_fit_one(config, part, structure, (options, name)))
    return results


def _fit_one(
    config: RunConfig,
    learned: Material,
    structure: NarxConfig,
    how: tuple[TrainOptions, str],
) -> FitResult:
    options, name = how
    file = None if options.checkpoints is None else options.checkpoints / CHECKPOINT.format(name)
    key = fingerprint(
        config.train.model_dump_json(),
        structure.model_dump_json(),
        *(_record_hash(record) for record in learned.records),
        "validation",
        *(_record_hash(record) for record in learned.validation),
    )

    def watch(progress: Progress) -> None:
        if file is not None:
            write_checkpoint(file, progress, key)
        if options.watch is not None:
            options.watch(progress)

    resume = None
    if options.resume and file is not None and file.is_file():
        resume = read_checkpoint(file, key)
    return fit_narx(learned, structure, config.train, watch, resume)


def _record_hash(record: Record) -> str:
    """Of shapes and numbers; the name is left out, for a file may move."""
    shapes = f"{record.u.shape} {record.y.shape}".encode()
    return hashlib.sha256(shapes + record.u.tobytes() + record.y.tobytes()).hexdigest()


def sensor_and_model_noise(calibration: DynamicCalibration, split: Split) -> NoiseModel:
    """Fuser noise from logs the network was not fitted to, where there are any.

    They are smoothed, and what a fuser is given online is not: of the sensors' noise the
    likelihood only sees what smoothing left, so that what it took away is the least there is.
    """
    outputs = calibration.output_names
    logs = split.validate or split.train
    if any(not any(recorded(log, [name]) for log in logs) for name in outputs):
        logs = (*split.validate, *split.train)
    measured, predicted = [], []
    for log in logs:
        own = calibration_for(calibration, log)
        measured.append(log.matrix(own.output_names))
        predicted.append(own.simulate(log.matrix(own.input_names), measured[-1][0]))
    found = estimate_noise(measured, predicted, calibration.dt_s)
    taken = [_taken(name, logs) for name in outputs]
    return replace(found, measurement=np.maximum(found.measurement, taken))


def _taken(name: str, logs: Sequence[Log]) -> float:
    """Variance of the noise that smoothing took away, over the logs that record the channel."""
    found = [log.noise.get(name, 0.0) for log in logs if recorded(log, [name])]
    return float(np.mean(found))


def _meta(config: RunConfig, base: Path, split: Split) -> dict[str, Any]:
    parts = {"train": split.train, "validate": split.validate, "test": split.test}
    logs = [log for part in parts.values() for log in part]
    return {
        "config": config.model_dump(mode="json", by_alias=True),
        "base": str(base),
        "split": {name: [log.name for log in part] for name, part in parts.items()},
        "data": {log.source.file: log.source.sha256 for log in logs},
        "seeds": [config.train.seed + k for k in range(config.train.starts)],
        "hardware": {
            "machine": platform.machine(),
            "system": platform.system(),
            "cores": os.cpu_count(),
        },
    }


def _quality_row(quality: SteadyQuality | None, steady: SteadyStateModel) -> dict[str, Any]:
    if quality is None or not isinstance(steady, FittedSteadyState):
        return {"fitted": False}
    layout = steady.layout
    return {
        "fitted": True,
        "samples": quality.samples,
        "rms": quality.rms,
        "coverage": quality.coverage,
        "corrected": layout.corrected,
        "blend": list(layout.blend),
        "switches": list(layout.switches),
    }


def _training_row(results: Sequence[FitResult], wall_s: float) -> dict[str, Any]:
    return {
        "status": "; ".join(sorted({result.status for result in results})),
        "score": [result.score for result in results],
        "wall_s": wall_s,
        "history": [[_history_row(row) for row in result.history] for result in results],
    }


def _history_row(row: HistoryRow) -> dict[str, Any]:
    return {
        "start": row.start,
        "horizon_s": row.horizon_s,
        "iteration": row.iteration,
        "loss": row.loss,
        "validation": row.validation if np.isfinite(row.validation) else None,
    }
