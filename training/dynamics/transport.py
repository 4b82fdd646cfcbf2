"""Transport delay between the driver and the engine, found on held-out recordings.

A late lever acts on all outputs alike, so that one delay D of the driver stands before every form.
Each D is judged by what is held out: recordings, or thirds of a single one. With e the geometric
mean over the outputs of the free-run errors there,

1. ARX models of second order behind the steady states of every D in steps of `_STEP_S`. A model of
   so few terms cannot imitate more than about two steps; a D of fewer is left to the lags.
2. plain lags at 0, at the best D and at half steps around it: there is a delay if

    mean r < -s,   r = ln(e_D / e_0) by fold,   s = standard error of mean r (Student's t)

The interval holds every D whose e is not larger than the best one's by more than s, and half a step
on either side. A grid of candidates as in `delayest` of MathWorks' System Identification Toolbox,
which however takes one-step errors.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from data_prep.log import Log
from narxcal.calibration.calibration import steady_for_engine
from narxcal.calibration.delay import TransportDelay
from narxcal.steady.model import SteadyStateModel
from narxcal.support.arrays import FloatArray
from narxcal.support.progress import Progress, silent
from training.config import RunConfig
from training.dynamics.baselines import Run, arx_of, linear, start_of
from training.dynamics.lags import PLAIN, Trial, with_form
from training.folds import Fold, geometric_rms, surely_below, thirds

_STEP_S: Final = 0.2
_LONGEST_S: Final = 5.0
_IMITATED: Final = 2  # steps that an ARX model of second order makes up for
_ORDER: Final = 2
_UNSTABLE: Final = 10.0  # ln of an error over the outputs' range


@dataclass(frozen=True)
class DelayChoice:
    """The delay that was found, if there is one, and ln of the held-out error at each candidate."""

    delay: TransportDelay | None = None
    errors: tuple[tuple[float, float], ...] = ()


def choose_delay(
    config: RunConfig, steady: SteadyStateModel, logs: Sequence[Log], progress: Progress = silent
) -> DelayChoice:
    """Find the delay of the driver; [train] delay_s says it where it is a number.

    Without a second fold, or without a driver among the inputs, there is none.
    """
    driver, given_s = config.driver, config.train.delay_s
    if driver not in steady.input_names:
        return DelayChoice()
    if given_s != "auto":
        known = TransportDelay((driver,), given_s, given_s, given_s)
        return DelayChoice(known if given_s > 0.0 else None)
    parts, folds = thirds(logs)
    if len(folds) < 2:
        return DelayChoice()
    candidates = np.arange(0.0, _LONGEST_S + 1e-9, _STEP_S)
    every = max(round(_STEP_S / logs[0].dt_s), 1)
    runs = [_run(steady, log, every) for log in parts]
    coarse = np.array([_arx_errors(runs, folds, round(d / _STEP_S)) for d in candidates])
    best = int(coarse.mean(axis=1).argmin())
    profile = tuple(zip(candidates.tolist(), coarse.mean(axis=1).tolist(), strict=True))
    if best <= _IMITATED or not surely_below(coarse[best] - coarse[0]):
        return DelayChoice(None, profile)
    near = candidates[best] + _STEP_S * np.array([-2.0, -1.5, -1.0, -0.5, 0.0, 0.5, 1.0])
    found = _by_lags(config, steady, logs, np.concatenate([[0.0], near]), progress)
    return found or DelayChoice(None, profile)


def _by_lags(
    config: RunConfig,
    steady: SteadyStateModel,
    logs: Sequence[Log],
    candidates: FloatArray,
    progress: Progress,
) -> DelayChoice | None:
    """Judge `candidates`, the first of which is 0, by plain lags; None if 0 is as good."""
    plain, errors = with_form(config, PLAIN), []
    for number, delay_s in enumerate(candidates.tolist()):
        progress(number, len(candidates), "looking for a delay")
        late = TransportDelay((config.driver,), delay_s, delay_s, delay_s)
        trial = Trial(steady, [delayed(log, late) for log in logs], config)
        errors.append([each.error for each in trial.judged(plain)])
    table = np.array(errors)
    best = int(table.mean(axis=1).argmin())
    if not np.isfinite(table).all() or not surely_below(table[best] - table[0]):
        return None
    close = [k for k in range(1, len(table)) if not surely_below(table[best] - table[k])]
    delay_s, half = float(candidates[best]), 0.25 * _STEP_S
    ends = candidates[[*close, best]]
    span = max(float(ends.min()) - half, 0.0), float(ends.max()) + half
    profile = zip(candidates.tolist(), table.mean(axis=1).tolist(), strict=True)
    return DelayChoice(TransportDelay((config.driver,), delay_s, *span), tuple(profile))


def delayed(log: Log, delay: TransportDelay | None) -> Log:
    """The log with its channels as they act on the engine."""
    if delay is None:
        return log
    values = delay.late(log.matrix(delay.channels), log.dt_s)
    return log.with_channels(dict(zip(delay.channels, values.T, strict=True)))


def _run(steady: SteadyStateModel, log: Log, every: int) -> Run:
    own = steady_for_engine(steady, log.source.engine)
    ss = own.outputs(log.matrix(steady.input_names)[::every])
    return Run(ss, log.matrix(steady.output_names)[::every])


def _arx_errors(runs: Sequence[Run], folds: Sequence[Fold], samples: int) -> FloatArray:
    """Ln of the held-out free-run error of ARX models in each fold (folds,)."""
    late = [replace(run, steady=_shifted(run.steady, samples)) for run in runs]
    found = []
    for fold in folds:
        fitted, judged = fold.of(late)
        count = late[0].steady.shape[1]
        models = [linear("arx", k, arx_of(fitted, k, _ORDER), count) for k in range(count)]
        with np.errstate(over="ignore", invalid="ignore"):
            errors = [
                np.column_stack(
                    [
                        model.simulate(run.steady, start_of(run.steady, run.measured[0], k))
                        for k, model in enumerate(models)
                    ]
                )
                - run.measured
                for run in judged
            ]
            found.append(np.log(geometric_rms(errors)))
    known: FloatArray = np.nan_to_num(np.array(found), nan=_UNSTABLE, posinf=_UNSTABLE)
    return known


def _shifted(values: FloatArray, samples: int) -> FloatArray:
    """Values (time, n) a whole number of samples later; those before the first are the first."""
    first = np.repeat(values[:1], samples, axis=0)
    shifted: FloatArray = np.concatenate([first, values])[: len(values)]
    return shifted
