"""The NARX network as a rung of a choice: fitted on every fold at three decays.

Whole records are run from several places in each. From the beginning alone a network with noisy
past outputs in its hidden layer learns that start by heart, and is unstable from any other: its
held-out errors then hang on the draw of its hidden units. The first decay is the one at which
hidden units are drawn; the network goes on to the others from there, because a strong decay from
the start ends at a linear model that a weaker one leaves slowly, if at all.

The median of several draws of hidden units is judged, without those that ended in a far minimum.
Where the budget is short, draws are saved first, then decays, then samples. All samples of a fold
are simulated; where they are many, one in an odd number is scored (a mode that alternates from
sample to sample is seen at odd strides only). A part of each record would save as much work, but
what a record holds that no other does would often be left out.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

from narxcal.narx.config import NarxConfig
from narxcal.narx.forms import DynamicModel, Ensemble
from narxcal.record import Record
from training.config import TrainConfig
from training.held_out import thinned
from training.network import FitResult, Material, TrainingState, fit_narx
from training.ranking import Form
from training.search import (
    FEW,
    NETWORK,
    NETWORK_STEP,
    PLENTY,
    Search,
    most_samples,
    near_the_best,
)

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
        if search.work.late:
            return
        found = _median(search, thinned(fold.fit, most), decays, draws)
        for level, model in zip(levels, found, strict=True):
            level.append(model)
        search.show()
    size = network_size(search.inputs, search.outputs)
    for decay, fits in zip(decays, levels, strict=True):
        form = Form(NETWORK, f"8 lags, 8 hidden, decay {decay:g}", size, min(most, search.whole))
        search.tried.append(search.judge(form, fits, partial(_final, search, decay)))


def _final(search: Search, decay: float, share: float) -> DynamicModel:
    decays = tuple(dict.fromkeys((_DECAYS[0], decay)))
    units = share * max(search.work.left, _FINAL_SHARE * search.work.budget)
    most = _most(search, units, (_DRAWS, decays), search.samples)
    return _median(search, thinned(search.records, max(most, FEW)), decays, _DRAWS)[-1]


def _median(
    search: Search, records: Sequence[Record], decays: Sequence[float], draws: int
) -> list[DynamicModel]:
    """The median of several draws at each decay."""
    material = Material([record for record in records if len(record) >= _SHORTEST], (), 1.0)
    levels = zip(*(_draw(search, material, decays, draw) for draw in range(draws)), strict=True)
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
    found, steps = drawn_networks(material, decays, search.seed * 1000 + draw, stride)
    search.work.spend(steps * _cost(search, samples, samples * search.outputs / stride))
    return found


def drawn_networks(
    material: Material, decays: Sequence[float], seed: int, stride: int
) -> tuple[list[FitResult], float]:
    """Networks of one draw, at the first decay and from there at each other, and steps taken.

    One sample in `stride` is scored.
    """
    found: list[FitResult] = []
    start: TrainingState | None = None
    for decay in decays:
        steps = (*_TRAIN.iterations[:-1], _FURTHER if start else _TRAIN.iterations[-1])
        update = {
            "decay": decay,
            "seed": seed,
            "score_every_s": float(stride),
            "iterations": steps,
        }
        result = fit_narx(material, STRUCTURE, _TRAIN.model_copy(update=update), resume=start)
        found.append(result)
        start = start or TrainingState(result.model.net.get_theta(), stage=len(steps) - 1)
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
