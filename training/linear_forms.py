"""The linear rungs of a choice: ARX models of several orders, and linear output error."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

from narxcal.narx.forms import DynamicModel
from narxcal.narx.latent import LatentModel, Shape
from narxcal.narx.network import Scaling
from narxcal.record import Record
from narxcal.support.errors import DataError
from training.arx import arx_model
from training.held_out import thinned
from training.latent import Data, Fitted, Starts, fit_linear, model_of
from training.ranking import Build, Form
from training.search import (
    ARX,
    LAG,
    LATENT_STEP,
    OUTPUT_ERROR,
    Search,
    dead,
    least_squares_cost,
)

ORDERS = (1, 2, 3, 4, 5, 6, 8)
_ARX_ORDERS = (1, 2, 3, 5, 8, 15, 30)
_STEPS = 20  # of Levenberg-Marquardt that a linear fit takes
_SHARE = 0.1  # of the budget for linear output error
_LEAST = 2000  # samples per fold that linear models get whatever they cost

Known = tuple[Fitted, LatentModel]
Bases = dict[tuple[int, tuple[int, ...]], list[Known]]


def try_arx(search: Search, delays: Sequence[tuple[int, ...]]) -> None:
    """ARX models of several orders with and without dead time."""
    m, p = search.inputs, search.outputs
    for delay in delays:
        for order in _ARX_ORDERS:
            if 3 * order * (p + m) > search.samples * 3 // 4:
                break
            fits = [arx_model(fold.fit, order, delay, search.scalings) for fold in search.folds]
            width = order * p + (order + 1) * m + 1
            form = Form(ARX, f"{order} lags{dead(delay)}", width * p, search.samples, delay)
            build = partial(arx_model, search.records, order, delay, search.scalings)
            search.tried.append(search.judge(form, fits, _free(build)))
            search.work.spend(len(search.folds) * least_squares_cost(search.samples, width))


def try_linear(search: Search, delays: Sequence[tuple[int, ...]]) -> Bases:
    """Linear output error of every order, and the fits by order and dead time.

    A single state is the first-order lag.
    """
    m, p, folds = search.inputs, search.outputs, len(search.folds)
    costs = _STEPS * len(delays) * sum(_cost(n, m, p) for n in ORDERS)
    most = max(int(_SHARE * search.work.budget / (costs * folds)), _LEAST)
    bases: Bases = {}
    for delay in delays:
        datas = [
            Data.of(thinned(f.fit, most), delay, search.scalings, longest=search.longest)
            for f in search.folds
        ]
        starts = [Starts.of(data) for data in datas]
        samples = sum(len(u) for data in datas for u in data.inputs)
        for n in ORDERS:
            shape = Shape(n, m, p, 0, delay)
            fits = [fit_linear(d, shape, s) for d, s in zip(datas, starts, strict=True)]
            search.work.spend(_STEPS * _cost(n, m, p) * samples)
            known = [
                (f, model_of(f, d, search.scalings)) for f, d in zip(fits, datas, strict=True) if f
            ]
            if len(known) < folds:
                continue
            bases[n, delay] = known
            rung, text = (LAG, "1 state") if n == 1 else (OUTPUT_ERROR, f"{n} states")
            form = Form(rung, text + dead(delay), shape.size, samples // folds, delay, n)
            build = partial(linear_model, search.records, shape, search.scalings)
            search.tried.append(search.judge(form, [model for _, model in known], _free(build)))
    return bases


def _free(build: Callable[[], DynamicModel]) -> Build:
    """A linear form takes all records, whatever is left of the budget."""
    return lambda _share: build()


def linear_model(
    records: Sequence[Record], shape: Shape, scalings: tuple[Scaling, Scaling]
) -> DynamicModel:
    """Linear output error of one shape on all records."""
    data = Data.of(records, shape.delay, scalings)
    fitted = fit_linear(data, shape)
    if fitted is None:  # cannot be: a fallback start exists for every order
        raise DataError("no linear model could be fitted")
    return model_of(fitted, data, scalings)


def _cost(n: int, m: int, p: int) -> float:
    """Nominal microseconds per sample-step where every row is scored."""
    return LATENT_STEP.step(1e3, 1e3 * p, Shape(n, m, p, 0, (0,) * m).size + n, (0, n)) / 1e3
