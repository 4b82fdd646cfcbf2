"""The NARX network as a rung of a choice: fitted on every fold along falling decays.

The median of several draws of hidden units is judged: a single network with past outputs in its
hidden layer may have several equilibria, and converge to the wrong one on what it did not see.

All samples of a fold are simulated; where they are many, one in an odd number is scored (a mode
that alternates from sample to sample is seen at odd strides only). A part of each record would save
as much work, but what a record holds that no other does would often be left out.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

from narxcal.narx.config import NarxConfig
from narxcal.narx.forms import DynamicModel, Ensemble
from narxcal.record import Record
from training.config import TrainConfig
from training.held_out import thinned
from training.network import Material, Progress, fit_narx
from training.ranking import Form
from training.search import FEW, NETWORK, PLENTY, Search, most_samples, step_cost

STRUCTURE = NarxConfig(lags=8, taps=tuple(range(9)), hidden=8)
_TRAIN = TrainConfig(
    horizons_s=(20.0, 200.0, 0.0), iterations=(10, 15, 25), score_every_s=1.0, threads=1
)
_DECAYS = (1e-3, 1e-5, 1e-7)
_FURTHER = 15  # steps over whole records at every further decay
_STEPS = sum(_TRAIN.iterations) + (len(_DECAYS) - 1) * _FURTHER
_DRAWS = 3
_SHARE, _FINAL_SHARE = 0.2, 0.15  # of the budget
_LEAST_PART = 0.5  # of the samples of a fold; on fewer the network is not what it would be on all
_SHORTEST = STRUCTURE.lags + STRUCTURE.taps[-1] + 1  # samples that a record needs


def try_network(search: Search) -> None:
    """Fit and judge the network at every decay, with fewer draws where the budget is short."""
    able = all(any(len(r) >= _SHORTEST for r in fold.fit) for fold in search.folds)
    for draws in range(_DRAWS, 0, -1):
        most = _most(search, _SHARE, draws * len(search.folds), search.whole)
        if most >= search.whole:
            break
    if most < search.whole * _LEAST_PART or not able:
        search.note("the NARX network was left out: the budget or the records are too short")
        return
    levels: list[list[DynamicModel]] = [[] for _ in _DECAYS]
    for fold in search.folds:
        if search.work.late:
            return
        found = _median(search, thinned(fold.fit, most), _DECAYS, draws)
        for level, model in zip(levels, found, strict=True):
            level.append(model)
        search.show()
    size = _size(search.inputs, search.outputs)
    for decay, fits in zip(_DECAYS, levels, strict=True):
        form = Form(NETWORK, f"8 lags, 8 hidden, decay {decay:g}", size, min(most, search.whole))
        search.tried.append(search.judge(form, fits, partial(_final, search, decay)))


def _final(search: Search, decay: float) -> DynamicModel:
    most = _most(search, _FINAL_SHARE, _DRAWS, search.samples)
    records = thinned(search.records, max(most, FEW))
    return _median(search, records, [one for one in _DECAYS if one >= decay], _DRAWS)[-1]


def _median(
    search: Search, records: Sequence[Record], decays: Sequence[float], draws: int
) -> list[DynamicModel]:
    """The median of several draws at each decay."""
    paths = [_path(search, records, decays, draw) for draw in range(draws)]
    return [Ensemble.median(members) for members in zip(*paths, strict=True)]


def _path(
    search: Search, records: Sequence[Record], decays: Sequence[float], draw: int
) -> list[DynamicModel]:
    """Networks of one draw along falling decays, each from the one before."""
    material = Material([record for record in records if len(record) >= _SHORTEST], (), 1.0)
    samples, size = sum(map(len, material.records)), _size(search.inputs, search.outputs)
    stride = max(int(samples * search.outputs / (PLENTY * size)), 1)
    stride -= 1 - stride % 2
    step = _cost(search, samples, samples * search.outputs / stride)
    found: list[DynamicModel] = []
    progress: Progress | None = None
    for decay in decays:
        last = _FURTHER if progress else _TRAIN.iterations[-1]
        update = {
            "decay": decay,
            "seed": search.seed * 1000 + draw,
            "score_every_s": float(stride),
            "iterations": (*_TRAIN.iterations[:-1], last),
        }
        result = fit_narx(material, STRUCTURE, _TRAIN.model_copy(update=update), resume=progress)
        search.work.spend(step * len(result.history))
        found.append(result.model)
        progress = Progress(result.model.net.get_theta(), stage=len(_TRAIN.iterations) - 1)
    return found


def _most(search: Search, share: float, fits: int, limit: int) -> int:
    """Samples of each of so many fits within a share of the budget."""
    rows = 2.0 * PLENTY * _size(search.inputs, search.outputs)

    def cost(samples: int) -> float:
        return _cost(search, samples, min(float(samples * search.outputs), rows))

    return most_samples(cost, share * search.work.budget / (_STEPS * fits), limit)


def _cost(search: Search, samples: int, rows: float) -> float:
    p = search.outputs
    return step_cost(samples, rows, _size(search.inputs, p), STRUCTURE.lags * p * p)


def _size(m: int, p: int) -> int:
    """Number of weights."""
    width = STRUCTURE.lags * p + len(STRUCTURE.taps) * m
    return STRUCTURE.hidden * (width + 1) + p * (STRUCTURE.hidden + 1 + width)
