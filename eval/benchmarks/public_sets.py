"""Public system-identification sets: the network against what others published on them.

Structure and decay are chosen without the test range, by the free run over what a fit did not
see. Where the training range is one recording, its last fifth is held back, which also stops the
training early; the best candidate is taken as it is. Where it is several recordings, a third of
them is held back in turn, and the candidate that is best over all three turns is fitted again to
all of them. Only the chosen network is run on the official test range, once.
"""

from __future__ import annotations

import json
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import product
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from eval.benchmarks.row import Row
from narxcal.narx import NarxConfig
from narxcal.records import Record
from training.config import TrainConfig
from training.estimator import Narx

FloatArray = NDArray[np.float64]
HELD_BACK = 0.2
TURNS = 3
_Fold = tuple[tuple[Record, ...], tuple[Record, ...]]
_GROUP = "public sets"
_SOURCE = "bench/README.md: tsfast 0.5 NARX, free run, compiled"


@dataclass(frozen=True)
class Candidate:
    """One choice of hyper-parameters."""

    structure: NarxConfig
    train: TrainConfig

    @property
    def text(self) -> str:
        """What tells it from the others."""
        one = self.structure
        taps = f"{one.taps[0]}..{one.taps[-1]}"
        return f"lags {one.lags}, taps {taps}, hidden {one.hidden}, decay {self.train.decay:g}"


@dataclass(frozen=True)
class Target:
    """Best figure of a NARX-class peer for one test recording ("" : all of them pooled)."""

    record: str
    value: float
    source: str


@dataclass(frozen=True)
class PublicSet:
    """A set by name: its candidates, factor to the unit of the score, and peers.

    `use` is how many samples of a training recording are used, 0 for all.
    """

    name: str
    unit: str
    factor: float
    candidates: tuple[Candidate, ...]
    targets: tuple[Target, ...]
    use: int = 0


@dataclass(frozen=True, eq=False)
class Material:
    """Recordings of a set; the first `init` samples of a test recording start the model."""

    train: tuple[Record, ...]
    test: tuple[Record, ...]
    init: int


@dataclass(frozen=True)
class Outcome:
    """The chosen candidate, test RMSE per recording and pooled, and processor time.

    `fit_s` is that of the fit that was taken, `search_s` that of all of them.
    """

    chosen: Candidate
    rmse: dict[str, float] = field(default_factory=dict)
    pooled: float = float("nan")
    fit_s: float = 0.0
    search_s: float = 0.0


def _grid(
    lags: Sequence[int], hidden: Sequence[int], decay: Sequence[float], how: TrainConfig, first: int
) -> tuple[Candidate, ...]:
    """All combinations; the input taps reach from `first` to the lags."""
    return tuple(
        Candidate(
            NarxConfig(lags=n, taps=tuple(range(first, n + 1)), hidden=h),
            how.model_copy(update={"decay": d}),
        )
        for n, h, d in product(lags, hidden, decay)
    )


_TANKS = TrainConfig(
    horizons_s=(20.0, 100.0, 0.0), iterations=(10, 15, 30), score_every_s=1.0, starts=3, threads=1
)
_TURBINE = TrainConfig(
    horizons_s=(20.0, 200.0, 0.0), iterations=(10, 15, 30), score_every_s=2.0, threads=1
)
_FILTER = TrainConfig(horizons_s=(100.0, 1000.0), iterations=(15, 25), score_every_s=2.0, threads=1)
SETS = (
    PublicSet(
        "cascaded_tanks",
        "V",
        1.0,
        _grid((2, 3, 4), (4, 6, 8), (1e-4, 1e-3), _TANKS, 1),
        (Target("", 0.413, "bench/README.md: polynomial NARX, picked on the test range"),),
    ),
    PublicSet(
        "micro_gas_turbine",
        "W",
        1.0,
        _grid((1, 2), (8,), (1e-6, 1e-7, 1e-8), _TURBINE, 0),
        (Target("ex_4", 124.0, _SOURCE), Target("ex_22", 191.0, _SOURCE)),
    ),
    PublicSet(
        "wh2009",
        "mV",
        1000.0,
        _grid((6, 8, 10), (8,), (1e-7,), _FILTER, 0),
        (Target("", 14.1, _SOURCE),),
        use=40000,
    ),
)


def rows(folder: Path, sets: Sequence[PublicSet] = SETS) -> list[Row]:
    """Measure every set that `folder` holds; one that is missing becomes a row that says so."""
    found: list[Row] = []
    for one in sets:
        if not (folder / f"{one.name}.json").is_file():
            note = f"not measured: {one.name}.json is not in {folder}"
            found.append(Row(_GROUP, one.name, float("nan"), one.unit, note=note))
            continue
        found += rows_of(one, measure(one, read(folder, one.name)))
    return found


def read(folder: Path, name: str) -> Material:
    """Read a set with its official ranges."""
    said = json.loads((folder / f"{name}.json").read_text(encoding="utf-8"))
    table = pd.read_csv(folder / f"{name}.csv.gz")
    u, y = table["u"].to_numpy(), table["y"].to_numpy()

    def records(part: str) -> tuple[Record, ...]:
        ranges = said[part] if isinstance(said[part], dict) else {"": said[part]}
        return tuple(Record(u[a:b], y[a:b], key) for key, (a, b) in ranges.items())

    return Material(records("train"), records("test"), said["init_window"])


def measure(one: PublicSet, material: Material) -> Outcome:
    """Choose by what was held back, then run the test range once."""
    folds = _folds(material.train, one.use)
    trials = [_try(candidate, folds, material.init) for candidate in one.candidates]
    best = min(trials, key=lambda trial: trial.score)
    model, fit_s = best.model, best.seconds
    if len(folds) > 1:
        model, fit_s = _fit(best.candidate, material.train, ())
    errors = {
        record.name: one.factor * _free_run_error(model, record, material.init)
        for record in material.test
    }
    return Outcome(
        best.candidate,
        {name: _rms(error) for name, error in errors.items()},
        _rms(np.concatenate(list(errors.values()))),
        fit_s,
        sum(trial.seconds for trial in trials) + (fit_s if len(folds) > 1 else 0.0),
    )


@dataclass(frozen=True, eq=False)
class _Trial:
    """One candidate: RMSE over all that was held back, the last fold's network, CPU seconds."""

    candidate: Candidate
    score: float
    model: Narx
    seconds: float


def _try(candidate: Candidate, folds: Sequence[_Fold], init: int) -> _Trial:
    errors, seconds = [], 0.0
    for fit, held in folds:
        model, took = _fit(candidate, fit, held)
        seconds += took
        errors += [_free_run_error(model, record, init) for record in held]
    return _Trial(candidate, _rms(np.concatenate(errors)), model, seconds)


def _fit(candidate: Candidate, fit: Sequence[Record], held: Sequence[Record]) -> tuple[Narx, float]:
    began = time.process_time()
    model = Narx(candidate.structure, candidate.train).fit(fit, held)
    return model, time.process_time() - began


def rows_of(one: PublicSet, outcome: Outcome) -> list[Row]:
    """One row per test recording, the pooled figure and the processor time."""
    name, note = one.name, f"chosen of {len(one.candidates)} by what was held back: "
    note += outcome.chosen.text
    peers = {target.record: target for target in one.targets}
    values = {"": outcome.pooled}
    if len(outcome.rmse) > 1:
        values = {**outcome.rmse, "": outcome.pooled}
    found = []
    for key, value in values.items():
        label = f"{name} {key or 'pooled'}" if len(values) > 1 else name
        if key in peers:
            peer = peers[key]
            row = Row(_GROUP, label, value, one.unit, peer.value, "at most", peer.source, note)
        else:
            row = Row(_GROUP, label, value, one.unit, note=note)
        found.append(row)
    spent = f"all {len(one.candidates)} candidates: {outcome.search_s:.1f} CPU s"
    found.append(Row(_GROUP, f"{name}, training", outcome.fit_s, "CPU s", note=spent))
    return found


def _folds(records: Sequence[Record], use: int) -> list[_Fold]:
    """What is fitted and what is held back, in turn; one recording is cut in two."""
    if len(records) > 1:
        turns = [set(range(first, len(records), TURNS)) for first in range(TURNS)]
        return [
            (
                tuple(record for k, record in enumerate(records) if k not in turn),
                tuple(records[k] for k in sorted(turn)),
            )
            for turn in turns
            if turn
        ]
    record = records[0]
    end = min(use or len(record), len(record))
    cut = round((1.0 - HELD_BACK) * end)
    fit = Record(record.u[:cut], record.y[:cut], record.name)
    held = Record(record.u[cut:end], record.y[cut:end], f"{record.name}, held back")
    return [((fit,), (held,))]


def _free_run_error(model: Narx, record: Record, init: int) -> FloatArray:
    return (model.simulate(record.u, record.y[:init]) - record.y)[init:]


def _rms(error: FloatArray) -> float:
    return float(np.sqrt(np.mean(error**2)))
