"""Which model leads in each output: the network, or a simple one where held-out logs say so.

The training logs are divided into folds: whole recordings, or thirds of a single one. In each fold
steady state, lags, network and baselines are fitted anew to the rest, and all of them run free over
what is held out. With e the RMS errors of a held-out log, a simple model can lead in an output if

    mean r < -s,   r = ln(e_simple / e_network) by held-out log,   s = standard error of mean r,
                   widened by Student's t

Of those that can, the one of the least mean r leads; one held-out log alone says nothing. The test
logs take no part. The network is trained and shown whatever leads.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, Final, NamedTuple

import numpy as np

from data_prep.log import Log
from narxcal.calibration.calibration import DynamicCalibration
from narxcal.calibration.lead import KINDS, Kind, Lead
from narxcal.support.arrays import FloatArray, known_mean
from narxcal.support.errors import DataError
from narxcal.support.progress import Progress, silent
from training.baselines import Baselines, run_of
from training.config import RunConfig
from training.folds import Fold, held_out_folds, surely_below
from training.levels import lag_of, level_of

NETWORK: Final = "network"
_FOLDS: Final = 3
_UNIT_US: Final = 3.0  # nominal cost of a sample-step of the network behind lags
# Error over the median of the others: errors of good logs scatter by a factor of about two.
_SUSPECT: Final = 3.0
_LEAST_ERROR: Final = 1e-9  # of the largest error: outputs without any error compare, too

Refit = Callable[[Sequence[Log]], tuple[DynamicCalibration, Mapping[str, Any]]]


class HeldOut(NamedTuple):
    """RMS errors, levels and lags in s, each (1 + kinds, outputs), over one held-out log.

    Rows are network, steady state, first-order lag and ARX. With more logs (logs, ...).
    """

    errors: FloatArray
    levels: FloatArray
    lags_s: FloatArray


class HeldRun(NamedTuple):
    """Free run over a log that was held out, its steady state and measurement, (time, outputs)."""

    steady: FloatArray
    model: FloatArray
    measured: FloatArray
    recording: str


class Judged(NamedTuple):
    """A held-out log: its figures, and free runs (1 + kinds, time, outputs) with what they model.

    Rows of `models` are as in `HeldOut`; `steady` and `measured` are (time, outputs).
    """

    figures: HeldOut
    models: FloatArray
    steady: FloatArray
    measured: FloatArray
    recording: str


@dataclass(frozen=True, eq=False)
class Leading:
    """What leads, and the figures of all models over the held-out `logs` that say so.

    Without any the network leads, and `status` says why. `whole` tells recordings from parts of a
    single one, of which each has conditions of its own. `free_runs` are those of what leads.
    """

    leads: tuple[Lead, ...]
    channels: tuple[str, ...]
    logs: tuple[str, ...]
    held_out: HeldOut
    status: str
    whole: bool = True
    free_runs: tuple[HeldRun, ...] = ()

    @property
    def errors(self) -> FloatArray:
        """RMS errors (logs, 1 + kinds, outputs)."""
        return self.held_out.errors

    def row(self) -> dict[str, Any]:
        """JSON-able: per channel what leads, held-out errors and the standard error of ln ratio."""
        chosen = {lead.channel: lead.kind for lead in self.leads}
        found: dict[str, Any] = {}
        for k, name in enumerate(self.channels):
            found[name] = {"leads": chosen.get(k, NETWORK)}
            if len(self.logs):
                pairs = zip((NETWORK, *KINDS), self.errors[:, :, k].T, strict=True)
                found[name]["held_out_rmse"] = {kind: _pooled(values) for kind, values in pairs}
            if len(self.logs) and self.whole:
                row = (NETWORK, *KINDS).index(found[name]["leads"])
                found[name]["held_out_level"] = _known(self.held_out.levels[:, row, k])
                found[name]["held_out_lag_s"] = _known(self.held_out.lags_s[:, row, k])
        return {
            "status": self.status,
            "held_out": list(self.logs),
            "channels": found,
            "suspects": list(self.suspects),
        }

    @property
    def suspects(self) -> tuple[str, ...]:
        """Held-out logs on which every model is far worse than on the others, one sentence each."""
        if len(self.logs) < 3 or not self.whole:
            return ()
        best = np.nanmin(np.where(np.isfinite(self.errors), self.errors, np.inf), axis=1)
        found = []
        for k, name in enumerate(self.logs):
            others = np.median(np.delete(best, k, axis=0), axis=0)
            ratios = np.where(np.isfinite(best[k]) & (others > 0.0), best[k] / others, 0.0)
            worst = int(np.argmax(ratios))
            if ratios[worst] > _SUSPECT:
                found.append(
                    f"{name} does not fit the other logs: held out, {self.channels[worst]} is "
                    f"wrong by {best[k, worst]:.3g}, {ratios[worst]:.1f} times as much as usual, "
                    "in every model; check it, or leave it out"
                )
        return tuple(found)


def network_leads(calibration: DynamicCalibration, status: str) -> Leading:
    """No choice was made."""
    empty = np.empty((0, 1 + len(KINDS), len(calibration.output_names)))
    return Leading((), calibration.output_names, (), HeldOut(empty, empty, empty), status)


def choose_leads(
    config: RunConfig,
    logs: Sequence[Log],
    refit: Refit,
    fitted: tuple[DynamicCalibration, Mapping[str, Any]],
    progress: Progress = silent,
) -> Leading:
    """Judge all models on folds of the training `logs`; `fitted` is what was fitted to all of them.

    `refit` fits calibration and baselines to some logs.
    """
    calibration, baselines = fitted
    parts, folds = lead_folds(logs)
    steps = sum(config.train.iterations) * config.train.starts
    cost = 1e-6 * _UNIT_US * steps * sum(len(parts[k]) for fold in folds for k in fold.fitted)
    if cost > config.train.choice_s:
        limit = f"choice_s = {config.train.choice_s:g}"
        return network_leads(calibration, f"no choice: folds take {cost:.0f} CPU s, {limit}")
    names: list[str] = []
    held: list[Judged] = []
    lost: list[str] = []
    for number, fold in enumerate(folds):
        progress(number, len(folds), "judging on held-out parts")
        fit, judged = fold.of(parts)
        try:
            found, simple = refit(fit)
        except DataError as error:
            lost.append(str(error.problem))
            continue
        names += [log.name for log in judged]
        held += [held_out(found, Baselines.from_json(simple), log) for log in judged]
    if not held:
        reason = lost[0] if lost else "nothing could be held out"
        return network_leads(calibration, f"no choice: {reason}")
    figures = [one.figures for one in held]
    stacked = HeldOut(*(np.stack(part) for part in zip(*figures, strict=True)))
    fitted_baselines = Baselines.from_json(baselines)
    leads = tuple(
        lead_of(kind, k, fitted_baselines, calibration.dt_s)
        for k in range(len(calibration.output_names))
        if (kind := leading_kind(stacked.errors[:, :, k])) is not None
    )
    status = f"chosen on {len(held)} held-out parts of the training logs"
    whole = len({log.source.file for log in logs}) > 1
    free = tuple(_led(one, leads) for one in held)
    return Leading(leads, calibration.output_names, tuple(names), stacked, status, whole, free)


def _led(one: Judged, leads: Sequence[Lead]) -> HeldRun:
    """The held-out free run of what leads in each output."""
    y = one.models[0].copy()
    for lead in leads:
        y[:, lead.channel] = one.models[1 + KINDS.index(lead.kind)][:, lead.channel]
    return HeldRun(one.steady, y, one.measured, one.recording)


def lead_folds(logs: Sequence[Log]) -> tuple[list[Log], list[Fold]]:
    """Logs and folds of whole recordings; of a single one, its thirds."""
    files = [log.source.file for log in logs]
    if len(set(files)) > 1:
        return list(logs), held_out_folds(files, _FOLDS)
    parts, numbers = [], []
    for log in logs:
        edges = np.linspace(0, len(log), _FOLDS + 1).astype(int).tolist()
        for number, (a, b) in enumerate(pairwise(edges)):
            parts.append(replace(log.part(a, b), name=f"{log.name}[{a}:{b}]"))
            numbers.append(str(number))
    return parts, held_out_folds(numbers, _FOLDS)


def held_out(calibration: DynamicCalibration, baselines: Baselines, log: Log) -> Judged:
    """Run network and simple models over one log; figures that are unknown are NaN."""
    own = calibration.for_engine(log.source.engine)
    run = run_of(calibration, log)
    models = (
        own.simulate(log.matrix(own.input_names), run.measured[0]),
        run.steady,
        baselines.lag.simulate(run.steady, run.measured[0], own.dt_s),
        baselines.arx.simulate(run.steady, run.measured[0]),
    )
    figures = HeldOut(
        np.array([np.sqrt(known_mean((model - run.measured) ** 2)) for model in models]),
        np.array([level_of(model, run.measured) for model in models]),
        np.array([lag_of(model, run.measured, own.dt_s) for model in models]),
    )
    return Judged(figures, np.stack(models), run.steady, run.measured, log.source.file)


def _known(values: FloatArray) -> list[float]:
    return [float(value) for value in values if np.isfinite(value)]


def leading_kind(errors: FloatArray) -> Kind | None:
    """Simple model that leads by its held-out errors (logs, 1 + kinds); None for the network."""
    errors = errors[np.isfinite(errors[:, 0])]
    if not len(errors):
        return None
    floor = max(_LEAST_ERROR * float(np.nanmax(errors)), 1e-300)
    logs = np.log(np.maximum(errors, floor))
    ratios = logs[:, 1:] - logs[:, :1]
    means = ratios.mean(axis=0)
    able = np.flatnonzero(surely_below(ratios))
    return KINDS[min(able, key=lambda k: means[k])] if len(able) else None


def _pooled(values: FloatArray) -> float | None:
    """Root mean square of the values (logs,) that are known; None without any."""
    known = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(known**2))) if len(known) else None


def lead_of(kind: Kind, channel: int, baselines: Baselines, dt_s: float) -> Lead:
    """The fitted simple model of one output."""
    if kind == "first_order":
        return baselines.lag.lead(channel, dt_s)
    return baselines.arx.lead(channel) if kind == "arx" else Lead(kind, channel)
