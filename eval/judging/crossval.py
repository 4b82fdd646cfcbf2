"""Cross-validation: errors and Ti/Tt on data that the calibration was not fitted to, by fold."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from data_prep.cleaning.identity import refuse_duplicates
from data_prep.log import Log
from data_prep.prepare import with_outputs
from eval.judging.log_evaluation import LogEvaluation, assess_log
from eval.judging.outcome import Outcome
from eval.judging.scores import score
from eval.run_logs import EvaluateConfig, run_config
from narxcal.calibration.bundle import Bundle
from narxcal.support.errors import DataError
from narxcal.support.files import finite, versions
from narxcal.support.progress import Progress, silent
from training.config import RunConfig
from training.folds import (
    LEAVE_ONE_OUT,
    RANDOM,
    Plan,
    leave_one_flight_out,
    random_splits,
)
from training.pipeline import run_plans
from training.responses.transients import tally
from training.screening.masking import cross_screen

SCHEMA = "narxcal.crossval/1"
REMARKS = {
    LEAVE_ONE_OUT: "A whole flight is held back at a time, with all its engines; free run over "
    "the whole flight.",
    RANDOM: "Whole events are held back, each engine's for itself; free run over each event, from "
    "its first measured values. Other events of the same flight were trained on, so this is easier "
    "than leaving a flight out.",
}


@dataclass(frozen=True)
class FoldResult:
    """One division and its figures on the test part; `figures` are None where not defined.

    Keys are `rmse.CHANNEL`, `worst_rmse.CHANNEL` (of a single log or event), `max_rel_pct.CHANNEL`,
    `max_error.CHANNEL`, `mean_relative_Ti_pct`, `mean_relative_Tt_pct`, `passed_pct`, `assessed`
    and `passed`. `not_judged` names test parts without a valid input.
    """

    scheme: str
    name: str
    seed: int | None
    train: tuple[str, ...]
    test: tuple[str, ...]
    figures: dict[str, float | None]
    not_judged: tuple[str, ...] = ()

    def row(self) -> dict[str, Any]:
        names = {key: list(getattr(self, key)) for key in ("train", "test", "not_judged")}
        return {"name": self.name, "seed": self.seed, **names, "values": self.figures}


@dataclass(frozen=True)
class CrossValidation:
    """All folds in order; `skipped` says which schemes could not be run and why."""

    folds: tuple[FoldResult, ...]
    settings: EvaluateConfig
    skipped: dict[str, str] = field(default_factory=dict)
    provenance: dict[str, Any] = field(default_factory=dict)

    @property
    def schemes(self) -> dict[str, tuple[FoldResult, ...]]:
        names = dict.fromkeys(fold.scheme for fold in self.folds)
        return {name: tuple(f for f in self.folds if f.scheme == name) for name in names}

    def spread(self, scheme: str) -> dict[str, dict[str, float | None]]:
        return spread(self.schemes[scheme])

    def remark(self, scheme: str) -> str:
        """How a scheme divides, and what it has to reach."""
        least = f"At least {self.settings.least_passed_pct:g} % of all assessed events of a scheme"
        return f"{REMARKS.get(scheme, '')} {least} have to pass.".strip()

    @property
    def missed(self) -> list[str]:
        """Each requirement of [evaluate] that a scheme or a fold does not meet."""
        texts = []
        least = self.settings.least_passed_pct
        for name, folds in self.schemes.items():
            assessed, passed = (total(folds, key) for key in ("assessed", "passed"))
            if assessed and 100.0 * passed / assessed < least:
                texts.append(
                    f"{name}: {passed} of {assessed} transients pass "
                    f"({100.0 * passed / assessed:.1f} %), at least {least:g} % have to"
                )
            if not assessed and (least > 0.0 or not self.settings.largest_rmse):
                texts.append(f"{name}: no transient could be assessed")
            for channel, bound in self.settings.largest_rmse.items():
                texts += [
                    f"{name}, {fold.name}: {channel} RMSE {value:.3g}, at most {bound:g} allowed"
                    for fold in folds
                    if (value := fold.figures.get(f"rmse.{channel}")) is not None and value > bound
                ]
        return texts

    @property
    def outcome(self) -> Outcome:
        """The verdict: transients over the folds of each scheme, then what is missed."""
        counts = [
            f"{total(folds, 'passed')} of {total(folds, 'assessed')} in {name}"
            for name, folds in self.schemes.items()
        ]
        missed = self.missed
        headline = f"Transients that meet the rules for Ti and Tt: {', '.join(counts)}"
        return Outcome(not missed, headline, tuple(f"{text}." for text in missed))

    def document(self) -> dict[str, Any]:
        """`crossval.json`; None where a figure does not exist."""
        missed = self.missed
        schemes = [
            {
                "name": name,
                "remark": REMARKS.get(name, ""),
                "folds": [fold.row() for fold in folds],
                "spread": spread(folds),
            }
            for name, folds in self.schemes.items()
        ]
        return {
            "schema": SCHEMA,
            "ok": not missed,
            "missed": missed,
            "schemes": schemes,
            "skipped": self.skipped,
            **self.provenance,
        }


def cross_validate(
    config: RunConfig,
    base: Path,
    logs: Sequence[Log],
    jobs: int = -1,
    progress: Progress = silent,
) -> CrossValidation:
    """Calibrate and judge once per fold; `progress` counts the folds.

    `logs` are prepared as by `eval.run_logs.evaluation_logs`: masked inputs still NaN. [split]
    plays no part. Raises `DataError` where no scheme can be run, and where two files hold the same
    samples.
    """
    refuse_duplicates(logs, "a fold would be judged on what it learned")
    settings = EvaluateConfig.parse(config.evaluate, "[evaluate]")
    logs = [with_outputs(log, config.narx.outputs) for log in logs]
    logs, _ = cross_screen(logs, (*config.narx.outputs, *config.steady_state.inputs))
    plans, skipped = _plans(config, settings, logs)
    folds = []
    for result in run_plans(plans, config, base, judge_fold, jobs):
        folds.append(result)
        progress(len(folds), len(plans), result.scheme)
    provenance = {
        "config": config.model_dump(mode="json", by_alias=True),
        "data": {log.source.file: log.source.sha256 for log in logs},
        "versions": versions(),
    }
    return CrossValidation(tuple(folds), settings, skipped, provenance)


def judge_fold(bundle: Bundle, plan: Plan) -> FoldResult:
    """Judge a fold's calibration on its test segments."""
    _, settings = run_config(bundle)
    inputs = bundle.calibration.input_names
    usable = [part for part in plan.test if np.isfinite(part.log.matrix(inputs)).any(axis=0).all()]
    judged = [assess_log(bundle, part.log, settings, events=part.own_events) for part in usable]
    return FoldResult(
        scheme=plan.scheme,
        name=plan.name,
        seed=plan.seed,
        train=tuple(part.log.name for part in plan.train),
        test=tuple(part.log.name for part in plan.test),
        figures=_figures(judged),
        not_judged=tuple(part.log.name for part in plan.test if part not in usable),
    )


def spread(folds: Sequence[FoldResult]) -> dict[str, dict[str, float | None]]:
    """Mean, sample standard deviation, least and greatest of every figure over the folds.

    Folds without the figure are left out.
    """
    keys = dict.fromkeys(key for fold in folds for key in fold.figures)
    found = {}
    for key in keys:
        given = [value for fold in folds if (value := fold.figures.get(key)) is not None]
        found[key] = {
            "mean": float(np.mean(given)) if given else None,
            "std": float(np.std(given, ddof=1)) if len(given) > 1 else None,
            "min": min(given, default=None),
            "max": max(given, default=None),
        }
    return found


def total(folds: Sequence[FoldResult], key: str) -> int:
    return sum(int(fold.figures.get(key) or 0) for fold in folds)


def _plans(
    config: RunConfig, settings: EvaluateConfig, logs: Sequence[Log]
) -> tuple[list[Plan], dict[str, str]]:
    wanted, outputs = settings.crossval, config.narx.outputs
    schemes: dict[str, Callable[[], Sequence[Plan]]] = {}
    if wanted.leave_one_flight_out:
        schemes[LEAVE_ONE_OUT] = lambda: leave_one_flight_out(logs, config.events, outputs)
    if wanted.random_splits:
        schemes[RANDOM] = lambda: random_splits(logs, config.events, wanted, outputs)
    plans: list[Plan] = []
    skipped: dict[str, str] = {}
    for name, scheme in schemes.items():
        try:
            plans += _learnable(scheme(), outputs)
        except DataError as error:
            skipped[name] = str(error)
    if not plans:
        why = "; ".join(skipped.values()) or "[evaluate.crossval] demands none"
        raise DataError(f"no division of the logs is possible: {why}")
    return plans, skipped


def _learnable(plans: Sequence[Plan], outputs: Sequence[str]) -> Sequence[Plan]:
    """The plans; `DataError` where one holds back every sample of an output."""
    for plan in plans:
        known = {name for part in plan.train for name in part.log.recorded(outputs)}
        for name in outputs:
            if name not in known:
                raise DataError(
                    f"{plan.name}, no sample of this output is left to learn from",
                    channel=name,
                    hint="Take it out of [narx] outputs, or add logs that have it",
                )
    return plans


def _figures(judged: Sequence[LogEvaluation]) -> dict[str, float | None]:
    counts = tally([each for one in judged for each in one.assessments])
    names = "passed_pct", "assessed", "passed", "mean_relative_Ti_pct", "mean_relative_Tt_pct"
    found: dict[str, float | None] = {name: getattr(counts, name) for name in names}
    for name, figures in score([one.run for one in judged]).items():
        single = [one.scores[name].rmse for one in judged]
        worst = max((value for value in single if math.isfinite(value)), default=math.nan)
        found[f"rmse.{name}"] = figures.rmse
        found[f"worst_rmse.{name}"] = worst
        found[f"max_rel_pct.{name}"] = figures.max_rel_pct
        found[f"max_error.{name}"] = figures.max_error
    values: dict[str, float | None] = finite(found)
    return values
