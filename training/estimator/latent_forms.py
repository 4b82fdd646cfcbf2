"""The latent rung of a choice: forms are halved, all with little effort, the better with more.

Orders of the linear model first, then hidden units, then the best few on all folds. Every form
falls along the decays; the median of several draws of hidden units is judged at each of them. Where
the budget is short, effort is saved in this order: draws, folds, samples beyond those that
determine the parameters, forms, and more samples last: what a record holds in one place only is
missing in parts of it. In the last round forms are saved before a median would be one of fewer than
three draws. Descents end early: what a round leaves of the budget goes to the next, and what the
last one leaves to the fit to all records, as further draws.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from narxcal.narx.forms import DynamicModel, Ensemble
from narxcal.narx.latent import LatentModel, Shape
from narxcal.record import Record
from narxcal.support.errors import DataError
from training.estimator.forms import ORDERS, Bases
from training.estimator.latent import (
    Data,
    Fitted,
    at_decay,
    fit_linear,
    grown,
    model_of,
    moved,
    path,
)
from training.estimator.search import (
    FEW,
    LAG,
    LATENT,
    LATENT_STEP,
    OUTPUT_ERROR,
    PLENTY,
    Form,
    Search,
    Tried,
    beats,
    dead,
    most_samples,
    near_the_best,
    thinned,
)

_HIDDEN = (4, 8, 16)
_DECAYS = tuple(10.0**-k for k in range(2, 10))
_STEPS = 8  # of Levenberg-Marquardt at each decay
_DRAWS = 12  # of hidden units: their median is the model, so that it does not depend on one draw
_FEWEST_DRAWS, _MOST_DRAWS = 6, 48  # of the fit to all records: then samples are saved
_FEWEST = 3  # draws of a form in the last round where there are several forms
_LAST = 4  # forms of the last round
_LEAST = 5.0  # rows per parameter; fewer determine nothing
_SCREENED = 10.0  # before the last round: a tenth more squared error, in all forms alike
_SHARES = 0.3, 0.4, 0.9  # of what is left for orders, hidden units, and the best few
_FINAL_SHARE = 0.15  # of the budget, kept for the fit to all records
_SPARED = 0.25  # of the samples of a fold at least are kept before forms are left out

Sizes = tuple[int, int, tuple[int, ...]]  # states, hidden units, dead times


@dataclass(frozen=True)
class _Effort:
    """Folds by number, draws of hidden units, scored rows per parameter, samples per fold."""

    folds: tuple[int, ...]
    draws: int
    rows: float  # per parameter that are scored where there are more
    samples: int = 0

    @property
    def steps(self) -> int:
        """Steps of Levenberg-Marquardt for one form."""
        return len(self.folds) * len(_DECAYS) * _STEPS * self.draws


def _efforts(folds: int, forms: int) -> list[tuple[int, _Effort]]:
    """Forms, and effort for each, of a round before the last: from the largest to the least.

    A draw on each of two folds says more than two draws on one: pieces differ, too.
    """
    every, some = tuple(range(folds)), tuple(sorted({0, folds // 2}))
    found = [_Effort(every, draws, _SCREENED) for draws in range(_DRAWS, 0, -1)]
    found += [_Effort(every[::2], 1, _SCREENED), _Effort(some, 1, _SCREENED)]
    return [(forms, effort) for effort in found]


def _last_efforts(folds: int, forms: int) -> list[tuple[int, _Effort]]:
    """The same of the last round, which takes all folds."""
    every = tuple(range(folds))
    several = [n for n in (_LAST, _LAST // 2) if n <= forms]
    found = [(n, draws) for n in several for draws in range(2 * _DRAWS, _FEWEST - 1, -1)]
    found += [(1, draws) for draws in range(2 * _DRAWS, 0, -1)]
    return [(n, _Effort(every, draws, PLENTY)) for n, draws in found]


def _fewer(forms: list[Sizes], *, last: bool) -> list[list[Sizes]]:
    """Parts of the forms: half of them and so on; in the last round each alone, the best first."""
    if last:
        return [[form] for form in forms]
    return [forms[: len(forms) >> k] for k in range(len(forms).bit_length())]


def try_latent(search: Search, bases: Bases) -> None:
    """Halve the forms: orders, hidden units, the best few."""
    linear = [one for one in search.tried if one.form.rung in (LAG, OUTPUT_ERROR)]
    if not linear:
        return
    delay = min(linear, key=lambda one: one.score).form.delay
    same = {one.form.order: one for one in linear if one.form.delay == delay}
    beaten = {n for n, one in same.items() if any(beats(other, one) for other in same.values())}
    # Where not all can be tried: the simplest first of those that no other order beats.
    orders = sorted((n for n in ORDERS if (n, delay) in bases), key=lambda n: (n in beaten, n))
    rung = _Latent(search, bases)
    widths = [h for h in _HIDDEN[1::-1] if any(rung.determined((n, h, delay)) for n in orders)]
    if not widths:
        search.note("latent forms were left out: there are too few samples")
        return
    found = rung.round([(n, widths[0], delay) for n in orders], _SHARES[0])
    orders = list(dict.fromkeys(one.form.order for one in found))[:2]
    found = rung.round([(n, h, delay) for n in orders for h in _HIDDEN], _SHARES[1])
    forms = [(one.form.order, one.form.hidden, delay) for one in found]
    rung.round(forms, _SHARES[2], last=True)


def affordable(search: Search, form: Form) -> int:
    """Models of the size of `form` that can be fitted to all records within what is kept for it."""
    shape = Shape(form.order, search.inputs, search.outputs, form.hidden, form.delay)
    units = search.work.left() / (len(_DECAYS) * _STEPS)
    return int(units / (_FEWEST_DRAWS * _step(shape, search.samples)))


def _step(shape: Shape, samples: int, plenty: float = PLENTY) -> float:
    """Nominal microseconds of a step on so many samples."""
    rows = min(float(shape.outputs * samples), plenty * shape.size)
    return LATENT_STEP.step(samples, rows, shape.size, (shape.hidden, shape.states))


class _Latent:
    """Rounds of one search."""

    def __init__(self, search: Search, bases: Bases) -> None:
        self.search, self.bases = search, bases
        self.planned, self.taken = 0.0, 0.0  # microseconds of steps

    def round(self, forms: Sequence[Sizes], share: float, *, last: bool = False) -> list[Tried]:
        """Try forms within a share of the budget; best first. Too large ones are left out.

        The last round takes all folds.
        """
        search = self.search
        able = [form for form in forms if self.determined(form)]
        if not able:
            return []
        units = share * (search.work.left() - _FINAL_SHARE * search.work.budget) * self.early
        able, effort = self._within(units, able, last=last)
        found = []
        for form in able:
            before = search.work.spent
            tried = self._try(*form, effort)
            if tried is None:
                break
            found.append(tried)
            self.taken += search.work.spent - before
            self.planned += effort.steps * _step(self._shape(*form), effort.samples, effort.rows)
            search.show()
        search.tried += found
        return sorted(found, key=lambda one: one.score)

    @property
    def early(self) -> float:
        """Steps that were planned over those taken: descents end before their last one."""
        return self.planned / self.taken if self.taken else 1.0

    def determined(self, sizes: Sizes) -> bool:
        """Whether there are enough rows for the parameters."""
        return _LEAST * self._shape(*sizes).size <= self.search.samples * self.search.outputs

    def _shape(self, n: int, h: int, delay: tuple[int, ...]) -> Shape:
        return Shape(n, self.search.inputs, self.search.outputs, h, delay)

    def _within(
        self, units: float, forms: list[Sizes], *, last: bool
    ) -> tuple[list[Sizes], _Effort]:
        """Forms and effort that so many units pay for."""
        whole, folds = self.search.whole, len(self.search.folds)
        efforts = (_last_efforts if last else _efforts)(folds, len(forms))
        for count, effort in efforts:
            most = self._most(units / effort.steps, forms[:count], effort.rows)
            if most >= whole:
                return forms[:count], replace(effort, samples=most)
        least = efforts[-1][1]
        for part in _fewer(forms, last=last):
            most = self._most(units / least.steps, part, least.rows)
            if most >= self._spared(part):
                return part, replace(least, samples=most)
        most = self._most(units / least.steps, forms[:1], least.rows)
        if most >= min(FEW, whole):
            return forms[:1], replace(least, samples=most)
        self.search.note("latent forms were left out: the budget is too small")
        return [], least

    def _spared(self, forms: Sequence[Sizes]) -> float:
        """Samples of a fold that are kept before forms are left out."""
        whole = self.search.whole
        needed = max(PLENTY * self._shape(*form).size / self.search.outputs for form in forms)
        return min(max(needed, _SPARED * whole), whole)

    def _most(self, units: float, forms: Sequence[Sizes], plenty: float = PLENTY) -> int:
        """Samples on which one step of all forms costs `units`."""

        def cost(samples: int) -> float:
            return sum(_step(self._shape(*form), samples, plenty) for form in forms)

        return most_samples(cost, units, self.search.samples)

    def _try(self, n: int, h: int, delay: tuple[int, ...], effort: _Effort) -> Tried | None:
        """One form along falling decays; its best decay over the folds; None where it is late."""
        search, shape = self.search, self._shape(n, h, delay)
        levels: list[list[DynamicModel]] = [[] for _ in _DECAYS]
        samples = 0
        for number in effort.folds:
            records = thinned(search.folds[number].fit, effort.samples)
            data = self._data(records, shape, effort.rows)
            base = moved(*self.bases[n, delay][number], data)
            samples += sum(map(len, records))
            paths = self._paths(base, data, shape, effort.draws)
            for level, fits in zip(levels, paths, strict=True):
                members = [
                    model_of(each, data, search.scalings) for each in near_the_best(fits, _loss)
                ]
                level.append(Ensemble.median(members))
            if search.work.late():
                return None
        tried = []
        for decay, models in zip(_DECAYS, levels, strict=True):
            text = f"{n} states, {h} hidden{dead(delay)}, decay {decay:g}"
            form = Form(LATENT, text, shape.size, samples // len(effort.folds), delay, n, h)
            build = partial(self._final, shape, decay)
            tried.append(search.judge(form, models, build, effort.folds))
        return min(tried, key=lambda one: one.score)

    def _data(self, records: Sequence[Record], shape: Shape, plenty: float = PLENTY) -> Data:
        """Scored are all rows, or about `plenty` per parameter where there are more."""
        rows = sum(map(len, records)) * shape.outputs
        every = max(rows / (plenty * shape.size), 1.0)
        return self.search.data(records, shape.delay, every)

    def _paths(
        self,
        base: Fitted,
        data: Data,
        shape: Shape,
        draws: int,
        decays: Sequence[float] = _DECAYS,
    ) -> Iterator[list[Fitted]]:
        """Fits of every draw of hidden units, decay by decay."""
        rows = sum(float((root > 0.0).sum()) for root in data.roots)
        samples = sum(map(len, data.inputs))
        cost = LATENT_STEP.step(samples, rows, shape.size, (shape.hidden, shape.states))
        seed = self.search.seed * 1000
        starts = [grown(base, shape.hidden, seed=seed + k) for k in range(draws)]
        paths = [path(start, data, decays, _STEPS) for start in starts]
        for found in zip(*paths, strict=True):
            self.search.work.spend(cost * sum(used for _, used in found))
            yield [fitted for fitted, _ in found]

    def _final(self, shape: Shape, decay: float, share: float = 1.0) -> DynamicModel:
        """Fit along the decays to as many samples as a share of the budget allows, then to all."""
        search, decays = self.search, [one for one in _DECAYS if one >= decay]
        left = share * max(search.work.left(), 0.0)
        units = left * self.early / (len(decays) * _STEPS)
        sizes = [(shape.states, shape.hidden, shape.delay)]
        for draws in range(_MOST_DRAWS, _FEWEST_DRAWS - 1, -1):
            most = self._most(units / draws, sizes)
            if most >= search.samples:
                break
            most = self._most(units / 2.0 / draws, sizes)  # the other half for steps on all samples
        most, before = max(most, min(FEW, search.samples)), search.work.spent
        data = self._data(thinned(search.records, most), shape)
        linear = self._shape(shape.states, 0, shape.delay)
        base = fit_linear(data, linear)
        if base is None:  # cannot be: a fallback start exists for every order
            raise DataError("no linear model could be fitted")
        fits = list(self._paths(base, data, shape, draws, decays))[-1]
        every = self._data(search.records, shape)
        cost = _step(shape, search.samples)
        further = (left - (search.work.spent - before)) / (cost * draws)
        steps = int(np.clip(further, 2, 8 * _STEPS)) if most < search.samples else 2
        members: list[tuple[Fitted, LatentModel]] = []
        for number, fitted in enumerate(near_the_best(fits, _loss)):
            if members and search.work.late():
                break
            search.watch(0.9 + 0.1 * number / len(fits), "fitting to all records")
            start = moved(fitted, model_of(fitted, data, search.scalings), every)
            ended, _, used = at_decay(start, every, decays[-1], steps)
            search.work.spend(cost * used)
            members.append((ended, model_of(ended, every, search.scalings)))
        kept = near_the_best([ended for ended, _ in members], _loss)
        return Ensemble.median([model for ended, model in members if ended in kept])


def _loss(fitted: Fitted) -> float:
    return fitted.loss
