"""One recipe on public sets: `narxcal benchmark`.

Every set is fitted by `Narx()` with nothing said about it, by the linear rungs alone, chosen by the
same folds, by a network of fixed size without a choice, and by jax-sysid where it is installed
(extra `bench`). The official test range is run once by each; the first `init_window` samples start
a model and are not scored.
"""

from __future__ import annotations

import importlib.util
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from eval.benchmarks.public_sets import SETS, Material, read
from eval.scores import rms
from narxcal.record import Record
from narxcal.support.arrays import FloatArray
from narxcal.support.errors import DataError
from training.choice import Limits, choose
from training.estimator import Narx
from training.search import Watch

SCHEMA = "narxcal.benchmark/1"
OURS, FIXED, LINEAR, JAX = "Narx()", "Narx(None)", "linear", "jax-sysid"
_JAX_ORDER, _JAX_HIDDEN = 4, 10  # of the figures in its own paper
_JAX_STEPS = 2000
Simulate = Callable[[FloatArray, FloatArray], FloatArray]


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

    def row(self) -> dict[str, Any]:
        """JSON-able."""
        return dict(vars(self))


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


def figures(
    folder: Path, name: str, time_limit_s: float, watch: Watch | None = None
) -> Iterator[Figure]:
    """Ours, a fixed network, linear, jax-sysid where installed, and a set's published figures."""
    material = read(folder, name)
    known = {one.name: one for one in SETS}.get(name)
    unit, factor = ("", 1.0) if known is None else (known.unit, known.factor)
    train = list(material.train)

    def ours() -> tuple[Simulate, str]:
        found = choose(train, Limits(time_limit_s), watch)
        return found.model.simulate, found.reason

    def linear() -> tuple[Simulate, str]:
        found = choose(train, Limits(time_limit_s, linear=True))
        return found.model.simulate, found.reason

    def fixed() -> tuple[Simulate, str]:
        return Narx(None).fit(train).simulate, "8 lags, taps 0 to 8, 8 hidden units"

    models: dict[str, Callable[[], tuple[Simulate, str]]] = {
        OURS: ours, FIXED: fixed, LINEAR: linear,
    }  # fmt: skip
    if importlib.util.find_spec("jax_sysid") is not None:
        models[JAX] = lambda: (jax_sysid(train), f"{_JAX_ORDER} states, {_JAX_HIDDEN} hidden")
    for model, fit in models.items():
        began = time.process_time()
        simulate, note = fit()
        spent = time.process_time() - began
        for record, error, spread in _errors(simulate, material):
            pct = 100.0 * error / spread if spread > 0.0 else np.nan
            yield Figure(name, model, record, factor * error, pct, unit, spent, note)
    for target in () if known is None else known.targets:
        note = target.source
        yield Figure(name, "published", target.record, target.value, np.nan, unit, np.nan, note)


def _errors(simulate: Simulate, material: Material) -> Iterator[tuple[str, float, float]]:
    """(recording, RMSE, standard deviation), each test recording and all pooled."""
    errors, outputs = [], []
    for record in material.test:
        error = (simulate(record.u, record.y[: material.init]) - record.y)[material.init :]
        errors.append(error)
        outputs.append(record.y[material.init :])
        if len(material.test) > 1:
            yield record.name, rms(error), float(np.std(outputs[-1]))
    yield "", rms(np.concatenate(errors)), float(np.std(np.concatenate(outputs)))


def jax_sysid(records: Sequence[Record]) -> Simulate:
    """Its recurrent network as in its paper: L-BFGS on the simulation error, start smoothed."""
    from flax import linen as nn  # type: ignore[import-not-found, unused-ignore]  # noqa: PLC0415
    from jax_sysid.models import RNN  # type: ignore[import-not-found, unused-ignore]  # noqa: PLC0415
    from jax_sysid.utils import standard_scale  # type: ignore[import-not-found, unused-ignore]  # noqa: PLC0415

    u = np.concatenate([record.u for record in records])
    y = np.concatenate([record.y for record in records])
    _, mean_y, gain_y = standard_scale(y)
    _, mean_u, gain_u = standard_scale(u)

    def layers(outputs: int) -> type:
        def call(_self: Any, xu: Any) -> Any:
            return nn.Dense(outputs)(nn.tanh(nn.Dense(_JAX_HIDDEN)(xu)))

        return type("Layers", (nn.Module,), {"__call__": nn.compact(call)})

    order, p, m = _JAX_ORDER, y.shape[1], u.shape[1]
    model = RNN(order, p, m, FX=layers(order), FY=layers(p), x_scaling=0.1, y_in_x=False)
    model.loss(rho_x0=1e-4, rho_th=1e-4)
    model.optimization(adam_epochs=500, lbfgs_epochs=_JAX_STEPS, iprint=-1)
    scaled = [((one.y - mean_y) * gain_y, (one.u - mean_u) * gain_u) for one in records]
    model.fit([each for each, _ in scaled], [each for _, each in scaled])

    def simulate(u: FloatArray, start: FloatArray) -> FloatArray:
        inputs = (u - mean_u) * gain_u
        head = (start - mean_y) * gain_y
        x0 = model.learn_x0(inputs[: len(start)], head, RTS_epochs=10)
        free = np.asarray(model.predict(x0, inputs)[0]).reshape(len(u), -1) / gain_y + mean_y
        return np.concatenate([start, free[len(start) :]])

    return simulate


def document(found: Sequence[Figure], limits: Mapping[str, Any]) -> dict[str, Any]:
    """All figures, and the geometric mean of ours over the best of linear and jax-sysid."""
    ratios = []
    for name in dict.fromkeys(one.set for one in found):
        pooled = {one.model: one.rmse for one in found if one.set == name and one.record == ""}
        peers = [pooled[model] for model in (LINEAR, JAX) if model in pooled]
        ratios.append(pooled[OURS] / min(peers))
    mean = float(np.exp(np.mean(np.log(ratios)))) if ratios else None
    return {
        "schema": SCHEMA,
        **limits,
        "geometric_mean_ratio": mean,
        "figures": [one.row() for one in found],
    }
