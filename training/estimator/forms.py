"""Forms of a choice: ARX models, linear output error, and the NARX network, fitted on every fold.

ARX is least squares on one step; the dead time is the one by which a short ARX model predicts best.

The network is fitted at three decays, whole records from several places in each. From the beginning
alone a network with noisy past outputs in its hidden layer memorises that start, and is
unstable from any other. The first decay is the one at which hidden units are drawn; the network
goes on to the others from there, because a strong decay from the start ends at a linear model that
a weaker one leaves slowly, if at all. The median of several draws is judged, without those that
ended in a far minimum. Where the budget is short, draws are saved first, then decays, then samples.
All samples of a fold are simulated; where they are many, one in an odd number is scored (a mode
that alternates from sample to sample is seen at odd strides only).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from narxcal.narx.config import NarxConfig
from narxcal.narx.forms import DynamicModel, Ensemble
from narxcal.narx.latent import LatentModel, Shape
from narxcal.narx.network import NarxModel, Scaling, Weights
from narxcal.record import Record
from narxcal.support.errors import DataError
from training.config import TrainConfig
from training.dynamics.network import (
    FitResult,
    Material,
    TrainingState,
    fit_narx,
    net_of,
    regression,
)
from training.dynamics.optimisers import Late, unlimited
from training.estimator.latent import Data, Fitted, Starts, fit_linear, model_of
from training.estimator.search import (
    ARX,
    FEW,
    LAG,
    LATENT_STEP,
    NETWORK,
    NETWORK_STEP,
    OUTPUT_ERROR,
    PLENTY,
    Build,
    Form,
    Search,
    dead,
    least_squares_cost,
    most_samples,
    near_the_best,
    thinned,
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
            long = 3 * order * (p + m) > search.samples * 3 // 4
            if long or (search.tried and search.work.late()):
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
    costs = _STEPS * len(delays) * sum(_linear_cost(n, m, p) for n in ORDERS)
    most = max(int(_SHARE * search.work.budget / (costs * folds)), _LEAST)
    bases: Bases = {}
    for delay in delays:
        datas = [search.data(thinned(fold.fit, most), delay) for fold in search.folds]
        starts = [Starts.of(data) for data in datas]
        samples = sum(len(u) for data in datas for u in data.inputs)
        for n in ORDERS:
            if search.tried and search.work.late():
                break
            shape = Shape(n, m, p, 0, delay)
            fits = [fit_linear(d, shape, s) for d, s in zip(datas, starts, strict=True)]
            search.work.spend(_STEPS * _linear_cost(n, m, p) * samples)
            known = [
                (f, model_of(f, d, search.scalings)) for f, d in zip(fits, datas, strict=True) if f
            ]
            if len(known) < folds:
                continue
            bases[n, delay] = known
            rung, text = (LAG, "1 state") if n == 1 else (OUTPUT_ERROR, f"{n} states")
            form = Form(rung, text + dead(delay), shape.size, samples // folds, delay, n)
            build = partial(linear_model, search, shape)
            search.tried.append(search.judge(form, [model for _, model in known], _free(build)))
    return bases


def _free(build: Callable[[], DynamicModel]) -> Build:
    """A linear form takes all records, whatever is left of the budget."""
    return lambda _share: build()


def linear_model(search: Search, shape: Shape) -> DynamicModel:
    """Linear output error of one shape on all records."""
    data = search.data(search.records, shape.delay)
    fitted = fit_linear(data, shape)
    if fitted is None:  # cannot be: a fallback start exists for every order
        raise DataError("no linear model could be fitted")
    return model_of(fitted, data, search.scalings)


def _linear_cost(n: int, m: int, p: int) -> float:
    """Nominal microseconds per sample-step where every row is scored."""
    return LATENT_STEP.step(1e3, 1e3 * p, Shape(n, m, p, 0, (0,) * m).size + n, (0, n)) / 1e3


_MOST_DEAD = 60  # samples, at most a tenth of the shortest record
_SAMPLES = 20_000  # by which dead times are judged


def dead_times(
    records: Sequence[Record], scalings: tuple[Scaling, Scaling]
) -> list[tuple[int, ...]]:
    """No dead time, and the one by which a short ARX model predicts best, if there is any."""
    inputs = records[0].u.shape[1]
    none = (0,) * inputs
    data = Data.of(thinned(records, _SAMPLES), none, scalings)
    most = min(_MOST_DEAD, min(len(u) for u in data.inputs) // 10)
    found = list(none)
    for j in range(inputs):
        errors = [_short_arx_error(data, (*found[:j], d, *found[j + 1 :])) for d in range(most)]
        # The least within half a percent of the best: too long a one cannot be undone.
        found[j] = int(np.argmax(np.array(errors) <= 1.005 * min(errors))) if errors else 0
    return [none] if not any(found) else [none, tuple(found)]


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
        if len(y) <= order:
            continue
        phi, target = regression(u, y, order, taps)
        phi = np.column_stack([phi, np.ones(len(phi))])
        normal, right = normal + phi.T @ phi, right + phi.T @ target
        count += len(phi)
        low, high = np.fmin(low, np.fmin.reduce(y)), np.fmax(high, np.fmax.reduce(y))
    normal[np.diag_indices(width + 1)] += 1e-9 * max(count, 1)
    solution = np.linalg.solve(normal, right).T
    wide = config.margin * (high - low) + 1e-9
    weights = Weights(
        config=config, w1=np.zeros((1, width)), b1=np.zeros(1), w2=np.zeros((p, 1)),
        b2=solution[:, -1].copy(), a=np.ascontiguousarray(solution[:, :-1]),
        low=low - wide, high=high + wide,
    )  # fmt: skip
    return NarxModel(weights, *scalings)


STRUCTURE = NarxConfig(lags=8, taps=tuple(range(9)), hidden=8)
_DECAYS = (1e-5, 1e-3, 1e-7)  # the first is that of `Narx(None)`; each other begins where it ended
_TRAIN = TrainConfig(
    horizons_s=(20.0, 200.0, 0.0),
    iterations=(10, 15, 25),
    restarts=3,
    score_every_s=1.0,
    threads=1,
)
_FURTHER = 15  # steps over whole records at every further decay
_DRAWS = 3
_SHARE = 0.2  # of the budget at most
_FINAL_SHARE = 0.15  # of the budget at least, for the fit to all records
_LEAST_PART = 0.5  # of the samples of a fold; on fewer the network is not what it would be on all
_SHORTEST = STRUCTURE.lags + STRUCTURE.taps[-1] + 1  # samples that a record needs
# (draws, decays) from the most to the least
_EFFORTS = (*((draws, _DECAYS) for draws in range(_DRAWS, 0, -1)), (1, _DECAYS[:1]))


def try_network(search: Search) -> None:
    """Fit and judge the network at every decay, with less effort where the budget is short."""
    able = all(any(len(r) >= _SHORTEST for r in fold.fit) for fold in search.folds)
    units = _SHARE * search.work.budget
    for draws, decays in _EFFORTS:
        most = _most(search, units, (draws * len(search.folds), decays), search.whole)
        if most >= search.whole:
            break
    if most < search.whole * _LEAST_PART or not able:
        search.note("the NARX network was left out: the budget or the records are too short")
        return
    levels: list[list[DynamicModel]] = [[] for _ in decays]
    for fold in search.folds:
        found = _median(search, thinned(fold.fit, most), decays, draws)
        if search.work.late():
            return
        for level, model in zip(levels, found, strict=True):
            level.append(model)
        search.show()
    size = network_size(search.inputs, search.outputs)
    for decay, fits in zip(decays, levels, strict=True):
        form = Form(NETWORK, f"8 lags, 8 hidden, decay {decay:g}", size, min(most, search.whole))
        search.tried.append(search.judge(form, fits, partial(_final, search, decay)))


def _final(search: Search, decay: float, share: float) -> DynamicModel:
    decays = tuple(dict.fromkeys((_DECAYS[0], decay)))
    units = share * max(search.work.left(), _FINAL_SHARE * search.work.budget)
    most = _most(search, units, (_DRAWS, decays), search.samples)
    return _median(search, thinned(search.records, max(most, FEW)), decays, _DRAWS)[-1]


def _median(
    search: Search, records: Sequence[Record], decays: Sequence[float], draws: int
) -> list[DynamicModel]:
    """The median of several draws at each decay."""
    material = Material([record for record in records if len(record) >= _SHORTEST], (), 1.0)
    drawn: list[list[FitResult]] = []
    for draw in range(draws):
        if drawn and search.work.late():
            break
        drawn.append(_draw(search, material, decays, draw))
    levels = zip(*drawn, strict=False)  # of those that the time was enough for
    return [
        Ensemble.median([fit.model for fit in near_the_best(level, lambda fit: fit.score**2)])
        for level in levels
    ]


def _draw(
    search: Search, material: Material, decays: Sequence[float], draw: int
) -> list[FitResult]:
    """Networks of one draw, whose work is counted."""
    samples, size = sum(map(len, material.records)), network_size(search.inputs, search.outputs)
    stride = max(int(samples * search.outputs / (PLENTY * size)), 1)
    stride -= 1 - stride % 2
    seed = search.seed * 1000 + draw
    found, steps = drawn_networks(material, decays, seed, stride, search.work.late)
    search.work.spend(steps * _cost(search, samples, samples * search.outputs / stride))
    return found


def drawn_networks(
    material: Material, decays: Sequence[float], seed: int, stride: int, late: Late = unlimited
) -> tuple[list[FitResult], float]:
    """Networks of one draw, at the first decay and from there at each other, and steps taken.

    One sample in `stride` is scored. There are fewer where it becomes `late`.
    """
    found: list[FitResult] = []
    start: TrainingState | None = None
    for decay in decays:
        if found and late():
            break
        steps = (*_TRAIN.iterations[:-1], _FURTHER if start else _TRAIN.iterations[-1])
        update = {
            "decay": decay,
            "seed": seed,
            "score_every_s": float(stride),
            "iterations": steps,
        }
        config = _TRAIN.model_copy(update=update)
        result = fit_narx(material, STRUCTURE, config, lambda _state: late(), start)
        found.append(result)
        start = start or TrainingState(net_of(result.model).get_theta(), stage=len(steps) - 1)
    rows = [row for each in found for row in each.history]
    return found, sum(_WHOLE if row.horizon_s == 0.0 else 1.0 for row in rows)


_WHOLE = (_TRAIN.restarts + 1) / 2  # times the samples are simulated over whole records


def _steps(decays: Sequence[float]) -> float:
    """Steps of one draw over all samples."""
    short, whole = sum(_TRAIN.iterations[:-1]), _TRAIN.iterations[-1]
    return short + _WHOLE * (whole + (len(decays) - 1) * _FURTHER)


def _most(search: Search, units: float, effort: tuple[int, Sequence[float]], limit: int) -> int:
    """Samples of each of so many fits at these decays that so many units pay for."""
    fits, decays = effort
    rows = 2.0 * PLENTY * network_size(search.inputs, search.outputs)

    def cost(samples: int) -> float:
        return _cost(search, samples, min(float(samples * search.outputs), rows))

    return most_samples(cost, units / (_steps(decays) * fits), limit)


def _cost(search: Search, samples: int, rows: float) -> float:
    p = search.outputs
    return NETWORK_STEP.step(samples, rows, network_size(search.inputs, p), network_kind(p))


def network_size(m: int, p: int) -> int:
    """Number of weights for m inputs and p outputs."""
    width = STRUCTURE.lags * p + len(STRUCTURE.taps) * m
    return STRUCTURE.hidden * (width + 1) + p * (STRUCTURE.hidden + 1 + width)


def network_kind(p: int) -> tuple[int, int]:
    """Hidden units, and products by which the p outputs of a sample act on those of the next."""
    return STRUCTURE.hidden, STRUCTURE.lags * p * p
