"""Public system-identification sets: `narxcal benchmark`, and the rows of `make bench`.

Every set is fitted by `Narx()` with default settings, by the linear forms alone, chosen by the same
folds, and by a network of fixed size without a choice. The official test range is run once by each;
the first `init_window` samples start a model and are not scored.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from eval.benchmarks import Row
from eval.judging.scores import rms
from narxcal.narx.forms import DynamicModel
from narxcal.record import Record
from narxcal.support.errors import DataError
from narxcal.support.progress import Progress, silent
from training.estimator.ladder import Limits, choose
from training.estimator.narx import Narx

SCHEMA = "narxcal.benchmark/1"
OURS, FIXED, LINEAR, PUBLISHED = "Narx()", "Narx(None)", "linear", "published"
_SOURCE = "tsfast 0.5, NARX trained in free run, one seed, measured by us"


class Target(NamedTuple):
    """Best figure of a NARX-class peer for one test recording ("" : all of them pooled)."""

    record: str
    value: float
    source: str


class PublicSet(NamedTuple):
    """A set by name: unit of its score, factor to it, and published figures."""

    name: str
    unit: str
    factor: float
    targets: tuple[Target, ...]


SETS = (
    PublicSet(
        "cascaded_tanks", "V", 1.0,
        (Target("", 0.413, "polynomial NARX picked on the test range (arXiv 2405.10779)"),),
    ),
    PublicSet(
        "micro_gas_turbine", "W", 1.0,
        (
            Target("ex_4", 124.0, _SOURCE), Target("ex_22", 191.0, _SOURCE),
            Target("", 158.7, "root mean square of these two, weighted by their samples"),
        ),
    ),
    PublicSet("wh2009", "mV", 1000.0, (Target("", 14.1, _SOURCE),)),
)  # fmt: skip
NAMES = tuple(one.name for one in SETS)


@dataclass(frozen=True, eq=False)
class Material:
    """Recordings of a set; the first `init` samples of a test recording start the model."""

    train: tuple[Record, ...]
    test: tuple[Record, ...]
    init: int


@dataclass(frozen=True)
class Figure:
    """One model on one test recording ("" : all pooled): RMSE in the set's unit and NRMSE."""

    set: str
    model: str
    record: str
    rmse: float
    nrmse_pct: float
    unit: str
    cpu_s: float
    note: str = ""


def names_in(folder: Path, wanted: Sequence[str] = ()) -> list[str]:
    """Sets that `folder` holds; `DataError` for one that is named and missing, or without any."""
    there = sorted(path.stem for path in folder.glob("*.json"))
    there = [name for name in there if (folder / f"{name}.csv.gz").is_file()]
    missing = [name for name in wanted if name not in there]
    if missing or not there:
        what = f"the set '{missing[0]}' is not in" if missing else "no set is in"
        raise DataError(
            f"{what} {folder}",
            hint="A set is NAME.csv.gz with columns u and y, and NAME.json with its ranges",
        )
    return list(wanted) or there


def read(folder: Path, name: str) -> Material:
    """Read a set with its official ranges."""
    ranges = json.loads((folder / f"{name}.json").read_text(encoding="utf-8"))
    table = pd.read_csv(folder / f"{name}.csv.gz")
    u, y = table["u"].to_numpy(), table["y"].to_numpy()

    def records(part: str) -> tuple[Record, ...]:
        found = ranges[part] if isinstance(ranges[part], dict) else {"": ranges[part]}
        return tuple(Record(u[a:b], y[a:b], key) for key, (a, b) in found.items())

    return Material(records("train"), records("test"), ranges["init_window"])


def figures(
    folder: Path,
    name: str,
    limits: Limits,
    progress: Progress = silent,
    models: Sequence[str] = (OURS, FIXED, LINEAR),
) -> Iterator[Figure]:
    """Figures of `models` on one set, and the set's published ones."""
    material = read(folder, name)
    known = {one.name: one for one in SETS}.get(name, PublicSet(name, "", 1.0, ()))
    fits: dict[str, Callable[[], tuple[DynamicModel | Narx, str]]] = {
        OURS: lambda: _chosen(material, limits, progress),
        FIXED: lambda: (Narx(None).fit(list(material.train)), "8 lags, taps 0 to 8, 8 hidden"),
        LINEAR: lambda: _chosen(material, replace(limits, linear=True)),
    }
    for label in models:
        began = time.process_time()
        model, note = fits[label]()
        spent = time.process_time() - began
        for record, error, spread in _errors(model, material):
            pct = 100.0 * error / spread if spread > 0.0 else np.nan
            yield Figure(name, label, record, known.factor * error, pct, known.unit, spent, note)
    for record, value, source in known.targets:
        yield Figure(name, PUBLISHED, record, value, np.nan, known.unit, np.nan, source)


def _chosen(
    material: Material, limits: Limits, progress: Progress = silent
) -> tuple[DynamicModel, str]:
    found = choose(list(material.train), limits, progress)
    return found.model, found.reason


def _errors(model: DynamicModel | Narx, material: Material) -> Iterator[tuple[str, float, float]]:
    """(recording, RMSE, standard deviation), each test recording and all pooled."""
    errors, outputs = [], []
    for record in material.test:
        run = model.simulate(record.u, record.y[: material.init])
        errors.append((run - record.y)[material.init :])
        outputs.append(record.y[material.init :])
        if len(material.test) > 1:
            yield record.name, rms(errors[-1]), float(np.std(outputs[-1]))
    yield "", rms(np.concatenate(errors)), float(np.std(np.concatenate(outputs)))


def document(found: Sequence[Figure], limits: Mapping[str, Any]) -> dict[str, Any]:
    """All figures, and the geometric mean of ours over the linear forms."""
    pooled = {(one.set, one.model): one.rmse for one in found if one.record == ""}
    ratios = [pooled[name, OURS] / pooled[name, LINEAR] for name, model in pooled if model == OURS]
    mean = float(np.exp(np.mean(np.log(ratios)))) if ratios else None
    return {
        "schema": SCHEMA,
        **limits,
        "geometric_mean_ratio": mean,
        "figures": [dict(vars(one)) for one in found],
    }


def rows(folder: Path, names: Sequence[str] = NAMES) -> list[Row]:
    """Our figures and the published ones; a set that is missing becomes a row that says so."""
    found: list[Row] = []
    for name in names:
        if (folder / f"{name}.json").is_file():
            found += _rows(list(figures(folder, name, Limits(), models=(OURS,))))
        else:
            note = f"not measured: {name}.json is not in {folder}"
            found.append(Row("public sets", name, np.nan, "", note=note))
    return found


def _rows(found: Sequence[Figure]) -> Iterator[Row]:
    peers = {one.record: one for one in found if one.model == PUBLISHED}
    for one in (each for each in found if each.model == OURS):
        peer, name = peers.get(one.record), f"{one.set} {one.record}".strip()
        row = Row("public sets", name, one.rmse, one.unit, note=one.note)
        if peer is not None:
            row = replace(row, target=peer.rmse, bound="at most", source=peer.note)
        yield row
    yield Row("public sets", f"{found[0].set}, training", found[0].cpu_s, "CPU s")
