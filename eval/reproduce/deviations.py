"""Section 3.2 of the paper: networks on the deviation from steady state, by what they are fed.

The paper feeds dN1, dN2 and dEGT to predict dN1, then dEGT alone. Here each variant knows the
steady-state values and its own past dN1; the other deviations, where a variant has them, are the
*measured* ones of the sample before, as the paper's are. The last variant is the product's: all
three deviations in free run, nothing measured but the start.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from data_prep.log import FloatArray, Log
from eval.metrics import max_relative_percent, rmse
from eval.report.claims import Claim, Study
from eval.report.style import symbol
from eval.report.tables import Cell, Table, figure
from eval.reproduce.data_sets import DataSets
from eval.reproduce.effort import Effort, Task, fit_all, within
from narxcal.bundle import Bundle
from narxcal.calibration import steady_for_engine
from narxcal.narx_config import NarxConfig
from narxcal.narx_model import NarxModel
from narxcal.records import Record
from narxcal.steady_state import SteadyStateModel
from training.config import RunConfig
from training.pipeline import calibration_for, deviation_record

LIMIT_PCT = 5.0


@dataclass(frozen=True, eq=False)
class Fed:
    """One variant: the deviations fed as measured, and N1 in free run per test log."""

    name: str
    measured: tuple[str, ...]
    runs: tuple[FloatArray, ...]
    max_rel_pct: float
    rmse: float


def deviations(data: DataSets, bundle: Bundle, effort: Effort) -> Study:
    """Fit the variants on the training data sets; `bundle` is the product's own calibration."""
    output = data.config.narx.outputs[0]
    found = fed_variants(data, bundle, effort)
    paper, ours = found[-2], found[-1]
    return Study(
        key="deviations",
        title="What the network on the deviation is fed",
        source="section 3.2",
        text=f"Δ is the steady-state value minus the actual one. Free run of Δ{symbol(output)} "
        f"over whole test data sets {data.labels(data.split.test)}; further deviations are the "
        "measured ones of the sample before, except in the last variant, which simulates them and "
        "has lags in front of its network where [narx] lag says so.",
        claims=[
            Claim(
                what=f"Largest relative error of {symbol(output)}: {one.name}",
                claimed=f"< {LIMIT_PCT:g} %",
                value=one.max_rel_pct,
                bound=LIMIT_PCT,
                unit="%",
                remark=remark,
            )
            for one, remark in (
                (paper, "measured deviations help: in use there are none"),
                (ours, "nothing measured but the first sample"),
            )
        ],
        tables=[_table(found, output)],
        results={"output": output, "variants": [_row(one) for one in found]},
    )


def fed_variants(data: DataSets, bundle: Bundle, effort: Effort) -> list[Fed]:
    """Own past alone; with the temperature's deviation; with all; and the calibration itself."""
    outputs = data.config.narx.outputs
    config, steady = within(data.config, effort), bundle.calibration.steady
    others = outputs[1:]
    plans = list(dict.fromkeys([(), others[-1:], others]))
    tests = data.split.test
    tasks = [
        Task(
            [fed_record(log, steady, config, plan) for log in data.training.train],
            _structure(config, moving=len(outputs) + len(plan)),
            bundle.calibration.dt_s,
        )
        for plan in plans
    ]
    models = fit_all(tasks, config, effort.jobs)
    fed = [
        _judged(
            tests,
            outputs[0],
            (_name(outputs, plan), plan),
            _runs(tests, steady, config, (model, plan)),
        )
        for model, plan in zip(models, plans, strict=True)
    ]
    own = _judged(tests, outputs[0], (_own_name(outputs), ()), _own_runs(tests, bundle))
    return [*fed, own]


def _structure(config: RunConfig, moving: int) -> NarxConfig:
    """The network of `config` alone, without lags in front of it or a path round it."""
    section = config.narx
    return NarxConfig(
        lags=section.lags,
        taps=section.taps,
        hidden=section.hidden,
        margin=section.margin,
        moving=moving,
    )


def fed_record(
    log: Log, steady: SteadyStateModel, config: RunConfig, measured: Sequence[str]
) -> Record:
    """The first output's record with measured deviations of the sample before among the inputs.

    They vanish at rest like the increments of the steady-state values, and so stand before them.
    """
    whole = deviation_record(log, steady, config)
    columns = [config.narx.outputs.index(name) for name in measured]
    before = np.nan_to_num(np.vstack([whole.y[:1], whole.y[:-1]])[:, columns])
    return Record(np.hstack([before, whole.u]), whole.y[:, :1], log.name)


def _runs(
    tests: Sequence[Log],
    steady: SteadyStateModel,
    config: RunConfig,
    fitted: tuple[NarxModel, Sequence[str]],
) -> list[FloatArray]:
    model, measured = fitted
    plain = config.model_copy(
        update={"train": config.train.model_copy(update={"local_trim": False})}
    )
    runs = []
    for log in tests:
        own = steady_for_engine(steady, log.source.engine)
        record = fed_record(log, steady, plain, measured)
        deviation = model.simulate(record.u, np.nan_to_num(record.y[:1]))
        runs.append(own.outputs(log.matrix(own.input_names))[:, 0] - deviation[:, 0])
    return runs


def _own_runs(tests: Sequence[Log], bundle: Bundle) -> list[FloatArray]:
    runs = []
    for log in tests:
        own = calibration_for(bundle.calibration, log)
        start = log.matrix(own.output_names)[0]
        runs.append(own.simulate(log.matrix(own.input_names), start)[:, 0])
    return runs


def _judged(
    tests: Sequence[Log],
    output: str,
    what: tuple[str, Sequence[str]],
    runs: Sequence[FloatArray],
) -> Fed:
    name, measured = what
    truth = np.concatenate([log[output] for log in tests])[:, None]
    model = np.concatenate(runs)[:, None]
    return Fed(
        name,
        tuple(measured),
        tuple(runs),
        float(max_relative_percent(truth, model)[0]),
        float(rmse(truth, model)[0]),
    )


def _name(outputs: Sequence[str], measured: Sequence[str]) -> str:
    fed = ", ".join(f"Δ{symbol(name)}" for name in (outputs[0], *measured))
    return f"{fed} → Δ{symbol(outputs[0])}"


def _own_name(outputs: Sequence[str]) -> str:
    every = ", ".join(f"Δ{symbol(name)}" for name in outputs)
    return f"{every} → all of them, simulated"


def _table(found: Sequence[Fed], output: str) -> Table:
    rows = [
        (
            Cell(one.name, "head"),
            Cell(", ".join(symbol(name) for name in one.measured) or "nothing"),
            figure(one.max_rel_pct, "good" if one.max_rel_pct < LIMIT_PCT else "bad"),
            figure(one.rmse),
        )
        for one in found
    ]
    head = ("variant", "fed as measured", "max relative error [%]", "RMSE")
    return Table(f"{symbol(output)} in free run over the test data sets", head, tuple(rows))


def _row(one: Fed) -> dict[str, Any]:
    return {
        "variant": one.name,
        "measured": list(one.measured),
        "max_rel_pct": one.max_rel_pct,
        "rmse": one.rmse,
    }
