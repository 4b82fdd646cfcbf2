"""Rank forms of a model by their errors on held-out pieces.

With e the RMS errors of a piece in standard deviations of the outputs, forms are compared piece by
piece through ln e: a piece on which every form errs much, such as a record of another kind, counts
as much as any other. The score of a form is the geometric mean of e. One form beats another where
the mean of ln(e / e') is below zero by more than its standard error, and by two percent. Of the
forms that no other beats, the one of fewest parameters leads, and of several with as many the best
(Breiman et al. 1984, section 3.4.3, with paired errors).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy.optimize import nnls

from narxcal.narx.forms import DynamicModel
from narxcal.support.arrays import FloatArray
from narxcal.support.errors import DataError
from training.folds import surely_below

_BETTER = 0.98  # of a simpler form's score, as in training.lags: folds have less data than the fit
_LEAST_ERROR = 1e-9  # standard deviations: pieces without any error compare, too


Build = Callable[[float], DynamicModel]  # fit with a share of what is left of the budget


@dataclass(frozen=True)
class Form:
    """What is tried: rung, description, number of parameters, samples per fold, and its sizes."""

    rung: str
    text: str
    parameters: int
    samples: int
    delay: tuple[int, ...] = ()
    order: int = 0
    hidden: int = 0


@dataclass(frozen=True, eq=False)
class Tried:
    """A form with its score by held-out piece, held-out errors and the fit to all records.

    One that is not `whole` was judged on some of the folds, and can't lead.
    """

    form: Form
    scores: FloatArray
    errors: tuple[FloatArray, ...]
    build: Build
    whole: bool = True

    @property
    def logs(self) -> FloatArray:
        """Natural logarithm of the error of each piece; infinite where a free run is not finite."""
        known = np.isfinite(self.scores)
        return np.log(np.where(known, np.maximum(self.scores, _LEAST_ERROR), np.inf))

    @property
    def score(self) -> float:
        """Geometric mean over pieces; infinite where one has no finite free run."""
        return float(np.exp(np.mean(self.logs)))


def finite(tried: Sequence[Tried]) -> list[Tried]:
    """Forms with a finite score on all folds."""
    return [one for one in tried if one.whole and np.isfinite(one.score)]


def best_by_rung(tried: Sequence[Tried]) -> list[Tried]:
    """Best form of each rung, best first."""
    found: dict[str, Tried] = {}
    for one in sorted(finite(tried), key=lambda one: one.score):
        found.setdefault(one.form.rung, one)
    return list(found.values())


def beats(one: Tried, other: Tried) -> bool:
    """Whether `one` is clearly better (`training.folds.surely_below`), and by two percent."""
    return bool(surely_below(one.logs - other.logs, -float(np.log(_BETTER))))


def leader(tried: Sequence[Tried]) -> tuple[Tried, str]:
    """The simplest form that none beats, and why."""
    forms = finite(tried)
    if not forms:
        raise DataError("no form has a finite free run over what was held out")
    least = min(forms, key=lambda one: one.score)
    able = [one for one in forms if not any(beats(other, one) for other in forms)]
    first = min(able, key=lambda one: (one.form.parameters, one.score))
    name = f"{first.form.rung} ({first.form.text})"
    others = [one for one in best_by_rung(forms) if one.form.rung != first.form.rung]
    simpler = [one for one in others if one.form.parameters < first.form.parameters]
    if first is not least:
        reason = (
            f"{name} is the simplest form that none beats by more than one standard error: "
            f"{first.score:.3g} standard deviations of the outputs in held-out free runs, "
            f"the best form, {least.form.rung}, {least.score:.3g}"
        )
    elif simpler:
        second = min(simpler, key=lambda each: each.score)
        reason = (
            f"{name} has the lowest error in held-out free runs, {first.score:.3g} standard "
            f"deviations of the outputs; the best simpler form, {second.form.rung}, has "
            f"{second.score:.3g}"
        )
    else:
        reason = f"{name} is the simplest form, and none has a lower error in held-out runs"
    return first, reason


def table(tried: Sequence[Tried], chosen: Tried) -> pd.DataFrame:
    """A row per form, best first; `standard_error` is that of ln(e / e of the chosen form)."""
    rows = [
        {
            "rung": one.form.rung,
            "form": one.form.text,
            "parameters": one.form.parameters,
            "samples": one.form.samples,
            "score": one.score,
            "standard_error": standard_error(one.logs - chosen.logs) if one.whole else np.nan,
            "all_folds": one.whole,
            "chosen": one is chosen,
        }
        for one in tried
    ]
    return pd.DataFrame(rows).sort_values("score", ignore_index=True, kind="stable")


def standard_error(differences: FloatArray) -> float:
    """Standard error of the mean; that of a single piece is unknown, and taken as none."""
    if len(differences) < 2 or not np.isfinite(differences).all():
        return 0.0
    return float(np.std(differences, ddof=1) / np.sqrt(len(differences)))


def pseudo_bma(tried: Sequence[Tried]) -> FloatArray:
    """Weights of sum 1 in proportion to the held-out likelihood (Geisser and Eddy 1979).

    With normal errors of unknown variance it is exp(-n mean ln e) for n pieces. Half the pieces
    are counted: neighbours are flown alike, and blocks of a record overlap.
    """
    behind = np.array([np.sum(one.logs) / 2.0 for one in tried])
    weights = np.exp(behind.min() - behind)
    return np.asarray(weights / weights.sum())


def simplex(errors: FloatArray) -> FloatArray:
    """Weights >= 0 of sum 1 with the least mean square of `errors` (rows, models) times them."""
    errors = errors[np.isfinite(errors).all(axis=1)]
    normal = errors.T @ errors / max(len(errors), 1)
    normal += (1e-9 * np.trace(normal) + 1e-30) * np.eye(len(normal))
    factor = np.linalg.cholesky(normal)
    heavy = 1e3 * np.sqrt(np.trace(normal))
    matrix = np.vstack([factor.T, np.full((1, len(normal)), heavy)])
    weights = nnls(matrix, np.concatenate([np.zeros(len(normal)), [heavy]]))[0]
    return np.asarray(weights / weights.sum())
