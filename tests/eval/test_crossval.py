"""Cross-validation end to end on an engine that a small network can learn."""

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from eval.judging.crossval import CrossValidation, FoldResult, cross_validate, spread
from eval.report.page import RunHeader, crossval_page
from eval.report.tables import measures
from eval.run_logs import EvaluateConfig
from narxcal.support.errors import DataError
from training.config import RunConfig


@pytest.fixture(scope="module")
def config():
    return RunConfig.parse(
        {
            "schema": "narxcal.config/1",
            "smooth": {"window": 1},
            "events": {"condition": "", "response": ["N1_pct", "N2_pct"]},
            "steady_state": {
                "inputs": ["TRA_deg", "Mach"], "blend": [], "corrected": False,
                "fit": {"knots": 3},
            },
            "narx": {
                "outputs": ["N1_pct", "N2_pct"], "schedule": [], "hidden": 1, "lags": 1,
                "lag_limits": False,
            },
            "train": {"horizons_s": [5.0], "iterations": [2], "choice_s": 0.0},
            "evaluate": {"crossval": {"random_splits": 2}, "largest_rmse": {"N1_pct": 5.0}},
        }
    )  # fmt: skip


def dividing(config, **how):
    """The configuration with these divisions; `how` are keys of [evaluate.crossval]."""
    evaluate = {"crossval": how, "largest_rmse": {"N1_pct": 5.0}}
    return config.model_copy(update={"evaluate": evaluate})


def unlike(make_log, *names):
    """Flights of one engine whose speeds differ by their build."""
    return [
        make_log(f"{name}.csv:left", 200.0, offset=(0.2 * k, -0.2 * k))
        for k, name in enumerate(names)
    ]


@pytest.fixture
def flights(make_log):
    return unlike(make_log, "a", "b")


@pytest.mark.slow
def test_folds_are_judged_and_do_not_depend_on_the_number_of_processes(config, flights):
    seen = []
    one = cross_validate(config, Path(), flights, 1, lambda *done: seen.append(done[:2]))
    two = cross_validate(dividing(config, random_splits=0), Path(), flights, 2)
    same = [json.dumps(found.document()["schemes"][0]) for found in (one, two)]
    assert same[0] == same[1]
    assert seen == [(k, 4) for k in range(1, 5)]
    document = one.document()
    assert document["schema"] == "narxcal.crossval/1"
    names = [scheme["name"] for scheme in document["schemes"]]
    assert names == ["leave one flight out", "random splits by event"]
    assert [fold["seed"] for fold in document["schemes"][1]["folds"]] == [0, 1]
    for scheme in document["schemes"]:
        for fold in scheme["folds"]:
            values = fold["values"]
            assert values["rmse.N1_pct"] < 1.0
            assert values["max_rel_pct.N2_pct"] < 10.0
            assert values["assessed"] > 0
            assert values["mean_relative_Ti_pct"] is not None
            assert values["mean_relative_Tt_pct"] is not None
            assert values["worst_rmse.N1_pct"] >= values["rmse.N1_pct"]
        assert set(scheme["spread"]["rmse.N1_pct"]) == {"mean", "std", "min", "max"}
    page = crossval_page(RunHeader(title="Folds", created="today"), one)
    assert "without a.csv:left" in page
    assert "split 2, seed 1" in page


def test_a_segment_without_valid_inputs_is_named_and_the_rest_judged(config, flights, mask):
    lost = mask(flights[0], "Mach", slice(None, 1000))
    only = dividing(config, leave_one_flight_out=False, random_splits=3)
    found = cross_validate(only, Path(), [lost, flights[1]], 1)
    named = {name for fold in found.folds for name in fold.not_judged}
    assert named
    assert all(name.startswith("a.csv:left[") for name in named)
    assert all(fold.figures["rmse.N1_pct"] is not None for fold in found.folds)


def test_one_flight_alone_is_divided_by_event_and_says_so(config, flights):
    found = cross_validate(config, Path(), flights[:1], 1)
    assert list(found.schemes) == ["random splits by event"]
    assert "takes two flights or more, found 1" in found.skipped["leave one flight out"]


def without(log, name):
    return replace(log, channels={k: v for k, v in log.channels.items() if k != name})


def held(log):
    return log.with_channels({"TRA_deg": np.full(len(log), 30.0)})


@pytest.mark.parametrize(
    ("how", "change", "problem"),
    [
        (
            {"leave_one_flight_out": False},
            lambda logs: [held(logs[0])],
            (
                "expected at least two events to divide, found 0. Check [events], or set "
                "random_splits = 0"
            ),
        ),
        (
            {"leave_one_flight_out": False, "random_splits": 0},
            lambda logs: logs,
            "[evaluate.crossval] demands none",
        ),
        (
            {"random_splits": 0},
            lambda logs: [without(logs[0], "N1_pct"), logs[1]],
            (
                "channel N1_pct: without b.csv:left, no sample of this output is left to learn "
                "from. Take it out of [narx] outputs, or add logs that have it"
            ),
        ),
    ],
)
def test_where_nothing_can_be_divided_it_is_refused_before_the_work(
    config, flights, how, change, problem
):
    expected = f"no division of the logs is possible: {problem}"
    with pytest.raises(DataError, match=f"^{re.escape(expected)}$"):
        cross_validate(dividing(config, **how), Path(), change(flights), 1)


def fold(name, **values):
    return FoldResult("leave one flight out", name, None, ("a",), ("b",), values)


def test_the_spread_is_that_of_the_folds_with_a_figure():
    found = spread([fold("1", x=1.0, y=None), fold("2", x=4.0, y=7.0), fold("3", x=4.0, y=None)])
    assert found["x"] == {
        "mean": 3.0, "std": pytest.approx(np.sqrt(3.0)), "min": 1.0, "max": 4.0,
    }  # fmt: skip
    assert found["y"] == {"mean": 7.0, "std": None, "min": 7.0, "max": 7.0}


def test_what_is_missed_names_scheme_and_fold():
    folds = (
        fold("1", **{"rmse.N1_pct": 6.0, "assessed": 10, "passed": 9}),
        fold("2", **{"rmse.N1_pct": 4.0, "assessed": 10, "passed": 9}),
    )
    found = CrossValidation(folds, EvaluateConfig(largest_rmse={"N1_pct": 5.0}))
    assert found.missed == [
        "leave one flight out: 18 of 20 transients pass (90.0 %), at least 95 % have to",
        "leave one flight out, 1: N1_pct RMSE 6, at most 5 allowed",
    ]
    assert found.outcome.exit_code == 1
    assert [part.limit for part in measures(found) if part.key == "rmse.N1_pct"] == [5.0]


def test_a_scheme_without_an_assessed_transient_is_no_pass():
    found = CrossValidation((fold("1", assessed=0, passed=0),), EvaluateConfig())
    assert found.missed == ["leave one flight out: no transient could be assessed"]
    assert found.outcome.exit_code == 1


def test_an_output_that_a_flight_lacks_is_learned_from_the_others(config, make_log):
    flights = unlike(make_log, "a", "b", "c")
    flights[0] = without(flights[0], "N1_pct")
    folds = cross_validate(dividing(config, random_splits=0), Path(), flights, 1).folds
    values = {fold.name: fold.figures for fold in folds}
    assert values["without a.csv:left"]["rmse.N1_pct"] is None
    assert values["without a.csv:left"]["assessed"] > 0
    assert values["without b.csv:left"]["rmse.N1_pct"] < 1.0
