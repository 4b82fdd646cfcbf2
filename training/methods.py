"""Methods of identification: each fits a steady state and the dynamics behind it.

| [identify] method | steady state | dynamics |
|---|---|---|
| narx | fitted or the maker's | lags, network, choice between them and simple models |
| output-error, transfer, subspace | the same | `training.papers.identify` |
| static:NAME | the law of that name | none |

A training of networks writes its progress after every step to a safetensors file: the arrays as
they are, everything else as one JSON text in its header.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from hashlib import sha256
from pathlib import Path
from typing import Any, Final, Protocol

import numpy as np
from numpy.typing import NDArray
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save as save_arrays

from data_prep.log import Log
from narxcal.calibration.calibration import Calibration
from narxcal.calibration.dynamic import DynamicCalibration
from narxcal.calibration.identified import IdentifiedCalibration
from narxcal.lumped.engine import LumpedEngine
from narxcal.narx.network import NarxModel
from narxcal.record import Record
from narxcal.steady.model import SteadyStateModel
from narxcal.support.errors import ModelError
from narxcal.support.files import atomic_write_bytes
from narxcal.support.progress import Progress, silent
from training.config import STATIC, RunConfig
from training.dynamics.baselines import fit_baselines
from training.dynamics.lags import choose_form, fit_lags
from training.dynamics.mixture import Mixture, choose_mixture, network_alone
from training.dynamics.network import (
    FitResult,
    HistoryRow,
    Material,
    TrainingState,
    fit_narx,
    merge_models,
)
from training.dynamics.optimisers import Damping, Moments
from training.dynamics.transport import DelayChoice, choose_delay, delayed
from training.papers.identify import Identified, output_error, static_laws, subspace_model, transfer
from training.records import Split, material, structure_of
from training.screening.masking import TrainingData
from training.steady.steady_choice import contradicting, steady_state, with_layout, without
from training.steady.steady_fit import SteadyQuality

CHECKPOINT = "checkpoint-{}.safetensors"
_CHECKPOINT_SCHEMA = "narxcal.checkpoint/1"


@dataclass(frozen=True)
class TrainOptions:
    """How to run a training: who shows progress, where checkpoints go, whether to resume from them.

    `screened` logs have the faults that
    `training.screening.masking.cross_screen` finds, such as parts of logs that were screened
    whole.
    """

    progress: Progress = silent
    checkpoints: Path | None = None
    resume: bool = False
    screened: bool = False


@dataclass(frozen=True, eq=False)
class SteadyFit:
    """A steady state, the logs `split` it was fitted to, with complete inputs, and its settings.

    Nothing of the steady state is "auto" any more in `config`.
    `learned` says what of the logs was left out, `late` which delay of the driver was taken off.
    `quality` is None of a steady state that was not fitted.
    """

    config: RunConfig
    learned: TrainingData
    split: Split
    steady: SteadyStateModel
    quality: SteadyQuality | None = None
    late: DelayChoice = field(default_factory=DelayChoice)


@dataclass(frozen=True, eq=False)
class Identification:
    """A calibration, its steady state, entries in the record of the run, and who leads it."""

    steady_fit: SteadyFit
    calibration: Calibration
    entries: Mapping[str, Any]
    mixture: Mixture | None = None


class Method(Protocol):
    """Identify a calibration from logs; raises `DataError` for logs that do not determine it."""

    def __call__(
        self, config: RunConfig, base: Path, learned: TrainingData, options: TrainOptions
    ) -> Identification:
        """`base` is the folder that paths of `config` are relative to."""
        ...


def method_of(config: RunConfig) -> Method:
    """The method that [identify] names."""
    name = config.identify.method
    return _METHODS[STATIC if name.startswith(STATIC) else name]


def _fit_steady(
    config: RunConfig, base: Path, learned: TrainingData, progress: Progress
) -> SteadyFit:
    """Fit or open the steady state, without logs that contradict the others and without delay."""
    split = learned.split.with_outputs(config.narx.outputs)
    chosen = with_layout(config, split.train)
    outlying = contradicting(chosen, split.train)
    if outlying:
        split = replace(split, train=without(split.train, outlying))
        chosen = with_layout(config, split.train)
    learned = replace(learned, split=split, contradicting=tuple(outlying))
    steady, quality = steady_state(chosen, base, split.train)
    split = split.held(steady.input_names)
    late = choose_delay(chosen, steady, split.train, progress)
    if late.delay is not None:
        split = split.changed(lambda log: delayed(log, late.delay))
        steady, quality = steady_state(chosen, base, split.train)
    return SteadyFit(chosen, learned, split, steady, quality, late)


def _narx(
    config: RunConfig, base: Path, learned: TrainingData, options: TrainOptions
) -> Identification:
    """Fit lags and network, weigh them and simple models; the configuration has the lags' form."""
    steady_fit = _fit_steady(config, base, learned, options.progress)
    steady, split = steady_fit.steady, steady_fit.split
    config, choice = choose_form(steady_fit.config, steady, split.train, options.progress)
    steady_fit = replace(steady_fit, config=config)
    options.progress(0, 1, "fitting the lags")
    lag = fit_lags(config, steady, split.train)
    results = fit_networks(config, material(config, steady, lag, split), options)
    network = merge_models([result.model for result in results])
    calibration = _calibration(config, (steady, lag, network), split.train[0].dt_s)
    baselines = fit_baselines(calibration, split.train)
    whole = (calibration, baselines)
    mixture = _mixture(steady_fit, base, whole, options)
    entries = {
        "lag_form": choice.row(),
        "training": _training_row(results),
        "baselines": baselines,
    }
    weighed = mixture.applied(calibration, baselines)
    return Identification(steady_fit, weighed, entries, mixture)


def _mixture(
    steady_fit: SteadyFit,
    base: Path,
    whole: tuple[DynamicCalibration, dict[str, Any]],
    options: TrainOptions,
) -> Mixture:
    """Weights of all models in each output, by folds of the training logs and refits to each."""
    config, split = steady_fit.config, steady_fit.split
    calibration, _ = whole
    if config.train.choice_s == 0.0:
        return network_alone(calibration, "no choice: choice_s = 0")

    def refit(logs: Sequence[Log]) -> tuple[DynamicCalibration, dict[str, Any]]:
        part = Split(tuple(logs), split.validate, ())
        steady, _ = steady_state(config, base, part.train)
        lag = fit_lags(config, steady, part.train)
        results = fit_networks(config, material(config, steady, lag, part), TrainOptions())
        network = merge_models([result.model for result in results])
        found = _calibration(config, (steady, lag, network), calibration.dt_s)
        return found, fit_baselines(found, part.train)

    return choose_mixture(config, split.train, refit, whole, options.progress)


def _calibration(
    config: RunConfig, parts: tuple[SteadyStateModel, LumpedEngine | None, NarxModel], dt_s: float
) -> DynamicCalibration:
    steady, lag, network = parts
    section = config.narx
    settle_s = section.settle_s if section.anchored and section.settle_s > 0 else None
    return DynamicCalibration(steady, network, dt_s, section.schedule, settle_s).with_lag(lag)


def fit_networks(config: RunConfig, learned: Material, options: TrainOptions) -> list[FitResult]:
    """Train one joint network, or one for each output (see `merge_models`)."""
    parts = {"joint": learned}
    if not config.narx.joint:
        parts = {name: learned.of_output(k) for k, name in enumerate(config.narx.outputs)}
    total = len(parts) * config.train.starts * sum(config.train.iterations)
    return [
        _fit_network(config, part, name, _counted(options, k, len(parts), total))
        for k, (name, part) in enumerate(parts.items())
    ]


def _counted(options: TrainOptions, number: int, count: int, total: int) -> TrainOptions:
    """The options for one of several networks, whose steps are counted over all of them."""
    before = number * total // count
    return replace(
        options,
        progress=lambda done, _total, what="": options.progress(
            min(before + done, total), total, what
        ),
    )


def _fit_network(
    config: RunConfig, learned: Material, name: str, options: TrainOptions
) -> FitResult:
    structure = structure_of(config)
    file = None if options.checkpoints is None else options.checkpoints / CHECKPOINT.format(name)
    key = fingerprint(
        config.train.model_dump_json(),
        structure.model_dump_json(),
        *(_record_hash(record) for record in learned.records),
        "validation",
        *(_record_hash(record) for record in learned.validation),
    )

    def on_step(state: TrainingState) -> None:
        if file is not None:
            write_checkpoint(file, state, key)
        if state.history:
            options.progress(len(state.history), 0, _error_words(state.history[-1]))

    resume = None
    if options.resume and file is not None and file.is_file():
        resume = read_checkpoint(file, key)
    return fit_narx(learned, structure, config.train, on_step, resume)


def _error_words(row: HistoryRow) -> str:
    if np.isfinite(row.validation):
        return f"free-run validation error {row.validation:.4f}"
    return f"free-run training error {np.sqrt(2.0 * row.loss):.4f}"


def _record_hash(record: Record) -> str:
    """Hash of shapes and numbers, without the name: a file may move."""
    shapes = f"{record.u.shape} {record.y.shape}".encode()
    return sha256(shapes + record.u.tobytes() + record.y.tobytes()).hexdigest()


def _training_row(results: Sequence[FitResult]) -> dict[str, Any]:
    return {
        "status": "; ".join(sorted({result.status for result in results})),
        "score": [result.score for result in results],
        "history": [[_history_row(row) for row in result.history] for result in results],
    }


def _history_row(row: HistoryRow) -> dict[str, Any]:
    kept = {name: getattr(row, name) for name in ("start", "horizon_s", "iteration", "loss")}
    return kept | {"validation": row.validation if np.isfinite(row.validation) else None}


@dataclass(frozen=True)
class _OnSteadyState:
    """Dynamics behind the same steady state as the network's, by a function of `identify`."""

    fit: Callable[[RunConfig, SteadyStateModel, Sequence[Log]], Identified]

    def __call__(
        self, config: RunConfig, base: Path, learned: TrainingData, options: TrainOptions
    ) -> Identification:
        steady_fit = _fit_steady(config, base, learned, options.progress)
        options.progress(0, 1, f"identifying by {config.identify.method}")
        return _identification(
            steady_fit, self.fit(steady_fit.config, steady_fit.steady, steady_fit.split.train)
        )


def _static_law(
    config: RunConfig,
    base: Path,  # noqa: ARG001 (of `Method`: a law has no file)
    learned: TrainingData,
    options: TrainOptions,
) -> Identification:
    options.progress(0, 1, f"identifying by {config.identify.method}")
    config, steady, found = static_laws(config, learned.split.train)
    split = learned.split.with_outputs(config.narx.outputs).held(steady.input_names)
    return _identification(SteadyFit(config, learned, split, steady), found)


def _identification(steady_fit: SteadyFit, found: Identified) -> Identification:
    logs = steady_fit.split.train
    calibration = IdentifiedCalibration(steady_fit.steady, found.dynamics, logs[0].dt_s)
    entries = {
        "training": {"status": found.status, "score": [], "history": []},
        "identify": found.document(),
        "baselines": fit_baselines(calibration, logs),
    }
    return Identification(steady_fit, calibration, entries)


_METHODS: Final[Mapping[str, Method]] = {
    "narx": _narx,
    "output-error": _OnSteadyState(output_error),
    "transfer": _OnSteadyState(transfer),
    "subspace": _OnSteadyState(subspace_model),
    STATIC: _static_law,
}


# ---- checkpoints


def fingerprint(*parts: str) -> str:
    """One hash of all that decides a training: its configuration and its data."""
    return sha256("\n".join(parts).encode()).hexdigest()


def write_checkpoint(file: Path, progress: TrainingState, key: str) -> None:
    """Write atomically: a kill at any time leaves the last complete step."""
    arrays = {"theta": progress.theta}
    if progress.best_theta is not None:
        arrays["best_theta"] = progress.best_theta
    if progress.moments is not None:
        arrays["first"] = progress.moments.first
        arrays["second"] = progress.moments.second
    state = {
        "start": progress.start,
        "stage": progress.stage,
        "iteration": progress.iteration,
        "damping": [progress.damping.value, progress.damping.growth],
        "adam_steps": None if progress.moments is None else progress.moments.steps,
        "best_score": float(progress.best_score).hex(),
        "since_best": progress.since_best,
        "history": [asdict(row) for row in progress.history],
    }
    header = {"schema": _CHECKPOINT_SCHEMA, "key": key, "state": json.dumps(state)}
    # A copy makes every array contiguous and its own, which is what gets written.
    arrays = {name: np.array(value) for name, value in arrays.items()}
    header["sha256"] = _digest(arrays, header["state"])
    atomic_write_bytes(file, save_arrays(arrays, header))


def _digest(arrays: Mapping[str, NDArray[Any]], state: str) -> str:
    """Hash of all that a training goes on from."""
    parts = (
        f"{name} {array.dtype} {array.shape} {sha256(array.tobytes()).hexdigest()}"
        for name, array in sorted(arrays.items())
    )
    return fingerprint(state, *parts)


def read_checkpoint(file: Path, key: str) -> TrainingState:
    """Read what `write_checkpoint` wrote.

    Raises `ModelError` if it cannot be read, or if it is of another training.
    """
    arrays, state, found = _read(file)
    if found != key:
        raise ModelError(
            "the checkpoint belongs to a training with another configuration or other data",
            file=file,
            hint="Restore them, or train without --resume into another folder",
        )
    try:
        return _state_of(arrays, state)
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise _unreadable(file, error) from None


def _state_of(arrays: dict[str, Any], state: dict[str, Any]) -> TrainingState:
    moments = None
    if state["adam_steps"] is not None:
        moments = Moments(arrays["first"], arrays["second"], state["adam_steps"])
    return TrainingState(
        theta=arrays["theta"],
        start=state["start"],
        stage=state["stage"],
        iteration=state["iteration"],
        damping=Damping(*state["damping"]),
        moments=moments,
        best_theta=arrays.get("best_theta"),
        best_score=float.fromhex(state["best_score"]),
        since_best=state["since_best"],
        history=tuple(HistoryRow(**row) for row in state["history"]),
    )


def _read(file: Path) -> tuple[dict[str, Any], dict[str, Any], str | None]:
    """Arrays and state of a checkpoint, and the key of its training."""
    try:
        with safe_open(file, framework="numpy") as stored:
            header = stored.metadata()
            arrays = {name: stored.get_tensor(name) for name in stored.keys()}  # noqa: SIM118
        state, stated, key = json.loads(header["state"]), header["sha256"], header.get("key")
    except (SafetensorError, ValueError, KeyError, TypeError, RecursionError) as error:
        raise _unreadable(file, error) from None
    if stated != _digest(arrays, header["state"]):
        raise _unreadable(file, ValueError("it was altered"))
    return arrays, state, key


def _unreadable(file: Path, error: Exception) -> ModelError:
    problem = f"the checkpoint cannot be read: {type(error).__name__}: {error}"
    return ModelError(problem, file=file, hint="Train without --resume")
