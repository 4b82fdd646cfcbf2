"""Public system-identification sets: the network against what others published on them.

Structure and decay are chosen without the test range, by cross-validation inside the training
range: its recordings (a single one is cut into blocks) are held back in four turns, and the
candidate with the best free run over all that was held back is fitted again to everything. Only
that network is run on the official test range, once.
"""

from __future__ import annotations

import json
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise, product
from pathlib import Path

import numpy as np
import pandas as pd

from eval.benchmarks.row import Row
from eval.scores import rms
from narxcal.narx.config import NarxConfig
from narxcal.record import Record
from narxcal.support.arrays import FloatArray
from training.config import TrainConfig
from training.estimator import Narx

TURNS = 4
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
        text = f"lags {one.lags}, taps {taps}, hidden {one.hidden}, decay {self.train.decay:g}"
        feedback = ", linear feedback" if one.linear_feedback else ""
        return f"{text}, margin {one.margin:g}{feedback}, {self.train.optimiser}"


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
class SetResult:
    """The chosen candidate, test RMSE per recording and pooled, and processor time.

    `fit_s` is that of the last fit, `search_s` that of the choice before it.
    """

    chosen: Candidate
    rmse: dict[str, float] = field(default_factory=dict)
    pooled: float = float("nan")
    fit_s: float = 0.0
    search_s: float = 0.0


def _grid(
    structures: Sequence[NarxConfig],
    decay: Sequence[float],
    how: TrainConfig,
    optimisers: Sequence[str] = ("geodesic",),
) -> tuple[Candidate, ...]:
    """All combinations."""
    return tuple(
        Candidate(structure, how.model_copy(update={"decay": d, "optimiser": optimiser}))
        for structure, d, optimiser in product(structures, decay, optimisers)
    )


# The level sensor of the tanks saturates: their output never leaves the range that it shows.
_TANK = tuple(
    NarxConfig(lags=n, taps=tuple(range(1, n + 1)), hidden=h, margin=0.0)
    for n, h in product((2, 3, 4), (4, 6))
)
_TANKS = TrainConfig(
    horizons_s=(20.0, 100.0, 0.0), iterations=(10, 15, 30), score_every_s=1.0, starts=3, threads=1
)
# With past outputs in the linear path alone there is one equilibrium; other structures had several,
# and converged to the wrong one on held-out recordings.
_GAS = tuple(
    NarxConfig(lags=3, taps=tuple(range(n + 1)), hidden=8, linear_feedback=True) for n in (8, 20)
)
_TURBINE = TrainConfig(
    horizons_s=(20.0, 200.0, 1000.0), iterations=(10, 10, 15), score_every_s=2.0, threads=1
)
_WIENER = tuple(NarxConfig(lags=6, taps=tuple(range(n + 1)), hidden=8) for n in (30, 40))
_FILTER = TrainConfig(horizons_s=(100.0, 1000.0), iterations=(15, 40), score_every_s=2.0, threads=1)
SETS = (
    PublicSet(
        "cascaded_tanks",
        "V",
        1.0,
        _grid(_TANK, (1e-3, 3e-3), _TANKS, ("lm", "geodesic")),
        (Target("", 0.413, "bench/README.md: polynomial NARX, picked on the test range"),),
    ),
    PublicSet(
        "micro_gas_turbine",
        "W",
        1.0,
        _grid(_GAS, (1e-5,), _TURBINE),
        (
            Target("ex_4", 124.0, _SOURCE),
            Target("ex_22", 191.0, _SOURCE),
            Target("", 158.7, "root mean square of these two, weighted by their samples"),
        ),
    ),
    PublicSet(
        "wh2009",
        "mV",
        1000.0,
        _grid(_WIENER, (1e-7,), _FILTER),
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
    ranges = json.loads((folder / f"{name}.json").read_text(encoding="utf-8"))
    table = pd.read_csv(folder / f"{name}.csv.gz")
    u, y = table["u"].to_numpy(), table["y"].to_numpy()

    def records(part: str) -> tuple[Record, ...]:
        found = ranges[part] if isinstance(ranges[part], dict) else {"": ranges[part]}
        return tuple(Record(u[a:b], y[a:b], key) for key, (a, b) in found.items())

    return Material(records("train"), records("test"), ranges["init_window"])


def measure(one: PublicSet, material: Material) -> SetResult:
    """Choose by cross-validation, fit again, then run the test range once."""
    pieces = _pieces(material.train, one.use)
    began = time.process_time()
    scores = [_held_back_rmse(candidate, pieces, material.init) for candidate in one.candidates]
    chosen = one.candidates[int(np.argmin(scores))]
    search_s, began = time.process_time() - began, time.process_time()
    whole = [_head(record, one.use) for record in material.train]
    model = Narx(chosen.structure, chosen.train).fit(whole)
    fit_s = time.process_time() - began
    errors = {
        record.name: one.factor * _free_run_error(model, record, material.init)
        for record in material.test
    }
    rmse = {name: rms(error) for name, error in errors.items()}
    return SetResult(chosen, rmse, rms(np.concatenate(list(errors.values()))), fit_s, search_s)


def _held_back_rmse(candidate: Candidate, pieces: Sequence[Record], init: int) -> float:
    """Free-run RMSE over all pieces, each held back in one of the turns."""
    errors = []
    for turn in range(min(TURNS, len(pieces))):
        held = pieces[turn::TURNS]
        fit = [record for k, record in enumerate(pieces) if k % TURNS != turn]
        model = Narx(candidate.structure, candidate.train).fit(fit)
        errors += [_free_run_error(model, record, init) for record in held]
    return rms(np.concatenate(errors))


def rows_of(one: PublicSet, outcome: SetResult) -> list[Row]:
    """One row per test recording, the pooled figure and the processor time."""
    name = one.name
    note = (
        f"chosen of {len(one.candidates)} by cross-validation in the training range: "
        f"{outcome.chosen.text}"
    )
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
    spent = f"choosing took {outcome.search_s:.1f} CPU s more"
    found.append(Row(_GROUP, f"{name}, training", outcome.fit_s, "CPU s", note=spent))
    return found


def _pieces(records: Sequence[Record], use: int) -> list[Record]:
    """What can be held back: whole recordings, or blocks of equal length of a single one."""
    if len(records) > 1:
        return [_head(record, use) for record in records]
    record = _head(records[0], use)
    edges = np.linspace(0, len(record), TURNS + 1).astype(int)
    return [
        Record(record.u[a:b], record.y[a:b], f"{record.name}[{a}:{b}]")
        for a, b in pairwise(edges.tolist())
    ]


def _head(record: Record, use: int) -> Record:
    end = min(use or len(record), len(record))
    return Record(record.u[:end], record.y[:end], record.name)


def _free_run_error(model: Narx, record: Record, init: int) -> FloatArray:
    return (model.simulate(record.u, record.y[:init]) - record.y)[init:]
