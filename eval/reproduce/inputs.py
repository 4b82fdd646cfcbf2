"""Section 3.1 of the paper: one or many data sets times one or many inputs, N1 as output."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from data_prep.log import FloatArray, Log
from eval.metrics import rmse
from eval.report import paper_figures
from eval.report.claims import Claim, Study
from eval.report.style import symbol, unit
from eval.report.svg import Picture
from eval.report.tables import Cell, Table, figure
from eval.reproduce.data_sets import DataSets
from eval.reproduce.effort import Effort, Task, fit_all, within
from eval.reproduce.pieces import cut
from narxcal.narx_config import NarxConfig
from narxcal.narx_model import NarxModel
from narxcal.records import Record

CRITERION = 5.0  # mean square error in %^2, section 3.1


@dataclass(frozen=True, eq=False)
class Variant:
    """One of the four: what it is trained on, what it sees, and its free runs on the tests.

    `runs` are `(time,)` per test log; `mse` is per test log and `pooled` over all of them.
    """

    name: str
    trained_on: tuple[Log, ...]
    inputs: tuple[str, ...]
    runs: tuple[FloatArray, ...]
    mse: tuple[float, ...]
    pooled: float


def inputs(data: DataSets, effort: Effort) -> Study:
    """Fit the four networks straight from the inputs to the speed, and run them free."""
    output = data.config.narx.outputs[0]
    found = variants(data, effort, output)
    best = min(found, key=lambda one: one.pooled)
    return Study(
        key="inputs",
        title="One or many data sets, one or many inputs",
        source="section 3.1",
        text=f"A plain NARX network from the inputs to {symbol(output)}, without a steady-state "
        "model; free run over whole test data sets, started from their first measured samples. "
        f"Test: data sets {data.labels(data.split.test)}.",
        claims=[_criterion(found[-1], output), _order(found, best, output)],
        tables=[_table(data, found, output)],
        pictures=_pictures(data, found, output),
        results={"output": output, "variants": [_row(data, one) for one in found]},
    )


def variants(data: DataSets, effort: Effort, output: str) -> list[Variant]:
    """Single-single, single-multiple, multiple-single and multiple-multiple, in this order."""
    train, config = data.split.train, within(data.config, effort)
    names, events = data.inputs, data.config.events
    plans = [
        (f"{many} data, {several} input", logs, chosen)
        for many, logs in (("single", train[:1]), ("multiple", train))
        for several, chosen in (("single", names[:1]), ("multiple", names))
    ]
    structure = NarxConfig(lags=2, taps=(0, 1), hidden=config.narx.hidden)
    dt_s = train[0].dt_s
    tasks = [
        Task([record(log, chosen, output) for log in cut(logs, events)], structure, dt_s)
        for _, logs, chosen in plans
    ]
    models = fit_all(tasks, config, effort.jobs)
    return [
        _judged(data.split.test, model, plan, output)
        for model, plan in zip(models, plans, strict=True)
    ]


def record(log: Log, names: Sequence[str], output: str) -> Record:
    """What a plain network learns from; `log` has its masked inputs held."""
    return Record(log.matrix(names), log.matrix([output]), log.name)


def _judged(
    tests: Sequence[Log],
    model: NarxModel,
    plan: tuple[str, tuple[Log, ...], tuple[str, ...]],
    output: str,
) -> Variant:
    name, logs, chosen = plan
    lags = model.config.lags
    start = [_start(log[output], lags) for log in tests]
    runs = [
        model.simulate(log.matrix(chosen), first)[:, 0]
        for log, first in zip(tests, start, strict=True)
    ]
    measured = [log[output] for log in tests]
    single = [_mse(truth, run) for truth, run in zip(measured, runs, strict=True)]
    pooled = _mse(np.concatenate(measured), np.concatenate(runs))
    return Variant(name, logs, chosen, tuple(runs), tuple(single), pooled)


def _start(measured: FloatArray, lags: int) -> FloatArray:
    """The first samples (lags, 1), a masked one replaced by the first known."""
    first = measured[np.isfinite(measured)][:1]
    return np.where(np.isfinite(measured[:lags]), measured[:lags], first)[:, None]


def _mse(measured: FloatArray, model: FloatArray) -> float:
    return float(rmse(measured[:, None], model[:, None])[0] ** 2)


def _criterion(one: Variant, output: str) -> Claim:
    return Claim(
        what=f"MSE of {symbol(output)}, multiple data and inputs, over all test data sets",
        claimed=f"< {CRITERION:g}",
        value=one.pooled,
        bound=CRITERION,
        unit=f"({unit(output)})²",
        remark="a free run over whole data sets, not one-step and not event by event",
    )


def _order(found: Sequence[Variant], best: Variant, output: str) -> Claim:
    last = found[-1]
    return Claim(
        what=f"MSE of {symbol(output)}, multiple data and inputs, over the best variant's",
        claimed="1 (it is the best of the four)",
        value=last.pooled / best.pooled,
        bound=1.0 + 1e-9,
        remark="" if best is last else f"the best is: {best.name}",
    )


def _table(data: DataSets, found: Sequence[Variant], output: str) -> Table:
    tests = [f"No. {data.number(log.name)}" for log in data.split.test]
    rows = [
        (
            Cell(one.name, "head"),
            Cell(", ".join(symbol(name) for name in one.inputs)),
            Cell(data.labels(one.trained_on)),
            *(figure(value, "good" if value < CRITERION else "bad") for value in one.mse),
            figure(one.pooled, "good" if one.pooled < CRITERION else "bad"),
        )
        for one in found
    ]
    caption = f"Mean square error of {symbol(output)} in ({unit(output)})², free run"
    return Table(caption, ("variant", "inputs", "trained on", *tests, "all"), tuple(rows))


def _pictures(data: DataSets, found: Sequence[Variant], output: str) -> list[Picture]:
    labels = [data.label(log.name) for log in data.split.test]
    groups = {one.name: np.array(one.mse) for one in found}
    what = f"MSE of {symbol(output)} [({unit(output)})²]"
    log = data.split.test[0]
    shown = {one.name: one.runs[0] for one in found}
    return [
        paper_figures.bars(labels, groups, what, CRITERION),
        paper_figures.free_runs(log.time_s, output, log[output], shown),
    ]


def _row(data: DataSets, one: Variant) -> dict[str, Any]:
    tests = [data.number(log.name) for log in data.split.test]
    return {
        "variant": one.name,
        "inputs": list(one.inputs),
        "trained_on": [data.number(log.name) for log in one.trained_on],
        "mse": {str(number): value for number, value in zip(tests, one.mse, strict=True)},
        "pooled_mse": one.pooled,
    }
