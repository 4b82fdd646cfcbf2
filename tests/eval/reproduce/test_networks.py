"""Studies that fit networks: what they learn from, and their figures against slow ones."""

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from data_prep.events import find_events
from eval.judging.crossval import CrossValidation, FoldResult
from eval.reproduce.data import Effort, within
from eval.reproduce.inputs import deviations, fed_record, fed_variants, inputs, variants
from eval.reproduce.narx_paper import family_of, goal, goal_config, goal_training
from eval.reproduce.noise import noise, share_better
from eval.reproduce.response import (
    accuracy,
    assessments_of,
    by,
    class_rows,
    classed,
    divided,
    figures_of,
    judged,
    passed_claim,
    response_times,
    splits,
    worst_class,
    worst_of,
    worst_relative_pct,
)
from eval.run_logs import EvaluateConfig
from narxcal.calibration.dynamic import narx_features
from training.pipeline import calibrate


@pytest.fixture(scope="module")
def bundle(data):
    return calibrate(data.config, Path(), data.training)


@pytest.fixture(scope="module")
def four(data, effort):
    return variants(data, effort, "N1_pct")


@pytest.fixture(scope="module")
def found(data, bundle):
    return judged(bundle, data.tests)


def test_effort_replaces_the_iterations_of_every_horizon(data):
    assert within(data.config, Effort()) is data.config
    assert within(data.config, Effort((3,))).train.iterations == (3, 3)
    assert within(data.config, Effort((5, 4, 3))).train.iterations == (5, 4)


@pytest.mark.slow
def test_the_four_variants_are_scored_as_a_loop_would(data, four):
    assert [one.name for one in four] == [
        "single data, single input", "single data, multiple input",
        "multiple data, single input", "multiple data, multiple input",
    ]  # fmt: skip
    assert [len(one.trained_on) for one in four] == [1, 1, 3, 3]
    assert [len(one.fed) for one in four] == [1, 4, 1, 4]
    for one in four:
        total = 0.0
        for log, run in zip(data.split.test, one.runs, strict=True):
            assert run[0] == pytest.approx(log["N1_pct"][0])
            total += sum((a - b) ** 2 for a, b in zip(run, log["N1_pct"], strict=True))
        count = sum(map(len, data.split.test))
        assert one.pooled == pytest.approx(total / count)


@pytest.mark.slow
def test_the_study_of_inputs_says_which_variant_is_best(data, effort, four, monkeypatch):
    monkeypatch.setattr("eval.reproduce.inputs.variants", lambda *_: four)
    study = inputs(data, effort)
    rows = study.results["variants"]
    best = min(row["pooled_mse"] for row in rows)
    criterion, order = study.claims
    assert criterion.value == rows[-1]["pooled_mse"]
    assert order.value == pytest.approx(rows[-1]["pooled_mse"] / best)
    assert order.met is (order.value < 1.0 + 1e-9)
    assert len(study.pictures) == 1


@pytest.mark.slow
def test_measured_deviations_are_those_of_the_sample_before(data, bundle):
    log, steady = data.split.train[0], bundle.calibration.steady
    ss = steady.outputs(log.matrix(steady.input_names))
    made = fed_record(log, steady, data.config, ("N2_pct", "EGT_C"))
    deviation = ss - log.matrix(("N1_pct", "N2_pct", "EGT_C"))
    assert made.u[1:, :2] == pytest.approx(deviation[:-1, 1:])
    assert made.u[0, :2] == pytest.approx(deviation[0, 1:])
    assert made.y[:, 0] == pytest.approx(deviation[:, 0])
    schedule = log.matrix(data.config.narx.schedule)
    assert made.u[:, 2:] == pytest.approx(narx_features(ss, schedule))


@pytest.mark.slow
def test_the_last_variant_is_the_calibration_itself(data, bundle, effort, found):
    *fed, own = fed_variants(data, bundle, effort)
    assert [one.fed for one in fed] == [(), ("EGT_C",), ("N2_pct", "EGT_C")]
    measured = data.split.test[0]["N1_pct"]
    worst = max(abs(m - t) / abs(t) for m, t in zip(own.runs[0], measured, strict=True))
    assert own.max_rel_pct == pytest.approx(100.0 * worst)
    assert own.max_rel_pct == pytest.approx(found[0].scores["N1_pct"].max_rel_pct)
    study = deviations(data, bundle, effort)
    assert study.claims[-1].value == pytest.approx(own.max_rel_pct)
    assert [row["rmse"] for row in study.results["variants"]] == [
        pytest.approx(one.pooled**0.5) for one in (*fed, own)
    ]


@pytest.mark.slow
def test_events_are_classed_with_their_own_assessments(data, found):
    events = classed("TRA_deg", found)
    on_ground = data.config.events.model_copy(update={"condition": ""})
    assert len(events) == sum(len(find_events(log, on_ground)) for log in data.tests)
    for one in events:
        assert {each.channel for each in one.event.assessments} == {"N1_pct", "N2_pct"}
        assert all(each.start_s == one.event.event.start_s for each in one.event.assessments)
    groups = by(events, lambda one: one.direction, ("push", "pull", "none"))
    assert list(groups) == ["push", "pull"]
    assert sum(map(len, groups.values())) == len(events)


@pytest.mark.slow
def test_worst_errors_of_a_class_are_those_of_its_samples(found):
    events = classed("TRA_deg", found)[:3]
    for channel, value in worst_relative_pct(events).items():
        worst = 0.0
        for one in events:
            run, column = one.log.run, one.log.run.channels.index(channel)
            for row in range(one.event.event.start, one.event.event.stop):
                truth = run.measured[row, column]
                worst = max(worst, abs(run.model[row, column] - truth) / truth)
        assert value == pytest.approx(100.0 * worst)


@pytest.mark.slow
def test_accuracy_names_the_worst_class(data, bundle, found):
    events = classed("TRA_deg", found)
    study = accuracy(data, bundle, found, events)
    rows = class_rows(events)
    for claim, (name, value) in zip(
        study.claims, study.results["max_rel_pct"].items(), strict=True
    ):
        assert claim.value == value
        assert value == found[0].scores[name].max_rel_pct
        if not claim.met:
            assert claim.remark == worst_class(rows, name)
    assert worst_class([], "N1_pct") == ""


@pytest.mark.slow
def test_times_are_averaged_over_what_was_assessed(data, bundle, found):
    events = classed("TRA_deg", found)
    every = assessments_of(events)
    figures = figures_of(every)
    judged_ones = [one.verdict for one in every if one.verdict.ok is not None]
    shares = [100.0 * (v.Ti.relative if v.Ti else 1.0) for v in judged_ones]
    assert figures["mean_Ti_pct"] == pytest.approx(np.mean(shares))
    assert figures["max_Ti_pct"] == pytest.approx(
        max(100.0 * v.Ti.relative for v in judged_ones if v.Ti)
    )
    assert (figures["assessed"], figures["passed"]) == (
        len(judged_ones), sum(v.ok for v in judged_ones),
    )  # fmt: skip
    study = response_times(data, bundle, found, events)
    assert study.results["all"] == figures
    sets = [row for row in study.results["groups"] if row["group"].startswith("data set")]
    assert sum(row["events"] for row in sets) == figures["events"]


def test_nothing_assessed_is_nothing_claimed():
    every = figures_of([])
    assert every["mean_Ti_pct"] is None
    assert every["max_Tt_pct"] is None
    assert passed_claim(every).met is None


@pytest.mark.slow
def test_the_goal_is_judged_on_every_family(data, bundle):
    study = goal(data, bundle)
    rows = study.results["families"]
    assert [row["group"] for row in rows] == ["the paper's data sets", "take-off and approach"]
    assert study.results["all"]["events"] == sum(row["events"] for row in rows)
    for name, value in study.results["max_rel_pct"].items():
        assert value >= max(row["max_rel_pct"][name] for row in rows) * 0.5
    assert {claim.origin for claim in study.claims} == {"our goal"}
    assert "1 of take-off and approach" in study.text
    assert family_of("throttle_rate/data_set_01.csv") == "throttle rate varied"


def test_the_goal_learns_circuits_whole_and_the_rest_in_segments_at_half_the_raster(data):
    split, raster = goal_training(data), data.logs[0].dt_s
    assert all(log.dt_s == pytest.approx(2 * raster) for log in split.train)
    whole = [log for log in split.train if "[" not in log.name]
    assert [log.name for log in whole] == ["take_off_approach/data_set_01.csv"]
    assert len(whole[0]) == len(data.further[0]) // 2
    assert {log.name.partition("[")[0] for log in split.train} == {
        log.name for log in data.whole_split.train
    }


@pytest.mark.parametrize("lag", [False, True])
def test_the_goal_knows_what_the_control_holds_where_there_are_two_speeds(data, lag):
    narx = data.config.narx.model_copy(update={"lag": lag, "outputs": ("N1_pct", "N2_pct")})
    config = data.config.model_copy(update={"narx": narx})
    found = goal_config(config).narx
    assert (found.lag_governed is True) is lag
    one = narx.model_copy(update={"outputs": ("N2_pct", "EGT_C")})
    found = goal_config(config.model_copy(update={"narx": one})).narx
    assert (found.lag_limits is True, found.lag_governed is True) == (lag, False)


def fold(number, **values):
    return FoldResult("random splits by event", f"split {number}", number, (), (), values)


def test_the_worst_of_all_divisions_is_told():
    folds = (
        fold(0, **{"max_rel_pct.N1_pct": 1.0, "rmse.N1_pct": 0.2, "mean_relative_Ti_pct": 2.0,
                   "mean_relative_Tt_pct": None, "passed": 3, "assessed": 4}),
        fold(1, **{"max_rel_pct.N1_pct": 3.0, "rmse.N1_pct": 0.1, "mean_relative_Ti_pct": 4.0,
                   "mean_relative_Tt_pct": None, "passed": 5, "assessed": 5}),
    )  # fmt: skip
    assert worst_of(CrossValidation(folds, EvaluateConfig())) == {
        "max_rel_pct.N1_pct": 3.0, "rmse.N1_pct": 0.2, "mean_relative_Ti_pct": 3.0,
        "mean_relative_Tt_pct": None, "passed": 8, "assessed": 9,
    }  # fmt: skip


@pytest.mark.slow
def test_divisions_hold_back_three_tenths_of_the_events(data, effort, monkeypatch):
    seen = []
    found = divided(data, effort, lambda *done: seen.append(done))
    assert [tuple(counts) for *counts, _ in seen] == [(1, 1)]
    monkeypatch.setattr("eval.reproduce.response.divided", lambda *_: found)
    study = splits(data, effort)
    for one in found.folds:
        count = len(one.train) + len(one.test)
        assert len(one.train) == round(0.7 * count)
        assert not set(one.train) & set(one.test)
    assert study.title == "1 random 7:3 divisions"
    assert study.results["worst"] == worst_of(found)
    json.dumps(study.results)


@pytest.mark.slow
def test_noise_is_swept_over_the_papers_data_sets(data, bundle, effort):
    seen = []
    study = noise(data, bundle, effort, lambda *done: seen.append(done[:2]))
    assert seen == [(0, 3), (1, 3), (2, 3)]
    assert list(study.results["data_sets"]) == ["No. 2", "No. 3", "No. 4"]
    for rows in study.results["data_sets"].values():
        assert [row["snr_db"] for row in rows] == [25.0, 30.0, 35.0, 40.0, 44.0]
        for row in rows:
            assert row["raw"] == pytest.approx(row["noise_sd"], rel=0.1)
    assert max(row["snr_db"] for row in study.results["data_sets"]["No. 2"]) < 45.0


def test_shares_count_ratios_and_data_sets_alike():
    one = pd.DataFrame({"fused": [1.0, 3.0], "raw": [2.0, 2.0]})
    two = pd.DataFrame({"fused": [1.0, 1.0], "raw": [2.0, 1.0]})
    assert share_better({"a": one, "b": two}, "fused", "raw") == 50.0
