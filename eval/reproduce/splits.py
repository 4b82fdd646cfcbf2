"""Section 3.2 of the paper: ten random 7:3 divisions of the events."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from eval.crossval import CrossValidation, FoldResult, judge_fold
from eval.judged import EvaluateConfig
from eval.report import study_figures, tables
from eval.report.claims import Claim, Study, or_nan
from eval.report.content import Scheme
from eval.report.crossvalidation import schemes_of
from eval.report.style import symbol, unit
from eval.report.svg import Picture
from eval.reproduce.calibrated import PAPER_PCT
from eval.reproduce.data_sets import DataSets
from eval.reproduce.effort import Effort, within
from eval.reproduce.pieces import pieces
from training.crossval import divide, run_plans

TIMES_PCT = 5.0


def splits(
    data: DataSets, effort: Effort, watch: Callable[[FoldResult, int, int], None] | None = None
) -> Study:
    """Calibrate once per division and judge the held-back events."""
    found = divided(data, effort, watch)
    worst = worst_of(found)
    scheme = schemes_of(found)[0]
    return Study(
        key="splits",
        title=f"{effort.splits} random 7:3 divisions",
        source="section 3.2",
        text="Whole events are held back, never parts of one; free run over each held-back event. "
        "The figures are the worst of all divisions, the times the mean over them.",
        claims=_claims(worst),
        tables=[tables.folds(scheme)],
        pictures=_pictures(scheme),
        results={"worst": worst, "folds": found.document()["schemes"][0]["folds"]},
    )


def divided(
    data: DataSets, effort: Effort, watch: Callable[[FoldResult, int, int], None] | None = None
) -> CrossValidation:
    """Draw the divisions, calibrate and judge: `narxcal crossval` on segments."""
    config = within(data.config, effort)
    settings = EvaluateConfig.parse(config.evaluate, "[evaluate]")
    segments = [part for log in data.logs for part in pieces(log, config.events)]
    wanted = settings.crossval.model_copy(update={"random_splits": effort.splits})
    plans, folds = divide(segments, wanted), []
    for fold in run_plans(plans, config, data.base, judge_fold, effort.jobs):
        folds.append(fold)
        if watch is not None:
            watch(fold, len(folds), len(plans))
    return CrossValidation(tuple(folds), settings)


def worst_of(found: CrossValidation) -> dict[str, Any]:
    """What the paper states: worst relative errors and RMSE, mean relative errors of Ti and Tt."""
    keys = dict.fromkeys(key for fold in found.folds for key in fold.values)
    given = {
        key: [value for fold in found.folds if (value := fold.values.get(key)) is not None]
        for key in keys
    }
    worst = {key: max(values, default=None) for key, values in given.items()}
    means = {
        key: sum(given[key]) / len(given[key]) if given.get(key) else None
        for key in ("mean_relative_Ti_pct", "mean_relative_Tt_pct")
    }
    kept = {key: value for key, value in worst.items() if key.startswith(("max_rel_pct.", "rmse."))}
    passed, assessed = (int(sum(given.get(key, []))) for key in ("passed", "assessed"))
    return {**kept, **means, "passed": passed, "assessed": assessed}


def _claims(worst: dict[str, Any]) -> list[Claim]:
    claims = []
    for key, value in worst.items():
        kind, _, channel = key.partition(".")
        if kind == "max_rel_pct":
            claims.append(
                Claim(
                    what=f"Largest relative error of {symbol(channel)} in any division",
                    claimed=f"< {PAPER_PCT:g} %",
                    value=or_nan(value),
                    bound=PAPER_PCT,
                    unit="%",
                    remark=f"largest RMSE {or_nan(worst[f'rmse.{channel}']):.3g} {unit(channel)}",
                )
            )
    return [*claims, *(_time(worst, name) for name in ("Ti", "Tt"))]


def _time(worst: dict[str, Any], name: str) -> Claim:
    return Claim(
        what=f"Mean relative error of {name} over the divisions",
        claimed=f"< {TIMES_PCT:g} %",
        value=or_nan(worst[f"mean_relative_{name}_pct"]),
        bound=TIMES_PCT,
        unit="%",
        remark=f"{worst['passed']} of {worst['assessed']} readings pass",
    )


def _pictures(scheme: Scheme) -> list[Picture]:
    return [study_figures.spread([scheme], list(scheme.measures))] if scheme.measures else []
