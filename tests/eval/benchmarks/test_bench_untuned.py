"""Configurations of columns and split alone: what is flown, what is said of it."""

import math
from types import SimpleNamespace

import pytest

from eval.benchmarks import untuned
from eval.benchmarks.untuned import SETS
from training.config import SCHEMA, RunConfig

NAMES = [one.name for one in SETS]


def parsed(one, folder):
    logs = {**one.tables.get("logs", {}), "folder": str(folder)}
    return RunConfig.parse({**one.tables, "schema": SCHEMA, "logs": logs}, one.name)


@pytest.mark.parametrize("one", SETS, ids=NAMES)
def test_a_set_says_nothing_of_the_model(one, tmp_path):
    config = parsed(one, tmp_path)
    usual = RunConfig.parse({"narx": {"outputs": config.narx.outputs}})
    inputs = {"schedule": config.narx.schedule}  # goes by what inputs there are
    assert config.narx == usual.narx.model_copy(update=inputs)
    assert config.train == usual.train
    own = config.steady_state
    assert own == usual.steady_state.model_copy(update={"inputs": own.inputs})
    assert config.smooth == usual.smooth
    assert config.split.test


def test_figures_stand_beside_the_better_baseline():
    def channel(rmse, lag, arx):
        return SimpleNamespace(rmse=rmse, first_order_rmse=lag, arx_rmse=arx)

    def baseline(passed):
        return SimpleNamespace(passed=passed)

    log = SimpleNamespace(baselines={"first_order": baseline(1), "arx": baseline(2)})
    found = SimpleNamespace(
        pooled={"N1_pct": channel(0.5, 2.0, math.nan), "EGT_C": channel(9.0, 8.0, 7.0)},
        tally=SimpleNamespace(passed=6, assessed=8, passed_pct=75.0),
        logs=[log, log],
    )
    times, n1, egt = untuned.rows_of("set", found)
    assert (n1.value, n1.target, n1.reached) == (0.5, 2.0, True)
    assert (egt.target, egt.unit, egt.reached) == (7.0, "degC", False)
    assert (times.value, times.target) == (75.0, 50.0)
    assert times.note == "6 of 8; best baseline 4"


def test_a_set_is_trained_and_judged_on_what_took_no_part(tmp_path, monkeypatch):
    seen = {}

    def calibrate(config, folder, split):
        seen["train"] = [log.name for log in split.train]
        return "bundle"

    monkeypatch.setattr(untuned, "calibrate", calibrate)
    monkeypatch.setattr(untuned, "evaluate", lambda _, logs: [log.name for log in logs])
    [one] = [one for one in SETS if one.name.startswith("lumped, N2")]
    scenario, engine = one.logs.args
    plan = {**scenario["plan"], "duration_s": 480.0, "rate_hz": 8.0}
    one.logs.func({**scenario, "plan": plan}, engine, tmp_path, 5, tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == {f"flight_{n}.csv" for n in (1, 2, 3, 4)}
    judged = untuned.judged(one, tmp_path)
    assert [name.partition(".")[0] for name in judged] == ["flight_4"]
    assert [name.partition(".")[0] for name in seen["train"]] == [f"flight_{n}" for n in (1, 2, 3)]
