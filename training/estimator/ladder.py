"""Choose the form of a model by free runs on folds: the simplest that is not beaten.

The ladder, each rung started from the one below:

| rung | model |
|---|---|
| first-order lag | linear output error with one state |
| ARX | least squares on one step, orders and dead time by the folds |
| linear output error | 2 to 8 states, dead time or none |
| NARX network | eight lags and taps, 8 hidden units on a linear path, decays by the folds |
| latent states | 1 to 8 states, 4 to 16 hidden units, from the linear model on (see `latent`) |
| mean | weighted mean of the best of two or three rungs |

Folds are records, or blocks of them where there are fewer than four, with a gap around what is held
out. Each held-out piece is simulated twice, from its beginning and from a third of it, after
windows of measured outputs of two lengths. One form beats another where the mean of ln(e / e') over
the pieces is below zero by more than its standard error, and by two percent. Of the forms that no
other beats, the one of fewest parameters leads, and of several with as many the best (Breiman et
al. 1984, section 3.4.3, with paired errors); a latent form is averaged with those of other sizes.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np
import pandas as pd
from scipy.optimize import nnls
from threadpoolctl import threadpool_limits

from narxcal.intervals import Conformal
from narxcal.narx.forms import DynamicModel, Ensemble, pack, unpack
from narxcal.narx.latent import Shape
from narxcal.record import Record
from narxcal.support.arrays import FloatArray
from narxcal.support.errors import DataError
from narxcal.support.files import finite
from narxcal.support.progress import Progress, silent
from training.dynamics.network import known_numbers
from training.estimator.forms import dead_times, linear_model, try_arx, try_linear, try_network
from training.estimator.latent_forms import affordable, try_latent
from training.estimator.search import (
    FOLDS,
    LAG,
    LATENT,
    MEAN,
    SHORTEST,
    WINDOW,
    Budget,
    Form,
    RecordFold,
    Search,
    Tried,
    beats,
    by_piece,
    record_folds,
    runs_of,
)

TIME_LIMIT_S = 120.0
_UNITS_PER_SAMPLE = 6000.0  # of the budget; with less a single record has half as many folds
_MIXED = 3  # forms of which a mean is taken
_LEAST_WEIGHT = 0.02  # of a form in a mean
_STORED = (
    "status",
    "rung",
    "reason",
    "budget",
    "spent",
)  # fields of `Choice`, as they are
_INTERVALS, _PARTS = "intervals.", ("after", "errors", "piece")


@dataclass(frozen=True, eq=False)
class Choice:
    """The chosen model, everything that was tried, why, and what it cost.

    `tried` has a row per form: rung, form, parameters, score (geometric mean over held-out pieces
    of the RMS error in standard deviations), standard_error (of the logarithm of its ratio to that
    of the chosen form), samples, chosen. `intervals` are held-out errors by horizon.
    """

    model: DynamicModel
    rung: str
    tried: pd.DataFrame
    reason: str
    status: str
    budget: int
    spent: int
    intervals: Conformal

    def to_arrays(self) -> tuple[dict[str, Any], dict[str, Any], dict[str, FloatArray]]:
        """Split into the structure of the model and the result, both JSON-able, and arrays."""
        network, arrays = pack(self.model)
        result = {name: getattr(self, name) for name in _STORED}
        result["tried"] = self.tried.to_dict("records")
        own = {
            f"{_INTERVALS}{name}": np.asarray(getattr(self.intervals, name), dtype=np.float64)
            for name in _PARTS
        }
        return network, finite(result), {**arrays, **own}

    @classmethod
    def from_arrays(
        cls,
        network: Mapping[str, Any],
        result: Mapping[str, Any],
        arrays: Mapping[str, FloatArray],
    ) -> Self:
        after, errors, piece = (np.asarray(arrays[f"{_INTERVALS}{name}"]) for name in _PARTS)
        own = {name: array for name, array in arrays.items() if not name.startswith(_INTERVALS)}
        return cls(
            model=unpack(network, own),
            tried=pd.DataFrame([known_numbers(row) for row in result["tried"]]),
            intervals=Conformal(after, errors, piece.astype(np.int64)),
            **{name: result[name] for name in _STORED},
        )


@dataclass(frozen=True)
class Limits:
    """CPU seconds of the search, seed of the draws, and whether only linear rungs are tried."""

    time_limit_s: float = TIME_LIMIT_S
    seed: int = 0
    linear: bool = False


def choose(
    records: Sequence[Record],
    limits: Limits,
    progress: Progress = silent,
    validation: Sequence[Record] = (),
) -> Choice:
    """Search the ladder within a budget, and fit the chosen form to all records.

    With `validation` records these are held out in place of folds. Raises `DataError` where no
    record is long enough to fit.
    """
    long = [r for r in records if len(r) >= SHORTEST and np.isfinite(r.y).any()]
    if not long:
        longest = max(len(record) for record in records)
        raise DataError(
            f"the longest record has {longest} samples with outputs, and at least {SHORTEST} "
            "are needed to fit and to hold something out",
            hint="Add longer records",
        )
    # More threads than one would only wait for each other, which is processor time, too.
    with threadpool_limits(limits=1):
        work = Budget(limits.time_limit_s)
        folds = divide(long, work.budget, validation)
        search = Search(long, folds, work, limits.seed, progress)
        if not folds:
            return _without_folds(search)
        _climb(search, limits.linear)
        return _chosen(search)


def divide(records: list[Record], budget: float, validation: Sequence[Record]) -> list[RecordFold]:
    """What is held out: `validation` where given, else records or blocks of them."""
    if validation:
        runs = tuple(run for record in validation for run in runs_of(record))
        return [RecordFold(tuple(records), runs)] if runs else []
    samples = sum(map(len, records))
    gap = min(WINDOW, samples // 50)  # until a start is forgotten, at most 2 %
    # Many samples of one record hold every pattern many times, and need fewer folds. What one of
    # several records holds may be in no other: however many they are, few are held out at a time.
    few = samples > budget / _UNITS_PER_SAMPLE and len(records) < FOLDS
    return record_folds(records, gap, FOLDS if few else 2 * FOLDS)


def _climb(search: Search, linear: bool) -> None:
    """The ladder from below, and the mean."""
    search.watch(0.0, "dead time")
    delays = dead_times(search.records, search.scalings)
    try_arx(search, delays)
    bases = try_linear(search, delays)
    search.show()
    if not linear:
        try_network(search)
        try_latent(search, bases)
        _try_mean(search)


def _try_mean(search: Search) -> None:
    """Weighted mean of the best form of each rung, weights by least squares on other pieces."""
    best = best_by_rung(search.tried)[:_MIXED]
    if len(best) < 2:
        return
    pieces = [run for fold in search.folds for run in fold.held]
    runs, names = range(len(pieces)), [run.record.name for run in pieces]
    errors = [np.stack([one.errors[k].ravel() for one in best], axis=1) for k in runs]
    mixed = []
    for k in runs:
        others = [errors[j] for j in runs if names[j] != names[k]]
        weights = simplex(np.concatenate(others)) if others else np.eye(len(best))[0]
        mixed.append((errors[k] @ weights).reshape(best[0].errors[k].shape))
    found = _mean(search, MEAN, best, simplex(np.concatenate(errors)))
    if found is not None:
        scores = np.array(by_piece(pieces, mixed))
        search.tried.append(replace(found, scores=scores, errors=tuple(mixed)))


def _sizes(search: Search, leader: Tried) -> list[Tried]:
    """The leading latent form and the best of each other size, as many as can be fitted."""
    found = {(leader.form.order, leader.form.hidden): leader}
    for one in sorted(comparable(search.tried), key=lambda one: one.score):
        if one.form.rung == LATENT and one.form.delay == leader.form.delay:
            found.setdefault((one.form.order, one.form.hidden), one)
    return list(found.values())[: max(affordable(search, leader.form), 1)]


def _mean(search: Search, rung: str, members: Sequence[Tried], weights: FloatArray) -> Tried | None:
    """Mean of the few members that count; None where one alone does."""
    order = [k for k in np.argsort(-weights, kind="stable")[:_MIXED] if weights[k] > _LEAST_WEIGHT]
    if len(order) < 2:
        return None
    used = [members[k] for k in order]
    share = weights[order] / weights[order].sum()
    errors = tuple(
        np.tensordot(share, np.stack([one.errors[k] for one in used]), 1)
        for k in range(len(used[0].errors))
    )
    texts = [one.form.text if one.form.rung == rung else one.form.rung for one in used]
    form = Form(
        rung,
        " + ".join(f"{w:.2f} {text}" for w, text in zip(share, texts, strict=True)),
        sum(one.form.parameters for one in used),
        min(one.form.samples for one in used),
    )

    def build(part: float) -> DynamicModel:
        # Each takes what those before it leave in equal parts.
        models = [one.build(part / (len(used) - k)) for k, one in enumerate(used)]
        return Ensemble(tuple(models), tuple(share.tolist()))

    pieces = [run for fold in search.folds for run in fold.held]
    return Tried(form, np.array(by_piece(pieces, errors)), errors, build)


def _chosen(search: Search) -> Choice:
    """The leading form on all records."""
    leader, reason = leading(search.tried)
    search.work.end_search()
    search.watch(0.9, f"fitting {leader.form.rung} to all records")
    if leader.form.rung == LATENT:
        # Which size leads hangs on the draws of hidden units; the mean of sizes hangs on them less.
        sizes = _sizes(search, leader)
        mean = _mean(search, LATENT, sizes, pseudo_bma(sizes))
        if mean is not None:
            search.tried.append(mean)
            leader, reason = mean, f"{reason}; other sizes are averaged with it by their errors"
    model = leader.build(1.0)
    search.watch(1.0, "done")
    if search.work.cut:
        search.note("the clock shortened the search: the result depends on the machine")
    return Choice(
        model=model,
        rung=leader.form.rung,
        tried=table(search.tried, leader),
        reason=reason,
        status="; ".join(["all folds done", *search.notes]),
        budget=int(search.work.budget),
        spent=int(search.work.spent),
        intervals=_intervals(search, leader),
    )


def _intervals(search: Search, leader: Tried) -> Conformal:
    names = [run.record.name for fold in search.folds for run in fold.held]
    numbers = {name: number for number, name in enumerate(dict.fromkeys(names))}
    after = [np.arange(1.0, len(error) + 1.0) for error in leader.errors]
    piece = [
        np.full(len(error), numbers[name]) for name, error in zip(names, leader.errors, strict=True)
    ]
    errors = np.abs(np.concatenate(leader.errors)) * search.scalings[1].scale
    return Conformal(np.concatenate(after), errors, np.concatenate(piece))


def _without_folds(search: Search) -> Choice:
    """Too little to hold anything out: a first-order lag, and a status that says so."""
    m, p = search.inputs, search.outputs
    nothing = Conformal(np.ones(1), np.full((1, p), np.nan), np.zeros(1, dtype=np.int64))
    return Choice(
        model=linear_model(search, Shape(1, m, p, 0, (0,) * m)),
        rung=LAG,
        tried=pd.DataFrame([{"rung": LAG, "form": "1 state", "chosen": True}]),
        reason="the records are too short to hold anything out, so the simplest form is fitted",
        status="nothing could be held out: add longer records",
        budget=int(search.work.budget),
        spent=0,
        intervals=nothing,
    )


# ---- rank


def comparable(tried: Sequence[Tried]) -> list[Tried]:
    """Forms with a finite score on all folds."""
    return [one for one in tried if one.whole and np.isfinite(one.score)]


def best_by_rung(tried: Sequence[Tried]) -> list[Tried]:
    """Best form of each rung, best first."""
    found: dict[str, Tried] = {}
    for one in sorted(comparable(tried), key=lambda one: one.score):
        found.setdefault(one.form.rung, one)
    return list(found.values())


def leading(tried: Sequence[Tried]) -> tuple[Tried, str]:
    """The simplest form that none beats, and why."""
    forms = comparable(tried)
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
