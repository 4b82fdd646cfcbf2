"""One recipe on public sets: `narxcal benchmark`.

Every set is fitted by `Narx()` with nothing said about it, by the linear rungs alone, chosen by the
same folds, by a network of fixed size without a choice, and by jax-sysid where the interpreter of
an environment that has it is given: it wants an older scipy than narxcal, so `jax_peer` runs there.
The official test range is run once by each; the first `init_window` samples start a model and are
not scored.
"""

from __future__ import annotations

import subprocess
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from eval.benchmarks import jax_peer
from eval.benchmarks.public_sets import SETS, Material, read
from eval.scores import rms
from narxcal.narx.forms import DynamicModel
from narxcal.support.arrays import FloatArray
from narxcal.support.errors import ConfigError, DataError
from training.choice import Limits, choose
from training.estimator import Narx
from training.search import Watch

SCHEMA = "narxcal.benchmark/1"
OURS, FIXED, LINEAR, JAX = "Narx()", "Narx(None)", "linear", "jax-sysid"
Runs = list[FloatArray]  # free runs of the test recordings
Fitted = tuple[Runs, float, str]  # with CPU seconds of the fit, and a note
_PATIENCE_S = 1200.0  # for jax-sysid, which has no limit of its own


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
    folder: Path,
    name: str,
    limits: Limits,
    watch: Watch | None = None,
    jax_python: Path | None = None,
) -> Iterator[Figure]:
    """Ours, a fixed network, linear, jax-sysid where given, and a set's published figures."""
    material = read(folder, name)
    known = {one.name: one for one in SETS}.get(name)
    unit, factor = ("", 1.0) if known is None else (known.unit, known.factor)
    fits: dict[str, Callable[[], Fitted]] = {
        OURS: lambda: _chosen(material, limits, watch),
        FIXED: lambda: _fixed(material),
        LINEAR: lambda: _chosen(material, replace(limits, linear=True)),
    }
    if jax_python is not None:
        fits[JAX] = lambda: _jax_sysid(material, jax_python)
    for model, fit in fits.items():
        runs, spent, note = fit()
        for record, error, spread in _errors(runs, material):
            pct = 100.0 * error / spread if spread > 0.0 else np.nan
            yield Figure(name, model, record, factor * error, pct, unit, spent, note)
    for target in () if known is None else known.targets:
        note = target.source
        yield Figure(name, "published", target.record, target.value, np.nan, unit, np.nan, note)


def _chosen(material: Material, limits: Limits, watch: Watch | None = None) -> Fitted:
    began = time.process_time()
    found = choose(list(material.train), limits, watch)
    return _runs(found.model, material), time.process_time() - began, found.reason


def _fixed(material: Material) -> Fitted:
    began = time.process_time()
    found = Narx(None).fit(list(material.train))
    spent = time.process_time() - began
    return _runs(found, material), spent, "8 lags, taps 0 to 8, 8 hidden units"


def _runs(model: DynamicModel | Narx, material: Material) -> Runs:
    return [model.simulate(record.u, record.y[: material.init]) for record in material.test]


def _jax_sysid(material: Material, python: Path) -> Fitted:
    """By `jax_peer`, which knows of the test recordings their inputs and first outputs only."""
    given: dict[str, FloatArray] = {}
    for k, record in enumerate(material.train):
        given |= {f"u{k}": record.u, f"y{k}": record.y}
    for k, record in enumerate(material.test):
        given |= {f"v{k}": record.u, f"w{k}": record.y[: material.init]}
    with tempfile.TemporaryDirectory() as folder:
        ask, answer = Path(folder, "material.npz"), Path(folder, "answer.npz")
        np.savez(ask, **given)  # type: ignore[arg-type]
        try:
            done = subprocess.run(  # noqa: S603 (the interpreter is the user's own choice)
                [python, Path(jax_peer.__file__), ask, answer],
                capture_output=True, text=True, check=False, timeout=_PATIENCE_S,
            )  # fmt: skip
        except subprocess.TimeoutExpired:
            never = [np.full_like(record.y, np.nan) for record in material.test]
            return never, np.nan, f"not done after {_PATIENCE_S:g} s"
        except OSError as error:
            raise ConfigError(f"--jax-python: {python} can't be run: {error.strerror}") from None
        if done.returncode:
            last = (done.stderr.strip().splitlines() or ["no message"])[-1]
            raise ConfigError(
                f"--jax-python: jax-sysid failed in {python}: {last}",
                hint="Give the Python of an environment after `pip install jax-sysid==1.1.0`",
            )
        with np.load(answer, allow_pickle=False) as found:
            runs = [found[f"y{k}"] for k in range(len(material.test))]
            return runs, float(found["cpu_s"]), jax_peer.NOTE


def _rms(error: FloatArray) -> float:
    return rms(error) if np.isfinite(error).any() else float("nan")


def _errors(runs: Runs, material: Material) -> Iterator[tuple[str, float, float]]:
    """(recording, RMSE, standard deviation), each test recording and all pooled."""
    errors, outputs = [], []
    for record, run in zip(material.test, runs, strict=True):
        error = (run - record.y)[material.init :]
        errors.append(error)
        outputs.append(record.y[material.init :])
        if len(material.test) > 1:
            yield record.name, _rms(error), float(np.std(outputs[-1]))
    yield "", _rms(np.concatenate(errors)), float(np.std(np.concatenate(outputs)))


def document(found: Sequence[Figure], limits: Mapping[str, Any]) -> dict[str, Any]:
    """All figures, and the geometric mean of ours over the best of linear and jax-sysid."""
    ratios = []
    for name in dict.fromkeys(one.set for one in found):
        pooled = {one.model: one.rmse for one in found if one.set == name and one.record == ""}
        peers = [pooled[model] for model in (LINEAR, JAX) if model in pooled]
        ratios.append(pooled[OURS] / float(np.nanmin(peers)))
    mean = float(np.exp(np.mean(np.log(ratios)))) if ratios else None
    return {
        "schema": SCHEMA,
        **limits,
        "geometric_mean_ratio": mean,
        "figures": [one.row() for one in found],
    }
