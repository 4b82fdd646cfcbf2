"""The page of an `eval.crossval.CrossValidation`: the figures that `crossval.json` holds."""

from __future__ import annotations

import math
from collections.abc import Sequence

from eval.crossval import REMARKS, CrossValidation, FoldResult
from eval.report.content import Fold, Measure, RunHeader, Scheme
from eval.report.page import crossval_page
from eval.report.style import unit
from narxcal.channels import symbol

_KINDS = {"rmse": "RMSE", "worst_rmse": "worst RMSE", "max_rel_pct": "max rel. error"}
_TIMES = {
    "mean_relative_Ti_pct": "mean rel. error of Ti",
    "mean_relative_Tt_pct": "mean rel. error of Tt",
}


def crossvalidation_page(header: RunHeader, result: CrossValidation) -> str:
    """Build the page of `crossval`."""
    return crossval_page(header, schemes_of(result))


def schemes_of(result: CrossValidation) -> list[Scheme]:
    """Turn the folds into page records; a figure that is not defined becomes NaN."""
    least = result.settings.least_passed_pct
    return [
        Scheme(
            name=name,
            folds=[_fold(fold) for fold in folds],
            measures=_measures(folds, result),
            remark=f"{REMARKS.get(name, '')} At least {least:g} % of all assessed events of a "
            "scheme have to pass.".strip(),
        )
        for name, folds in result.schemes.items()
    ]


def _fold(fold: FoldResult) -> Fold:
    values = {key: math.nan if value is None else value for key, value in fold.values.items()}
    name = fold.name if fold.seed is None else f"{fold.name}, seed {fold.seed}"
    return Fold(name=name, train=_listed(fold.train), test=_listed(fold.test), results=values)


def _listed(names: Sequence[str]) -> str:
    """Name whole logs; of stretches cut from logs say how many there are from each."""
    counts: dict[str, int] = {}
    for name in names:
        whole = name.partition("[")[0]
        counts[whole] = counts.get(whole, 0) + 1
    cut = any("[" in name for name in names)
    return ", ".join(
        f"{name} ({n} {'part' if n == 1 else 'parts'})" if cut else name
        for name, n in counts.items()
    )


def _measures(folds: Sequence[FoldResult], result: CrossValidation) -> list[Measure]:
    keys = list(dict.fromkeys(key for fold in folds for key in fold.values))
    found = []
    for kind, label in _KINDS.items():
        for key in keys:
            head, _, channel = key.partition(".")
            if head == kind:
                of = "%" if kind == "max_rel_pct" else unit(channel)
                bound = result.settings.largest_rmse.get(channel) if kind == "rmse" else None
                found.append(
                    Measure(key=key, label=f"{symbol(channel)} {label}", unit=of, limit=bound)
                )
    found += [Measure(key=key, label=label, unit="%") for key, label in _TIMES.items()]
    return [*found, Measure(key="passed_pct", label="Ti/Tt passed", unit="%")]
