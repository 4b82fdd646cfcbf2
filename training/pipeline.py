"""The order of the steps of `narxcal train`: each takes values and returns one result.

logs -> split -> masks -> steady state -> lags -> network -> mixture -> noise -> bundle

Steady state, lags, network and mixture are the method's (`training.methods`); the rest is the same
for all.
"""

from __future__ import annotations

import os
import platform
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from fnmatch import fnmatch
from functools import partial
from pathlib import Path
from typing import Any, Final, TypeVar

import numpy as np
from threadpoolctl import threadpool_limits

from data_prep.cleaning.identity import refuse_duplicates
from data_prep.log import Finding, Log
from data_prep.prepare import cautions, hold_inputs, prepare
from data_prep.reading import read_logs, shared_interval_s
from narxcal.calibration.bundle import Bundle
from narxcal.calibration.calibration import Calibration
from narxcal.calibration.certificate import settling
from narxcal.calibration.noise import NoiseModel, estimate_noise
from narxcal.calibration.run_record import (
    DelayRecord,
    FitRecord,
    HeldOutRecord,
    IdentityRecord,
    RunRecord,
    ScreeningRecord,
    SteadyRecord,
)
from narxcal.intervals import HalfWidths, HeldErrors, joined
from narxcal.steady.fitted import FittedSteadyState
from narxcal.steady.model import SteadyStateModel
from narxcal.support.arrays import FloatArray, known_mean
from narxcal.support.errors import DataError
from narxcal.support.parallel import in_processes
from narxcal.support.progress import Progress, silent
from training.config import RunConfig, SplitConfig
from training.dynamics.baselines import Baselines, run_of
from training.dynamics.mixture import HeldRun
from training.folds import Plan
from training.methods import TrainOptions, method_of
from training.records import LEAST_WIDTHS, Split, split_logs
from training.screening.levels import prior_scatter
from training.screening.masking import training_data
from training.screening.redundancy import Bank
from training.steady.steady_fit import SteadyQuality

T = TypeVar("T")
# Scatter of recordings of a fleet, as a share of the tolerance that level checks allow. Its prior
# counts as two recordings. Chosen by one flown fleet and seven recorders; with a second fleet 0.35
# and 1.4 recordings are the most likely (`python -m eval.bench --fleets` of 2f9145a).
RECORDING_SCATTER: Final = 0.4


def configured_files(config: RunConfig, base: Path) -> list[Path]:
    """Paths that [logs] names, relative to the configuration's folder."""
    return config.logs.resolve(base)


def prepare_logs(config: RunConfig, files: Sequence[Path], dt_s: float | None = None) -> list[Log]:
    """Read and prepare `files`, with complete inputs, at the sampling interval `dt_s` if given."""
    reading = config.logs if dt_s is None else config.logs.every(dt_s)
    return _ready(read_logs(files, reading), config)


def _ready(raw: Sequence[Log], config: RunConfig) -> list[Log]:
    return [hold_inputs(one.log, config.steady_state.inputs) for one in prepare(raw, config)]


def read_split(
    config: RunConfig,
    files: Sequence[Path],
    progress: Progress = silent,
    raw: Sequence[Log] = (),
) -> tuple[Split, list[str]]:
    """Read and prepare `files` and split them as [split] says; also returns what to warn of.

    `raw` are the logs in them where they have been read. Logs of different sampling intervals are
    all read at the median one. Raises `DataError`, also for recordings that two sets share.
    """
    said: list[str] = []
    logs = _ready(raw, config)
    for number, file in enumerate(() if raw else files):
        progress(number, len(files), file.name)
        logs += prepare_logs(config, [file])
    dt_s = shared_interval_s(logs)
    if dt_s is not None:
        said.append(f"sampling intervals differ between logs: all are read every {dt_s:g} s")
        logs = prepare_logs(config, files, dt_s)
    split = split_logs(logs, config.split)
    refuse_duplicates(
        (*split.train, *split.validate, *split.test), "a model would be judged on what it learned"
    )
    said += _left_out(logs, split, config.split)
    return split, [*said, *cautions(logs, config, config.narx.outputs)]


def doubts(record: RunRecord) -> list[str]:
    """What to say of the faults of the logs to learn from, and of logs that no model follows."""
    found = record.screening or ScreeningRecord()
    said = [Finding.from_row(row).caution for row in found.findings]
    for row in found.logs:
        parts = [f"{count} samples of {name}" for name, count in row.masked.items()]
        if row.left_out_rows:
            parts.append(f"{row.left_out_rows} of {row.rows} rows")
        if parts:
            said.append(f"{row.log}: not learned from {', '.join(parts)}")
    return [*said, *record.doubtful_logs]


def _left_out(logs: Sequence[Log], split: Split, config: SplitConfig) -> list[str]:
    """What to say of patterns in [split] that name no log, and of logs that are in no set."""
    patterns = {"train": config.train, "validate": config.validate_, "test": config.test}
    said = [
        f"[split] {part} = '{pattern}' matches no log"
        for part, chosen in patterns.items()
        for pattern in chosen
        if not any(fnmatch(log.name, pattern) for log in logs)
    ]
    used = {log.name for log in (*split.train, *split.validate, *split.test)}
    unused = [log.name for log in logs if log.name not in used]
    if unused:
        said.append(f"not used, for no pattern in [split] matches: {', '.join(unused)}")
    return said


def calibrate(
    config: RunConfig, base: Path, split: Split, options: TrainOptions | None = None
) -> Bundle:
    """Fit or load the steady-state model, identify the dynamics, estimate the fuser's noise.

    Faults of the logs to learn from are masked first (`training.screening.masking`).

    The bundle's `config` is the resolved one, in which nothing is "auto"; `configured` is the one
    given.

    Raises `DataError` for logs of different sampling intervals, with too little in them, or of
    which a fault leaves nothing,
    `ConfigError` for a configuration that does not fit the logs.
    """
    # The matrices are small: threads of the numerical libraries would wait for each other and for
    # ours, several times as long as one takes, and round otherwise than in the command.
    with threadpool_limits(limits=1):
        return _calibrated(config, base, split, options or TrainOptions())


def _calibrated(config: RunConfig, base: Path, split: Split, options: TrainOptions) -> Bundle:
    began = time.perf_counter()
    _check_interval([*split.train, *split.validate])
    identities = _identities(split)
    options.progress(0, 1, "comparing the logs with each other")
    learned = training_data(split, config, screen=not options.screened)
    options.progress(0, 1, "fitting the steady state")
    found = method_of(config)(config, base, learned, options)
    steady_fit, split, entries = found.steady_fit, found.steady_fit.split, found.entries
    options.progress(0, 1, "holding inputs constant")
    lags = Baselines.from_json(entries["baselines"]).lags(found.calibration.dt_s)
    reach = input_reach(split.train, found.calibration.input_names)
    calibration, certificate, lost = settling(found.calibration.with_input_limits(*reach), lags)
    # Where only a decay bound was added, the held-out runs without it stand in.
    mixture = found.mixture
    if mixture is not None:
        lead = bool(lost) and calibration.members.members == lags
        mixture = mixture.by_lags(lost[-1]) if lead else mixture
        entries = {**entries, "mixture": mixture.row()}
    held = (mixture.free_runs if mixture else ()) or free_runs(calibration, split.validate)
    trained = free_runs(calibration, split.train)
    training = {
        **entries["training"],
        "status": "; ".join([entries["training"]["status"], *lost]),
        "wall_s": time.perf_counter() - began,
    }
    record = RunRecord(
        **_provenance(config, base, split),
        config=steady_fit.config.model_dump(mode="json", by_alias=True),
        steady_state=_steady_record(steady_fit.quality, steady_fit.steady),
        **{**entries, "training": training},
        free_run=free_run_fit(calibration, trained),
        fuser_noise=fuser_noise(calibration, split, held, trained).to_dict(),
        screening=ScreeningRecord.parse(steady_fit.learned.row()),
        redundancy=redundancy_of(calibration, learned.bank),
        certificate=certificate,
        identities=identities,
        held_out=_held_out_record(calibration, held or trained, fitted=not held),
        delay=DelayRecord(found=steady_fit.late.delay, ln_error=steady_fit.late.errors),
    )
    interval = interval_of(held, calibration.output_names)
    return Bundle(calibration.with_interval(interval).with_delay(steady_fit.late.delay), record)


def input_reach(logs: Sequence[Log], names: Sequence[str]) -> tuple[FloatArray, FloatArray]:
    """Where inputs saturate (n_in,): one width beyond the training logs, within physical ranges.

    Of the air it is `LEAST_WIDTHS` at least: corrected parameters carry a model that far.
    """
    seen = [np.concatenate([log[name] for log in logs]) for name in names]
    low, high = (np.array([end(values) for values in seen]) for end in (np.nanmin, np.nanmax))
    width = np.maximum(high - low, [LEAST_WIDTHS.get(name, 0.0) for name in names])
    known = [logs[0].channel(name) for name in names]
    least, most = np.array([(one.low, one.high) for one in known]).T
    beyond = np.maximum(low - width, least), np.minimum(high + width, most)
    return np.minimum(low, beyond[0]), np.maximum(high, beyond[1])


def redundancy_of(calibration: Calibration, bank: Bank | None) -> dict[str, Any] | None:
    """The bank that `evaluate` and `replay` check logs by, with the channels that are used."""
    names = {*calibration.output_names, *calibration.input_names}
    if bank is None:
        return None
    return replace(bank, used=tuple(n for n in bank.channels if n in names)).to_json()


def free_run_fit(calibration: Calibration, trained: Sequence[HeldRun]) -> FitRecord:
    """Samples, RMSE per output and AIC of the free runs over the training logs.

    AIC = sum_j N_j ln mse_j + 2 (parameters + outputs), with errors taken as white: compare it
    between models of the same logs and outputs alone. None where an output has no error.
    """
    error = np.concatenate([one.model - one.measured for one in trained])
    count = np.isfinite(error).sum(axis=0)
    mse = np.nanmean(error**2, axis=0)
    names = calibration.output_names
    penalty = 2.0 * (calibration.size + len(names))
    return FitRecord(
        samples=dict(zip(names, count.tolist(), strict=True)),
        rmse=dict(zip(names, np.sqrt(mse).tolist(), strict=True)),
        parameters=calibration.size,
        aic=float(count @ np.log(mse) + penalty) if (mse > 0.0).all() else None,
    )


def calibration_for(calibration: Calibration, log: Log) -> Calibration:
    """Calibration for the engine of `log`."""
    return calibration.for_engine(log.source.engine, or_mean=True)


def _check_interval(logs: Sequence[Log]) -> None:
    intervals = {round(log.dt_s, 6): log.name for log in logs}
    if len(intervals) > 1:
        found = ", ".join(f"{dt:g} s in {name}" for dt, name in sorted(intervals.items()))
        raise DataError(
            f"expected all logs at one sampling interval, found {found}",
            hint="Set raster_hz in [logs]",
        )


def free_runs(calibration: Calibration, logs: Sequence[Log]) -> tuple[HeldRun, ...]:
    """Free runs over `logs` from their first measured outputs."""
    found = []
    for log in logs:
        own = calibration_for(calibration, log)
        run = run_of(own, log)
        model = own.simulate(log.matrix(own.input_names), run.measured[0])
        inside = np.asarray(own.steady.inside(log.matrix(own.input_names)))
        found.append(
            HeldRun(run.steady, model, run.measured, log.source.file, whole=True, inside=inside)
        )
    return tuple(found)


def _held_errors(held: Sequence[HeldRun]) -> list[tuple[HeldRun, FloatArray]]:
    """Held-out runs that stand for other recordings, and their errors (time, outputs).

    Recordings that were held out whole show how days and engines differ, and count alone where
    there are any. Of regions only what lies within the envelope of the rest counts: beyond it
    samples are marked, and nothing is promised.
    """
    whole = [one for one in held if one.whole]
    return [
        (one, np.where(one.whole | one.inside[:, None], one.model - one.measured, np.nan))
        for one in whole or held
    ]


def interval_of(held: Sequence[HeldRun], names: Sequence[str]) -> HalfWidths | None:
    """Half-widths over the distance from steady state; None without held-out measurements."""
    if not held:
        return None
    found = [
        HeldErrors(np.abs(one.steady - one.model), errors, one.piece, one.whole)
        for one, errors in _held_errors(held)
    ]
    typical = np.nan_to_num(known_mean(np.concatenate([np.abs(one.measured) for one in held])))
    pairs = zip(names, typical.tolist(), strict=True)
    scatter = [RECORDING_SCATTER * prior_scatter(*pair) for pair in pairs]
    return joined(found, np.array(scatter))


def fuser_noise(
    calibration: Calibration, split: Split, held: Sequence[HeldRun], trained: Sequence[HeldRun]
) -> NoiseModel:
    """Estimate the fuser's noise from held-out free runs, with those over training logs if need be.

    The logs are smoothed, while online the fuser gets raw measurements: the measurement noise is
    therefore at least what smoothing removed.
    """
    outputs = calibration.output_names
    measured = np.concatenate([one.measured for one in held]) if held else np.full((1, 1), np.nan)
    if not np.isfinite(measured).any(axis=0).all():
        held = [*held, *trained]
    found = estimate_noise(
        [one.measured for one in held], [one.model for one in held], calibration.dt_s
    )
    removed = [_smoothed_away(name, (*split.validate, *split.train)) for name in outputs]
    return replace(found, measurement_variance=np.maximum(found.measurement_variance, removed))


def _smoothed_away(name: str, logs: Sequence[Log]) -> float:
    """Variance of the noise that smoothing removed, over the logs that record the channel."""
    found = [log.noise.get(name, 0.0) for log in logs if log.recorded([name])]
    return float(np.mean(found))


def _provenance(config: RunConfig, base: Path, split: Split) -> dict[str, Any]:
    """Where a calibration comes from: configuration, logs with their hashes, seeds, machine."""
    parts = {"train": split.train, "validate": split.validate, "test": split.test}
    logs = [log for part in parts.values() for log in part]
    return {
        "configured": config.model_dump(mode="json", by_alias=True),
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


def _identities(split: Split) -> tuple[IdentityRecord, ...]:
    """What the logs to learn from are recognised by, before anything of them is masked."""
    parts = {"train": split.train, "validate": split.validate}
    return tuple(
        IdentityRecord.parse(
            {
                "log": log.name,
                "file": log.source.file,
                "sha256": log.source.sha256,
                "engine": log.source.engine,
                "role": role,
                **log.identity.to_json(),
            }
        )
        for role, logs in parts.items()
        for log in logs
    )


def _held_out_record(
    calibration: Calibration, held: Sequence[HeldRun], *, fitted: bool
) -> HeldOutRecord:
    """Errors on held-out logs, or on those `fitted` to."""
    runs = _held_errors(held)
    error = [np.sqrt(known_mean(errors**2)) for _, errors in runs]
    columns = zip(calibration.output_names, np.stack(error).T.tolist(), strict=True)
    return HeldOutRecord(
        logs=tuple(one.piece for one, _ in runs), fitted=fitted, rmse=dict(columns)
    )


def _steady_record(quality: SteadyQuality | None, steady: SteadyStateModel) -> SteadyRecord:
    if quality is None or not isinstance(steady, FittedSteadyState):
        return SteadyRecord(fitted=False)
    layout = steady.layout
    return SteadyRecord(
        fitted=True,
        samples=quality.samples,
        rms=dict(quality.rms),
        coverage=quality.coverage,
        corrected=layout.corrected,
        blend=layout.blend,
        switches=layout.switches,
        exponents=layout.exponents,
        assumed=layout.assumed,
    )


def run_plans(
    plans: Sequence[Plan],
    config: RunConfig,
    base: Path,
    judge: Callable[[Bundle, Plan], T],
    jobs: int = -1,
) -> Iterator[T]:
    """Calibrate once per plan and yield what `judge` makes of it, in the order of the plans.

    Logs are prepared and screened, masked inputs still NaN. Plans run in parallel processes of one
    thread each (all cores by default); the numbers do not depend on `jobs`.
    `judge` has to be a function of a module, and what it returns must be small.
    """
    single = config.having(train={"threads": 1})
    task = partial(_run_plan, config=single, base=base, judge=judge)
    return in_processes(task, plans, jobs)


def _run_plan(plan: Plan, config: RunConfig, base: Path, judge: Callable[[Bundle, Plan], T]) -> T:
    train, test = (tuple(part.log for part in parts) for parts in (plan.train, plan.test))
    options = TrainOptions(screened=True)
    return judge(calibrate(config, base, Split(train, (), test), options), plan)
