"""Choose the form of a model by free runs on folds: the simplest that is not beaten.

The ladder, each rung started from the one below:

| rung | model |
|---|---|
| first-order lag | linear output error with one state |
| ARX | least squares on one step, orders and dead time by the folds |
| linear output error | 2 to 8 states, dead time or none |
| NARX network | eight lags and taps, 8 hidden units on a linear path |
| latent states | 1 to 8 states, 4 to 16 hidden units, from the linear model on (training.latent) |
| mean | weighted mean of the best of two rungs |

Folds are records, or blocks of them where there are fewer than four, with a gap of one memory
length beside what is held out. Each held-out piece is simulated twice, from its beginning and from
a third of it, after windows of measured outputs of two lengths. The score is the mean over pieces
of the RMS error in standard deviations of the outputs. The simplest form leads, that of fewest
parameters, that no other beats by two percent and by more than one standard error of their
difference piece by piece (Breiman et al. 1984, section 3.4.3, with paired errors).

Work is counted in sample-steps of a nominal microsecond, so that the choice does not depend on how
busy the machine is. Forms of the latent rung are halved: all of them on part of the data, the
better ones on more of it.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial

import numpy as np
import pandas as pd
from scipy.optimize import nnls

from narxcal.narx.config import NarxConfig
from narxcal.narx.forms import Conformal, DynamicModel, Ensemble
from narxcal.narx.latent import LatentModel, Shape
from narxcal.narx.network import NarxModel, Scaling, Weights, tap
from narxcal.record import Record
from narxcal.support.arrays import FloatArray
from narxcal.support.errors import DataError
from training.config import TrainConfig
from training.held_out import (
    FOLDS,
    SHORTEST,
    WINDOW,
    Fold,
    by_piece,
    folds_of,
    runs_of,
    thinned,
)
from training.latent import (
    Data,
    Fitted,
    Starts,
    at_decay,
    fit_linear,
    grown,
    model_of,
    moved,
    path,
)
from training.network import Material, fit_narx

UNITS_PER_S = 1_000_000  # sample-steps of one nominal microsecond in a CPU second
_EMERGENCY = 4.0, 60.0  # the clock stops the search at so many times the limit and CPU s more
_UNITS_PER_SAMPLE = 6000.0  # of the budget; with less there are half as many folds
_LEAST_LINEAR = 2000  # samples per fold that linear models get whatever they cost
_ORDERS = (1, 2, 3, 4, 5, 6, 8)
_ARX_ORDERS = (1, 2, 3, 5, 8, 15, 30)
_HIDDEN = (4, 8, 16)
_DECAYS = tuple(10.0**-k for k in range(2, 10))
_STEPS = 8  # of Levenberg-Marquardt at each decay
_DRAWS = 6  # of hidden units: their median is the model, so that it does not depend on one draw
_BETTER = 0.98  # of a simpler form's score, as in training.lags: folds have less data than the fit
_FAR = 3.0  # times the lowest loss of the draws: twice its error or nearly so
_LEAST = 5.0  # rows per parameter; fewer determine nothing
_FEW = 400  # samples per fold on which no form is worth trying
_PLENTY = 30.0  # rows per parameter beyond which every further one is skipped while searching
_NETWORK = NarxConfig(lags=8, taps=tuple(range(9)), hidden=8)
_NETWORK_TRAIN = TrainConfig(
    horizons_s=(20.0, 200.0, 0.0), iterations=(10, 15, 25), score_every_s=1.0, threads=1
)
_NETWORK_COST = 2.6  # nominal microseconds a sample-step: 53 000 samples x 70 steps in 9.8 CPU s
LAG, ARX, OUTPUT_ERROR = "first-order lag", "ARX", "linear output error"
NETWORK, LATENT, MEAN = "NARX network", "latent states", "mean"

Watch = Callable[[float, str], None]
Known = tuple[Fitted, LatentModel]


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
    """A form with its score by held-out piece, held-out errors and the fit to all records."""

    form: Form
    scores: FloatArray
    errors: tuple[FloatArray, ...]
    build: Callable[[], DynamicModel]

    @property
    def score(self) -> float:
        """Mean over folds; infinite where a fold has no finite free run."""
        mean = float(np.mean(self.scores))
        return mean if np.isfinite(mean) else np.inf


@dataclass(frozen=True, eq=False)
class Choice:
    """The chosen model, everything that was tried, why, and what it cost.

    `tried` has a row per form: rung, form, parameters, score, standard_error (of the difference to
    the best), samples, chosen. `intervals` are held-out errors by horizon.
    """

    model: DynamicModel
    rung: str
    tried: pd.DataFrame
    reason: str
    status: str
    budget: int
    spent: int
    intervals: Conformal


@dataclass
class _Work:
    """Sample-steps spent of a budget; the clock stops the search only in an emergency."""

    budget: float
    limit_s: float
    spent: float = 0.0
    began: float = field(default_factory=time.process_time)

    def spend(self, units: float) -> None:
        self.spent += units

    @property
    def late(self) -> bool:
        return time.process_time() - self.began > _EMERGENCY[0] * self.limit_s + _EMERGENCY[1]

    def affords(self, units: float) -> bool:
        return self.spent + units <= self.budget and not self.late


@dataclass(frozen=True)
class Limits:
    """CPU seconds of the search, seed of the draws, and whether only linear rungs are tried."""

    time_limit_s: float = 120.0
    seed: int = 0
    linear: bool = False


def choose(
    records: Sequence[Record],
    limits: Limits,
    watch: Watch | None = None,
    validation: Sequence[Record] = (),
) -> Choice:
    """Search the ladder within a budget, and fit the chosen form to all records.

    With `validation` records these are held out in place of folds. Raises `DataError` where no
    record is long enough to fit.
    """
    search = _Search(list(records), limits, watch or (lambda _share, _what: None))
    return search.run(validation)


class _Search:
    """One search: records, folds, what was tried and what was spent."""

    def __init__(self, records: list[Record], limits: Limits, watch: Watch) -> None:
        self.records = [r for r in records if len(r) >= SHORTEST and np.isfinite(r.y).any()]
        if not self.records:
            longest = max(len(record) for record in records)
            raise DataError(
                f"the longest record has {longest} samples with outputs, and at least {SHORTEST} "
                "are needed to fit and to hold something out",
                hint="Add longer records",
            )
        self.work = _Work(limits.time_limit_s * UNITS_PER_S, limits.time_limit_s)
        self.limits, self.seed, self.watch = limits, limits.seed, watch
        u = np.concatenate([record.u for record in self.records])
        y = np.concatenate([record.y for record in self.records])
        self.scalings = (Scaling.of(u), Scaling.of(y))
        self.inputs, self.outputs = u.shape[1], y.shape[1]
        self.samples = len(u)
        self.tried: list[Tried] = []
        self.notes: list[str] = []

    def run(self, validation: Sequence[Record] = ()) -> Choice:
        """The ladder from below, the mean, the rule, the final fit."""
        self.watch(0.0, "dead time")
        self.delays = self._delays()
        if validation:
            runs = tuple(run for record in validation for run in runs_of(record))
            self.folds = [Fold(tuple(self.records), runs)] if runs else []
        else:
            many = self.samples > self.work.budget / _UNITS_PER_SAMPLE
            self.folds = folds_of(self.records, self._gap(), FOLDS if many else 2 * FOLDS)
        if not self.folds:
            return self._without_folds()
        rungs = [self._arx, self._linear, self._latent, self._network, self._mean]
        for rung in rungs[:2] if self.limits.linear else rungs:
            rung()
            self.watch(min(self.work.spent / self.work.budget, 0.9), "choosing")
        leader, reason = self._leader()
        self.watch(0.9, f"fitting {leader.form.rung} to all records")
        model = leader.build()
        self.watch(1.0, "done")
        if self.work.late:
            self.notes.append("the clock ended the search: the result depends on the machine")
        return Choice(
            model=model,
            rung=leader.form.rung,
            tried=self._table(leader),
            reason=reason,
            status="; ".join(["all folds done", *self.notes]),
            budget=int(self.work.budget),
            spent=int(self.work.spent),
            intervals=self._intervals(leader),
        )

    def _gap(self) -> int:
        """Samples left out beside a held-out block: until a start is forgotten, at most 2 %."""
        return min(WINDOW, self.samples // 50)

    def _delays(self) -> list[tuple[int, ...]]:
        """No dead time, and the one by which a short ARX model predicts best, if there is any."""
        none = (0,) * self.inputs
        data = Data.of(thinned(self.records, 20000), none, self.scalings)
        most = min(60, min(len(u) for u in data.inputs) // 10)
        found = list(none)
        for j in range(self.inputs):
            errors = [_short_arx_error(data, (*found[:j], d, *found[j + 1 :])) for d in range(most)]
            # The least within half a percent of the best: too long a one cannot be undone.
            found[j] = int(np.argmax(np.array(errors) <= 1.005 * min(errors))) if errors else 0
        return [none] if not any(found) else [none, tuple(found)]

    def _score(
        self, form: Form, fits: Sequence[DynamicModel], build: Callable[[], DynamicModel]
    ) -> Tried:
        """Judge one model per fold on what that fold held out."""
        scores, errors, scale = [], [], self.scalings[1].scale
        for model, fold in zip(fits, self.folds, strict=True):
            own = [run.error(model) / scale for run in fold.held]
            errors += own
            scores += by_piece(fold.held, own)
        return Tried(form, np.array(scores), tuple(errors), build)

    def _arx(self) -> None:
        """ARX models of several orders with and without dead time."""
        for delay in self.delays:
            for order in _ARX_ORDERS:
                if 3 * order * (self.outputs + self.inputs) > self.samples * 3 // 4:
                    break
                fits = [arx_model(fold.fit, order, delay, self.scalings) for fold in self.folds]
                width = order * self.outputs + (order + 1) * self.inputs + 1
                text = f"{order} lags{_dead(delay)}"
                form = Form("ARX", text, width * self.outputs, self.samples, delay)
                build = partial(arx_model, self.records, order, delay, self.scalings)
                self.tried.append(self._score(form, fits, build))
                self.work.spend(len(self.folds) * self.samples * width**2 / _MAC)

    def _linear(self) -> None:
        """Linear output error of every order; a single state is the first-order lag."""
        costs = sum(_cost(n, 0, self.inputs, self.outputs) for n in _ORDERS)
        most = max(self._affordable(0.12, costs * len(self.delays) * 20), _LEAST_LINEAR)
        self.bases: dict[tuple[int, tuple[int, ...]], list[Known]] = {}
        for delay in self.delays:
            datas = [Data.of(thinned(f.fit, most), delay, self.scalings) for f in self.folds]
            starts = [Starts.of(data) for data in datas]
            for n in _ORDERS:
                shape = Shape(n, self.inputs, self.outputs, 0, delay)
                fits = [fit_linear(d, shape, s) for d, s in zip(datas, starts, strict=True)]
                self.work.spend(20 * _cost(n, 0, self.inputs, self.outputs) * _samples(datas))
                known = [(f, self._model(f, d)) for f, d in zip(fits, datas, strict=True) if f]
                if len(known) < len(self.folds):
                    continue
                self.bases[n, delay] = known
                models = [model for _, model in known]
                rung, text = (LAG, "1 state") if n == 1 else (OUTPUT_ERROR, f"{n} states")
                samples = _samples(datas) // len(self.folds)
                form = Form(rung, text + _dead(delay), shape.size, samples, delay, n)
                self.tried.append(self._score(form, models, partial(self._final_linear, shape)))

    def _model(self, fitted: Fitted, data: Data) -> LatentModel:
        return model_of(fitted, data, self.scalings)

    def _final_linear(self, shape: Shape) -> DynamicModel:
        data = Data.of(self.records, shape.delay, self.scalings)
        fitted = fit_linear(data, shape)
        if fitted is None:  # cannot be: a fallback start exists for every order
            raise DataError("no linear model could be fitted")
        return self._model(fitted, data)

    def _latent(self) -> None:
        """Forms of the latent rung, halved: order first, then hidden units, on growing data."""
        linear = [one for one in self.tried if one.form.rung in (LAG, OUTPUT_ERROR)]
        if not linear:
            return
        delay = min(linear, key=lambda one: one.score).form.delay
        best = {one.form.order: one.score for one in linear if one.form.delay == delay}
        orders = sorted((n for n in _ORDERS if (n, delay) in self.bases), key=lambda n: best[n])
        found = self._round([(n, _HIDDEN[1], delay) for n in orders], 0.2, _DRAWS)
        orders = list(dict.fromkeys(one.form.order for one in found))[:2]
        found = self._round([(n, h, delay) for n in orders for h in _HIDDEN], 0.2, _DRAWS)
        forms = [(one.form.order, one.form.hidden, delay) for one in found[:2]]
        self._round(forms, 0.25, 2 * _DRAWS)

    def _round(
        self, forms: Sequence[tuple[int, int, tuple[int, ...]]], share: float, draws: int
    ) -> list[Tried]:
        """Try forms within a share of the budget; best first. Too large ones are left out."""
        determined = self.samples * self.outputs / _LEAST
        forms = [
            (n, h, delay)
            for n, h, delay in forms
            if Shape(n, self.inputs, self.outputs, h, delay).size <= determined
        ]
        forms, draws, most = self._within(share, forms, draws)
        if not forms:
            return []
        found = []
        for k, form in enumerate(forms):
            if self.work.late:
                break
            found.append(self._try_latent(*form, most, draws))
            done = 0.1 + 0.8 * self.work.spent / self.work.budget
            self.watch(min(done, 0.9), f"form {k + 1} of {len(forms)}")
        self.tried += found
        return sorted(found, key=lambda one: one.score)

    def _within(
        self, share: float, forms: list[tuple[int, int, tuple[int, ...]]], draws: int
    ) -> tuple[list[tuple[int, int, tuple[int, ...]]], int, int]:
        """Forms, draws and samples per fold within a share.

        Fewer draws come before less data, and that before fewer forms.
        """
        whole = max(sum(map(len, fold.fit)) for fold in self.folds)
        while forms:
            steps = len(_DECAYS) * _STEPS * draws * len(self.folds)
            most = self._most(share * self.work.budget / steps, [form[:2] for form in forms])
            if most >= whole or (draws <= 2 and most >= min(_FEW, whole)):
                return forms, draws, most
            if draws > 2:
                draws = max(draws // 2, 2)
            else:
                forms = forms[: len(forms) // 2]
        note = "latent forms were left out: the budget is too small"
        self.notes += [] if note in self.notes else [note]
        return [], 1, 0

    def _try_latent(self, n: int, h: int, delay: tuple[int, ...], most: int, draws: int) -> Tried:
        """One form on all folds along falling decays; its best decay over the folds."""
        levels: list[list[DynamicModel]] = [[] for _ in _DECAYS]
        shape = Shape(n, self.inputs, self.outputs, h, delay)
        samples = 0
        for number, fold in enumerate(self.folds):
            records = thinned(fold.fit, most)
            data = self._data(records, delay, shape.size)
            base = moved(*self.bases[n, delay][number], data)
            samples += sum(map(len, records))
            for level, fits in zip(levels, self._paths(base, data, h, draws), strict=True):
                members = [self._model(fitted, data) for fitted in _near_the_best(fits)]
                level.append(Ensemble.median(members))
        tried = []
        for k, (decay, models) in enumerate(zip(_DECAYS, levels, strict=True)):
            text = f"{n} states, {h} hidden{_dead(delay)}, decay {decay:g}"
            form = Form(LATENT, text, shape.size, samples // len(self.folds), delay, n, h)
            tried.append(self._score(form, models, partial(self._final_latent, shape, k)))
        return min(tried, key=lambda one: one.score)

    def _data(self, records: Sequence[Record], delay: tuple[int, ...], parameters: int) -> Data:
        """Scored are all rows, or about `_PLENTY` per parameter where there are more."""
        rows = sum(map(len, records)) * self.outputs
        return Data.of(records, delay, self.scalings, max(round(rows / (_PLENTY * parameters)), 1))

    def _paths(
        self, base: Fitted, data: Data, h: int, draws: int, decays: Sequence[float] = _DECAYS
    ) -> Iterator[list[Fitted]]:
        """Fits of every draw of hidden units, decay by decay."""
        cost = self._step_cost(base.shape.states, h, sum(map(len, data.inputs)))
        starts = [grown(base, h, seed=self.seed * 1000 + k) for k in range(draws)]
        paths = [path(start, data, decays, _STEPS) for start in starts]
        for found in zip(*paths, strict=True):
            self.work.spend(cost * sum(used for _, used in found))
            yield [fitted for fitted, _ in found]

    def _final_latent(self, shape: Shape, level: int) -> DynamicModel:
        """The path to the chosen decay on as many records as the budget allows, then on all."""
        n, h = shape.states, shape.hidden
        decays = _DECAYS[: level + 1]
        units = 0.15 * self.work.budget / (len(decays) * _STEPS * _DRAWS)
        most = max(self._most(units, [(n, h)]), min(_FEW, self.samples))
        linear = Shape(shape.states, self.inputs, self.outputs, 0, shape.delay)
        data = self._data(thinned(self.records, most), shape.delay, shape.size)
        base = fit_linear(data, linear)
        if base is None:  # cannot be: a fallback start exists for every order
            raise DataError("no linear model could be fitted")
        fits = list(self._paths(base, data, shape.hidden, _DRAWS, decays))[-1]
        every = self._data(self.records, shape.delay, shape.size)
        cost = self._step_cost(n, h, self.samples)
        left = (self.work.budget - self.work.spent) / (cost * _DRAWS)
        steps = int(np.clip(left, 2, 8 * _STEPS)) if most < self.samples else 2
        members = []
        for number, fitted in enumerate(_near_the_best(fits)):
            self.watch(0.9 + 0.1 * number / len(fits), "fitting to all records")
            start = moved(fitted, self._model(fitted, data), every)
            ended, _, used = at_decay(start, every, decays[-1], steps)
            self.work.spend(cost * used)
            members.append((ended, self._model(ended, every)))
        kept = _near_the_best([ended for ended, _ in members])
        return Ensemble.median([model for ended, model in members if ended in kept])

    def _network(self) -> None:
        """The NARX network of eight lags, where the budget lets it be trained on every fold."""
        steps = sum(_NETWORK_TRAIN.iterations)
        most = self._affordable(0.2, _NETWORK_COST * steps * 2)
        if most < min(400, self.samples // 2) or self._shortest() <= _NETWORK.taps[-1] + 1:
            self.notes.append("the NARX network was left out: the budget or a record is too short")
            return
        for decay in (1e-3, 1e-5):
            train = _NETWORK_TRAIN.model_copy(update={"decay": decay, "seed": self.seed})
            fits = []
            for fold in self.folds:
                records = [r for r in thinned(fold.fit, most) if len(r) > _NETWORK.taps[-1] + 1]
                fits.append(fit_narx(Material(records, (), 1.0), _NETWORK, train).model)
                self.work.spend(_NETWORK_COST * steps * sum(map(len, records)))
            size = len(fits[0].weights.theta)
            text = f"8 lags, 8 hidden, decay {decay:g}"
            form = Form(NETWORK, text, size, min(most, self.samples))
            self.tried.append(self._score(form, fits, partial(self._final_network, train)))

    def _shortest(self) -> int:
        return min(len(record) for fold in self.folds for record in fold.fit)

    def _final_network(self, train: TrainConfig) -> DynamicModel:
        records = [r for r in self.records if len(r) > _NETWORK.taps[-1] + 1]
        most = self._affordable(0.3, _NETWORK_COST * sum(train.iterations), folds=1)
        return fit_narx(Material(thinned(records, most), (), 1.0), _NETWORK, train).model

    def _mean(self) -> None:
        """Weighted mean of the best form of each rung, weights by least squares on other pieces."""
        best = self._best()
        if len(best) < 2:
            return
        best = best[:3]
        runs = range(len(best[0].errors))
        pieces = [run for fold in self.folds for run in fold.held]
        names = [run.record.name for run in pieces]
        errors = [np.stack([one.errors[k].ravel() for one in best], axis=1) for k in runs]
        mixed = []
        for k in runs:
            others = [errors[j] for j in runs if names[j] != names[k]]
            weights = _simplex(np.concatenate(others)) if others else np.eye(len(best))[0]
            mixed.append((errors[k] @ weights).reshape(best[0].errors[k].shape))
        weights = _simplex(np.concatenate(errors))
        used = [(one, w) for one, w in zip(best, weights, strict=True) if w > 0.02]
        if len(used) < 2:
            return
        scores = by_piece(pieces, mixed)
        total = sum(w for _, w in used)
        text = " + ".join(f"{w / total:.2f} {one.form.rung}" for one, w in used)
        parameters = sum(one.form.parameters for one, _ in used)
        form = Form(MEAN, text, parameters, min(one.form.samples for one, _ in used))

        def build() -> DynamicModel:
            return Ensemble(
                tuple(one.build() for one, _ in used), tuple(w / total for _, w in used)
            )

        self.tried.append(Tried(form, np.array(scores), tuple(mixed), build))

    def _comparable(self) -> list[Tried]:
        """Forms with a finite score: all of them are judged on the same held-out pieces."""
        return [one for one in self.tried if np.isfinite(one.score)]

    def _best(self) -> list[Tried]:
        """Best form of each rung, best first."""
        found: dict[str, Tried] = {}
        for one in sorted(self._comparable(), key=lambda one: one.score):
            found.setdefault(one.form.rung, one)
        return list(found.values())

    def _leader(self) -> tuple[Tried, str]:
        """The form of fewest parameters that none beats by a standard error, and why."""
        forms = sorted(self._comparable(), key=lambda one: one.form.parameters)
        if not forms:
            raise DataError("no form has a finite free run over what was held out")
        least = min(forms, key=lambda one: one.score)
        leader = next(one for one in forms if not any(_beats(other, one) for other in forms))
        name = f"{leader.form.rung} ({leader.form.text})"
        simpler = [one for one in self._best() if one.form.rung != leader.form.rung]
        simpler = [one for one in simpler if one.form.parameters < leader.form.parameters]
        if leader is not least:
            reason = (
                f"{name} is the simplest form that none beats by more than one standard error: "
                f"{leader.score:.3g} standard deviations of the outputs in held-out free runs, "
                f"the best form, {least.form.rung}, {least.score:.3g}"
            )
        elif simpler:
            second = min(simpler, key=lambda each: each.score)
            reason = (
                f"{name} has the lowest error in held-out free runs, {leader.score:.3g} standard "
                f"deviations of the outputs; the best simpler form, {second.form.rung}, has "
                f"{second.score:.3g}"
            )
        else:
            reason = f"{name} is the simplest form, and none has a lower error in held-out runs"
        return leader, reason

    def _table(self, leader: Tried) -> pd.DataFrame:
        rows = [
            {
                "rung": one.form.rung,
                "form": one.form.text,
                "parameters": one.form.parameters,
                "samples": one.form.samples,
                "score": one.score,
                "standard_error": _standard_error(one.scores - leader.scores),
                "chosen": one is leader,
            }
            for one in self.tried
        ]
        return pd.DataFrame(rows).sort_values("score", ignore_index=True, kind="stable")

    def _intervals(self, leader: Tried) -> Conformal:
        names = [run.record.name for fold in self.folds for run in fold.held]
        numbers = {name: number for number, name in enumerate(dict.fromkeys(names))}
        after = [np.arange(1.0, len(error) + 1.0) for error in leader.errors]
        piece = [
            np.full(len(error), numbers[name])
            for name, error in zip(names, leader.errors, strict=True)
        ]
        errors = np.abs(np.concatenate(leader.errors)) * self.scalings[1].scale
        return Conformal(np.concatenate(after), errors, np.concatenate(piece))

    def _without_folds(self) -> Choice:
        """Too little to hold anything out: a first-order lag, and a status that says so."""
        shape = Shape(1, self.inputs, self.outputs, 0, (0,) * self.inputs)
        table = pd.DataFrame([{"rung": LAG, "form": "1 state", "chosen": True}])
        reason = "the records are too short to hold anything out, so the simplest form is fitted"
        nothing = Conformal(
            np.ones(1), np.full((1, self.outputs), np.nan), np.zeros(1, dtype=np.int64)
        )
        return Choice(
            self._final_linear(shape), LAG, table, reason,
            "nothing could be held out: add longer records", int(self.work.budget), 0, nothing,
        )  # fmt: skip

    def _most(self, units: float, sizes: Sequence[tuple[int, int]]) -> int:
        """Samples on which one step of all forms (states, hidden units) costs `units`."""
        low, high = 0, self.samples
        while low < high:
            middle = (low + high + 1) // 2
            if sum(self._step_cost(n, h, middle) for n, h in sizes) <= units:
                low = middle
            else:
                high = middle - 1
        return low

    def _step_cost(self, n: int, h: int, samples: int) -> float:
        """Nominal microseconds of a step of Levenberg-Marquardt on so many samples."""
        size: int = Shape(n, self.inputs, self.outputs, h, (0,) * self.inputs).size
        rows = min(float(self.outputs * samples), 2.0 * _PLENTY * size)
        return samples * (0.6 + n * n * size / _MAC_RECURSION) + rows * size * size / _MAC_PRODUCT

    def _affordable(self, share: float, per_sample: float, folds: int | None = None) -> int:
        """Samples per fold within a share of the budget."""
        count = len(self.folds) if folds is None else folds
        return int(share * self.work.budget / max(per_sample * count, 1e-9))


_MAC = 4000.0  # multiply-adds in a nominal microsecond of a least-squares product
_MAC_RECURSION, _MAC_PRODUCT = 10_000.0, 20_000.0  # of sensitivities, and of J'J (half is computed)


def _cost(n: int, h: int, m: int, p: int) -> float:
    """Nominal microseconds per sample-step where every row is scored."""
    size = Shape(n, m, p, h, (0,) * m).size + n
    return 0.6 + n * n * size / _MAC_RECURSION + p * size * size / _MAC_PRODUCT


def _near_the_best(fits: Sequence[Fitted]) -> list[Fitted]:
    """Fits of several draws without those that ended in a minimum far above the lowest one."""
    least = min(fitted.loss for fitted in fits)
    return [fitted for fitted in fits if fitted.loss <= _FAR * least]


def _samples(datas: Sequence[Data]) -> int:
    return sum(len(u) for data in datas for u in data.inputs)


def _short_arx_error(data: Data, delay: tuple[int, ...]) -> float:
    """One-step error of an ARX model of two past outputs and two inputs behind dead times."""
    rows, targets = [], []
    first = max(delay) + 2
    for u, y in zip(data.inputs, data.measured, strict=True):
        k = np.arange(first, len(y))
        drive = [u[k - d - i, j] for j, d in enumerate(delay) for i in (0, 1)]
        phi = np.column_stack([y[k - 1], y[k - 2], *drive, np.ones(len(k))])
        known = np.isfinite(phi).all(axis=1) & np.isfinite(y[k]).all(axis=1)
        rows.append(phi[known])
        targets.append(y[k][known])
    phi, target = np.concatenate(rows), np.concatenate(targets)
    if len(phi) <= phi.shape[1]:
        return np.inf
    error = target - phi @ np.linalg.lstsq(phi, target, rcond=None)[0]
    return float(np.mean(error**2))


def _beats(one: Tried, other: Tried) -> bool:
    """Whether `one` is better than `other` by two percent and one standard error at least."""
    clear = other.score - one.score > _standard_error(other.scores - one.scores)
    return clear and one.score < _BETTER * other.score


def _standard_error(differences: FloatArray) -> float:
    """Standard error of the mean; that of a single piece is unknown, and taken as none."""
    if len(differences) < 2:
        return 0.0
    found = float(np.std(differences, ddof=1) / np.sqrt(len(differences)))
    return found if np.isfinite(found) else 0.0


def _simplex(errors: FloatArray) -> FloatArray:
    """Weights >= 0 of sum 1 with the least mean square of `errors` (rows, models) times them."""
    errors = errors[np.isfinite(errors).all(axis=1)]
    normal = errors.T @ errors / max(len(errors), 1)
    normal += (1e-9 * np.trace(normal) + 1e-30) * np.eye(len(normal))
    factor = np.linalg.cholesky(normal)
    heavy = 1e3 * np.sqrt(np.trace(normal))
    matrix = np.vstack([factor.T, np.full((1, len(normal)), heavy)])
    weights = nnls(matrix, np.concatenate([np.zeros(len(normal)), [heavy]]))[0]
    return np.asarray(weights / weights.sum())


def _dead(delay: tuple[int, ...]) -> str:
    return f", dead time {', '.join(map(str, delay))}" if any(delay) else ""


def arx_model(
    records: Sequence[Record], order: int, delay: tuple[int, ...], scalings: tuple[Scaling, Scaling]
) -> NarxModel:
    """Least squares on one step of `order` past outputs and inputs, as a network without any unit.

    One dead time, the shortest, holds for all inputs.
    """
    first = min(delay)
    taps = tuple(range(first, first + order + 1))
    config = NarxConfig(lags=order, taps=taps, hidden=1, margin=1.0)
    p, m = records[0].y.shape[1], records[0].u.shape[1]
    width = order * p + len(taps) * m
    normal, right, count = np.zeros((width + 1, width + 1)), np.zeros((width + 1, p)), 0
    low, high = np.full(p, np.inf), np.full(p, -np.inf)
    for record in records:
        u, y = scalings[0].down(record.u), scalings[1].down(record.y)
        rows = np.arange(min(order, len(y)), len(y))
        if not len(rows):
            continue
        past = np.concatenate([y[rows - i] for i in range(1, order + 1)], axis=1)
        phi = np.concatenate([past, tap(u, taps)[rows], np.ones((len(rows), 1))], axis=1)
        known = np.isfinite(phi).all(axis=1) & np.isfinite(y[rows]).all(axis=1)
        phi, target = phi[known], y[rows][known]
        normal, right = normal + phi.T @ phi, right + phi.T @ target
        count += len(phi)
        low, high = np.fmin(low, np.nanmin(y, axis=0)), np.fmax(high, np.nanmax(y, axis=0))
    normal[np.diag_indices(width + 1)] += 1e-9 * max(count, 1)
    solution = np.linalg.solve(normal, right).T
    wide = config.margin * (high - low) + 1e-9
    weights = Weights(
        config=config, w1=np.zeros((1, width)), b1=np.zeros(1), w2=np.zeros((p, 1)),
        b2=solution[:, -1].copy(), a=np.ascontiguousarray(solution[:, :-1]),
        low=low - wide, high=high + wide,
    )  # fmt: skip
    return NarxModel(weights, *scalings)
