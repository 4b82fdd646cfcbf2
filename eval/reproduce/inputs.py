"""Studies of what networks are fed.

`inputs`, section 3.1 of the paper: one or many data sets times one or many inputs, N1 as output.

`deviations`, section 3.2: networks on the deviation from steady state. The paper feeds dN1, dN2 and
dEGT to predict dN1, then dEGT alone. Here each variant has the steady-state values and its own past
dN1 as inputs; the other deviations, where a variant has them, are the *measured* ones of the sample
before, as the paper's are. The last variant is the product's: all three deviations in free run,
nothing measured but the start.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from data_prep.log import Log
from eval.judging.scores import max_relative_percent, rmse
from eval.report import figures
from eval.report.style import Picture, unit
from eval.report.tables import Table, figure
from eval.reproduce.data import DataSets, Effort, NetworkFit, cut, fit_all, within
from eval.reproduce.study import Claim, Study, claim, table_of
from narxcal.calibration.bundle import Bundle
from narxcal.calibration.calibration import steady_for_engine
from narxcal.channels import symbol
from narxcal.narx.config import NarxConfig
from narxcal.narx.network import NarxModel
from narxcal.record import Record
from narxcal.steady.model import SteadyStateModel
from narxcal.support.arrays import FloatArray
from training.config import RunConfig
from training.pipeline import calibration_for
from training.records import deviation_record, structure_of

CRITERION = 5.0  # mean square error in %^2, section 3.1


@dataclass(frozen=True, eq=False)
class Variant:
    """One network: what it was fed and learned from, and its free runs (time,) per test log.

    `mse` is per test log; `pooled` (mean square error) and `max_rel_pct` are over all of them.
    """

    name: str
    fed: tuple[str, ...]
    runs: tuple[FloatArray, ...]
    mse: tuple[float, ...]
    pooled: float
    max_rel_pct: float
    trained_on: tuple[Log, ...] = ()

    @classmethod
    def of(
        cls, name: str, fed: Sequence[str], output: str, tests: Sequence[Log],
        runs: Sequence[FloatArray],
    ) -> Variant:  # fmt: skip
        """Judge free runs of `output` over the test logs."""
        measured = [log[output][:, None] for log in tests]
        own = [run[:, None] for run in runs]
        single = [float(rmse(a, b)[0] ** 2) for a, b in zip(measured, own, strict=True)]
        every = np.concatenate(measured), np.concatenate(own)
        pooled, worst = float(rmse(*every)[0] ** 2), float(max_relative_percent(*every)[0])
        return cls(name, tuple(fed), tuple(runs), tuple(single), pooled, worst)


def inputs(data: DataSets, effort: Effort) -> Study:
    """Fit the four networks straight from the inputs to the speed, and run them free."""
    output = data.config.narx.outputs[0]
    found = variants(data, effort, output)
    last, best = found[-1], min(found, key=lambda one: one.pooled)
    remark = "" if best is last else f"the best is: {best.name}"
    name, tests = symbol(output), [str(data.number(log.name)) for log in data.split.test]
    return Study(
        key="inputs",
        title="One or many data sets, one or many inputs",
        source="section 3.1",
        text=f"A plain NARX network from the inputs to {symbol(output)}, without a steady-state "
        "model; free run over whole test data sets, started from their first measured samples. "
        f"Test: data sets {data.labels(data.split.test)}.",
        claims=[
            claim("narx-paper", "mse", last.pooled, name=name, unit=unit(output)),
            claim("narx-paper", "best", last.pooled / best.pooled, name=name, remark=remark),
        ],
        tables=[_table(data, found, output)],
        pictures=[_picture(data.split.test[0], found, output)],
        results={
            "output": output,
            "variants": [
                {
                    "variant": one.name,
                    "inputs": list(one.fed),
                    "trained_on": [data.number(log.name) for log in one.trained_on],
                    "mse": dict(zip(tests, one.mse, strict=True)),
                    "pooled_mse": one.pooled,
                }
                for one in found
            ],
        },
    )


def variants(data: DataSets, effort: Effort, output: str) -> list[Variant]:
    """Single-single, single-multiple, multiple-single and multiple-multiple, in this order."""
    train, config = data.split.train, within(data.config, effort)
    names, events, dt_s = data.inputs, data.config.events, train[0].dt_s
    plans = [
        (f"{many} data, {several} input", logs, chosen)
        for many, logs in (("single", train[:1]), ("multiple", train))
        for several, chosen in (("single", names[:1]), ("multiple", names))
    ]
    structure = NarxConfig(lags=2, taps=(0, 1), hidden=config.narx.hidden)
    tasks = [
        NetworkFit(
            [Record(log.matrix(fed), log.matrix([output]), log.name) for log in cut(logs, events)],
            structure,
            dt_s,
        )
        for _, logs, fed in plans
    ]
    tests, found = data.split.test, []
    for model, (name, logs, fed) in zip(fit_all(tasks, config, effort.jobs), plans, strict=True):
        runs = [
            model.simulate(log.matrix(fed), _start(log[output], structure.lags))[:, 0]
            for log in tests
        ]
        found.append(replace(Variant.of(name, fed, output, tests, runs), trained_on=logs))
    return found


def _start(measured: FloatArray, lags: int) -> FloatArray:
    """The first samples (lags, 1), a masked one replaced by the first known."""
    first = measured[np.isfinite(measured)][:1]
    return np.where(np.isfinite(measured[:lags]), measured[:lags], first)[:, None]


def _table(data: DataSets, found: Sequence[Variant], output: str) -> Table:
    tests = [data.label(log.name) for log in data.split.test]
    rows = [
        (
            one.name,
            ", ".join(symbol(name) for name in one.fed),
            data.labels(one.trained_on),
            *(figure(value, "good" if value < CRITERION else "bad") for value in one.mse),
            figure(one.pooled, "good" if one.pooled < CRITERION else "bad"),
        )
        for one in found
    ]
    caption = f"Mean square error of {symbol(output)} in ({unit(output)})², free run"
    return table_of(caption, ("variant", "inputs", "trained on", *tests, "all"), rows)


def _picture(log: Log, found: Sequence[Variant], output: str) -> Picture:
    shown = {one.name: one.runs[0] for one in found}
    return figures.free_runs(log.time_s, output, log[output], shown)


LIMIT_PCT = 5.0


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
            _claim(paper, output, "measured deviations help: in use there are none"),
            _claim(ours, output, "nothing measured but the first sample"),
        ],
        tables=[_deviation_table(found, output)],
        results={
            "output": output,
            "variants": [
                {"variant": one.name, "measured": list(one.fed), "max_rel_pct": one.max_rel_pct,
                 "rmse": one.pooled**0.5}
                for one in found
            ],
        },
    )  # fmt: skip


def _claim(one: Variant, output: str, remark: str) -> Claim:
    fills = {"name": symbol(output), "variant": one.name, "remark": remark}
    return claim("narx-paper", "deviation", one.max_rel_pct, **fills)


def fed_variants(data: DataSets, bundle: Bundle, effort: Effort) -> list[Variant]:
    """Own past alone; with the temperature's deviation; with all; and the calibration itself."""
    outputs = data.config.narx.outputs
    config, steady = within(data.config, effort), bundle.calibration.steady
    others = outputs[1:]
    plans = list(dict.fromkeys([(), others[-1:], others]))
    tests = data.split.test
    # The network alone, without lags in front of it or a path round it.
    plain = structure_of(config).model_copy(update={"linear_feedback": False})
    tasks = [
        NetworkFit(
            [fed_record(log, steady, config, plan) for log in data.training.train],
            plain.model_copy(update={"moving": len(outputs) + len(plan)}),
            bundle.calibration.dt_s,
        )
        for plan in plans
    ]
    models = fit_all(tasks, config, effort.jobs)
    fed = [
        Variant.of(
            f"{_deltas((outputs[0], *plan))} → {_deltas(outputs[:1])}", plan, outputs[0], tests,
            _runs(model, plan, steady, data),
        )
        for model, plan in zip(models, plans, strict=True)
    ]  # fmt: skip
    own = f"{_deltas(outputs)} → all of them, simulated"
    return [*fed, Variant.of(own, (), outputs[0], tests, _own_runs(tests, bundle))]


def _deltas(names: Sequence[str]) -> str:
    return ", ".join(f"Δ{symbol(name)}" for name in names)


def fed_record(
    log: Log, steady: SteadyStateModel, config: RunConfig, measured: Sequence[str]
) -> Record:
    """The first output's record with measured deviations of the sample before among the inputs.

    They vanish in equilibrium like the increments of the steady-state values, and so come first.
    """
    whole = deviation_record(log, steady, config)
    columns = [config.narx.outputs.index(name) for name in measured]
    before = np.nan_to_num(np.vstack([whole.y[:1], whole.y[:-1]])[:, columns])
    return Record(np.hstack([before, whole.u]), whole.y[:, :1], log.name)


def _runs(
    model: NarxModel,
    measured: Sequence[str],
    steady: SteadyStateModel,
    data: DataSets,
) -> list[FloatArray]:
    plain = data.config.having(train={"local_trim": False})
    runs = []
    for log in data.split.test:
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


def _deviation_table(found: Sequence[Variant], output: str) -> Table:
    rows = [
        (
            one.name,
            ", ".join(symbol(name) for name in one.fed) or "nothing",
            figure(one.max_rel_pct, "good" if one.max_rel_pct < LIMIT_PCT else "bad"),
            one.pooled**0.5,
        )
        for one in found
    ]
    head = ("variant", "fed as measured", "max relative error [%]", "RMSE")
    return table_of(f"{symbol(output)} in free run over the test data sets", head, rows)
