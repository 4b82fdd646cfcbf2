"""The latent rung of a choice: forms are halved, all with little effort, the better with more.

Orders of the linear model first, then hidden units, then the best two. Every form falls along the
decays; the median of several draws of hidden units is judged at each of them. Where the budget is
short, effort is saved in this order: draws, folds, three quarters of the samples, forms, and more
samples last: what a record holds in one place only is missing in small parts of it. What a round
leaves of the budget goes to the next.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from narxcal.narx.forms import DynamicModel, Ensemble
from narxcal.narx.latent import Shape
from narxcal.record import Record
from narxcal.support.errors import DataError
from training.held_out import thinned
from training.latent import Data, Fitted, at_decay, fit_linear, grown, model_of, moved, path
from training.linear_forms import ORDERS, Bases
from training.ranking import Form, Tried
from training.search import (
    FEW,
    LAG,
    LATENT,
    OUTPUT_ERROR,
    PLENTY,
    Search,
    dead,
    most_samples,
    near_the_best,
    step_cost,
)

_HIDDEN = (4, 8, 16)
_DECAYS = tuple(10.0**-k for k in range(2, 10))
_STEPS = 8  # of Levenberg-Marquardt at each decay
_DRAWS = 12  # of hidden units: their median is the model, so that it does not depend on one draw
_FEWEST_DRAWS = 6  # of the fit to all records: then samples are saved
_FEWEST = 3  # forms of a round: then samples are saved
_LEAST = 5.0  # rows per parameter; fewer determine nothing
_SHARES = 0.3, 0.4, 0.9  # of what is left for orders, hidden units, and the best two
_FINAL_SHARE = 0.15  # of the budget, for the fit to all records
_SPARED = 0.25  # of the samples of a fold are kept before forms are left out

Sizes = tuple[int, int, tuple[int, ...]]  # states, hidden units, dead times


@dataclass(frozen=True)
class _Effort:
    """Folds by number, draws of hidden units, and samples per fold."""

    folds: tuple[int, ...]
    draws: int
    samples: int = 0

    @property
    def steps(self) -> int:
        """Steps of Levenberg-Marquardt for one form."""
        return len(self.folds) * len(_DECAYS) * _STEPS * self.draws


def _efforts(folds: int, draws: int, *, last: bool) -> list[_Effort]:
    """From the largest to the least; the last round takes all folds."""
    every = tuple(range(folds))
    some = every if last else tuple(sorted({0, folds // 2}))
    found = [_Effort(every, n) for n in range(draws, 1, -1)]
    return [*found, _Effort(some, 2), _Effort(some, 1)]


def try_latent(search: Search, bases: Bases) -> None:
    """Halve the forms: orders, hidden units, the best two."""
    linear = [one for one in search.tried if one.form.rung in (LAG, OUTPUT_ERROR)]
    if not linear:
        return
    delay = min(linear, key=lambda one: one.score).form.delay
    best = {one.form.order: one.score for one in linear if one.form.delay == delay}
    orders = sorted((n for n in ORDERS if (n, delay) in bases), key=lambda n: best[n])
    rung = _Latent(search, bases)
    widths = [h for h in _HIDDEN[1::-1] if any(rung.determined((n, h, delay)) for n in orders)]
    if not widths:
        search.note("latent forms were left out: there are too few samples")
        return
    found = rung.round([(n, widths[0], delay) for n in orders], _SHARES[0], _DRAWS)
    orders = list(dict.fromkeys(one.form.order for one in found))[:2]
    found = rung.round([(n, h, delay) for n in orders for h in _HIDDEN], _SHARES[1], _DRAWS)
    forms = [(one.form.order, one.form.hidden, delay) for one in found[:2]]
    rung.round(forms, _SHARES[2], 2 * _DRAWS, last=True)


def affordable(search: Search, form: Form) -> int:
    """Models of the size of `form` that can be fitted to all records within what is kept for it."""
    shape = Shape(form.order, search.inputs, search.outputs, form.hidden, form.delay)
    units = _FINAL_SHARE * search.work.budget / (len(_DECAYS) * _STEPS)
    return int(units / (_FEWEST_DRAWS * _step(shape, search.samples)))


def _step(shape: Shape, samples: int) -> float:
    """Nominal microseconds of a step on so many samples."""
    rows = min(float(shape.outputs * samples), 2.0 * PLENTY * shape.size)
    return step_cost(samples, rows, shape.size, shape.states**2)


class _Latent:
    """Rounds of one search."""

    def __init__(self, search: Search, bases: Bases) -> None:
        self.search, self.bases = search, bases

    def round(
        self, forms: Sequence[Sizes], share: float, draws: int, *, last: bool = False
    ) -> list[Tried]:
        """Try forms within a share of the budget; best first. Too large ones are left out.

        The last round takes all folds.
        """
        search = self.search
        able = [form for form in forms if self.determined(form)]
        if not able:
            return []
        left = (1.0 - _FINAL_SHARE) * search.work.budget - search.work.spent
        efforts = _efforts(len(search.folds), draws, last=last)
        able, effort = self._within(share * left, able, efforts, 1 if last else _FEWEST)
        found = []
        for form in able:
            if search.work.late:
                break
            found.append(self._try(*form, effort))
            search.show()
        search.tried += found
        return sorted(found, key=lambda one: one.score)

    def determined(self, sizes: Sizes) -> bool:
        """Whether there are enough rows for the parameters."""
        return _LEAST * self._shape(*sizes).size <= self.search.samples * self.search.outputs

    def _shape(self, n: int, h: int, delay: tuple[int, ...]) -> Shape:
        return Shape(n, self.search.inputs, self.search.outputs, h, delay)

    def _within(
        self, units: float, forms: list[Sizes], efforts: Sequence[_Effort], fewest: int
    ) -> tuple[list[Sizes], _Effort]:
        """Forms and effort that so many units pay for."""
        whole = self.search.whole
        for effort in efforts:
            most = self._most(units / effort.steps, forms)
            if most >= whole:
                return forms, replace(effort, samples=most)
        least = efforts[-1]
        while forms:
            most = self._most(units / least.steps, forms)
            if most >= _SPARED * whole or (len(forms) <= fewest and most >= min(FEW, whole)):
                return forms, replace(least, samples=most)
            forms = forms[: max(len(forms) // 2, min(fewest, len(forms) - 1))]
        self.search.note("latent forms were left out: the budget is too small")
        return [], least

    def _most(self, units: float, forms: Sequence[Sizes]) -> int:
        """Samples on which one step of all forms costs `units`."""

        def cost(samples: int) -> float:
            return sum(_step(self._shape(*form), samples) for form in forms)

        return most_samples(cost, units, self.search.samples)

    def _try(self, n: int, h: int, delay: tuple[int, ...], effort: _Effort) -> Tried:
        """One form along falling decays; its best decay over the folds."""
        search, shape = self.search, self._shape(n, h, delay)
        levels: list[list[DynamicModel]] = [[] for _ in _DECAYS]
        samples = 0
        for number in effort.folds:
            records = thinned(search.folds[number].fit, effort.samples)
            data = self._data(records, shape)
            base = moved(*self.bases[n, delay][number], data)
            samples += sum(map(len, records))
            paths = self._paths(base, data, shape, effort.draws)
            for level, fits in zip(levels, paths, strict=True):
                members = [
                    model_of(each, data, search.scalings) for each in near_the_best(fits, _loss)
                ]
                level.append(Ensemble.median(members))
        tried = []
        for decay, models in zip(_DECAYS, levels, strict=True):
            text = f"{n} states, {h} hidden{dead(delay)}, decay {decay:g}"
            form = Form(LATENT, text, shape.size, samples // len(effort.folds), delay, n, h)
            build = partial(self._final, shape, decay)
            tried.append(search.judge(form, models, build, effort.folds))
        return min(tried, key=lambda one: one.score)

    def _data(self, records: Sequence[Record], shape: Shape) -> Data:
        """Scored are all rows, or about `PLENTY` per parameter where there are more."""
        rows = sum(map(len, records)) * shape.outputs
        every = max(round(rows / (PLENTY * shape.size)), 1)
        search = self.search
        return Data.of(records, shape.delay, search.scalings, every, search.longest)

    def _paths(
        self,
        base: Fitted,
        data: Data,
        shape: Shape,
        draws: int,
        decays: Sequence[float] = _DECAYS,
    ) -> Iterator[list[Fitted]]:
        """Fits of every draw of hidden units, decay by decay."""
        cost = _step(shape, sum(map(len, data.inputs)))
        seed = self.search.seed * 1000
        starts = [grown(base, shape.hidden, seed=seed + k) for k in range(draws)]
        paths = [path(start, data, decays, _STEPS) for start in starts]
        for found in zip(*paths, strict=True):
            self.search.work.spend(cost * sum(used for _, used in found))
            yield [fitted for fitted, _ in found]

    def _final(self, shape: Shape, decay: float) -> DynamicModel:
        """The path to the chosen decay on as many records as the budget allows, then on all."""
        search, decays = self.search, [one for one in _DECAYS if one >= decay]
        units = _FINAL_SHARE * search.work.budget / search.finals / (len(decays) * _STEPS)
        sizes = [(shape.states, shape.hidden, shape.delay)]
        for draws in range(2 * _DRAWS, _FEWEST_DRAWS - 1, -1):
            most = self._most(units / draws, sizes)
            if most >= search.samples:
                break
        most = max(most, min(FEW, search.samples))
        data = self._data(thinned(search.records, most), shape)
        linear = self._shape(shape.states, 0, shape.delay)
        base = fit_linear(data, linear)
        if base is None:  # cannot be: a fallback start exists for every order
            raise DataError("no linear model could be fitted")
        fits = list(self._paths(base, data, shape, draws, decays))[-1]
        every = self._data(search.records, shape)
        cost = _step(shape, search.samples)
        left = (search.work.budget - search.work.spent) / (cost * draws)
        steps = int(np.clip(left, 2, 8 * _STEPS)) if most < search.samples else 2
        members = []
        for number, fitted in enumerate(near_the_best(fits, _loss)):
            search.watch(0.9 + 0.1 * number / len(fits), "fitting to all records")
            start = moved(fitted, model_of(fitted, data, search.scalings), every)
            ended, _, used = at_decay(start, every, decays[-1], steps)
            search.work.spend(cost * used)
            members.append((ended, model_of(ended, every, search.scalings)))
        kept = near_the_best([ended for ended, _ in members], _loss)
        return Ensemble.median([model for ended, model in members if ended in kept])


def _loss(fitted: Fitted) -> float:
    return fitted.loss
