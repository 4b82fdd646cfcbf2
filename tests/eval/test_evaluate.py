"""Evaluation of logs whose answers are known: an engine that is an exact first-order lag."""

import json
import math
import re
from dataclasses import replace

import numpy as np
import pytest

from eval.judging.evaluate import evaluate
from eval.run_logs import EvaluateConfig, run_config
from narxcal.calibration.bundle import Bundle
from narxcal.support.errors import ConfigError, DataError, ModelError
from tests.eval.conftest import lag_bundle, lag_log


@pytest.fixture(scope="module")
def document():
    """Of the true model and one log."""
    return evaluate(lag_bundle(), [lag_log()]).document()


def test_the_true_model_has_no_error_and_passes_every_event(document):
    (log,) = document["logs"]
    for figures in log["channels"].values():
        assert figures["rmse"] < 1e-9
        assert figures["max_rel_pct"] < 1e-9
        assert figures["one_step_rmse"] < 1e-9
        assert figures["static_rmse"] < 1e-9
        assert figures["first_order_rmse"] < 0.01
        assert figures["steady_state_rmse"] > 3.0
    assert log["ti_tt"]["assessed"] == log["ti_tt"]["passed"] >= 10
    assert document["ok"] is True
    assert document["missed"] == []


def test_the_document_has_the_agreed_layout_and_is_json(document):
    assert json.loads(json.dumps(document, allow_nan=False)) == document
    assert document["schema"] == "narxcal.evaluate/1"
    (log,) = document["logs"]
    assert {"log", "channels", "events", "ti_tt", "masked"} <= set(log)
    assert log["log"] == "flight.csv:left"
    agreed = {
        "rmse", "nrmse", "max_rel_pct", "one_step_rmse", "steady_state_rmse", "first_order_rmse",
    }  # fmt: skip
    figures = log["channels"]["N1_pct"]
    assert agreed <= set(figures)
    assert figures["fit_pct"] == pytest.approx(100.0 * (1.0 - figures["nrmse"]))
    event = log["events"][0]
    assert event["label"] in ("push", "pull")
    assert {"flight", "model", "ok"} <= set(event["Ti"])
    assert {"flight", "model", "ok"} <= set(event["Tt"])
    assert {"assessed", "passed"} <= set(log["ti_tt"])


def test_a_constant_offset_is_static_bias_and_not_timing(make_bundle, make_log):
    log = make_log(offset=(-2.0, 1.0))
    (found,) = evaluate(make_bundle(), [log]).document()["logs"]
    n1, n2 = found["channels"]["N1_pct"], found["channels"]["N2_pct"]
    assert n1["static_bias"] == pytest.approx(2.0, rel=0.02)
    assert n2["static_bias"] == pytest.approx(-1.0, rel=0.02)
    assert n1["static_rmse"] == pytest.approx(2.0, rel=0.02)
    assert found["ti_tt"]["passed"] == found["ti_tt"]["assessed"]


def test_a_slow_model_is_a_dynamic_error_and_fails_its_events(make_bundle, make_log):
    evaluation = evaluate(make_bundle(tau_s=(4.0, 0.8)), [make_log()])
    (found,) = evaluation.document()["logs"]
    n1 = found["channels"]["N1_pct"]
    assert n1["dynamic_rmse"] > 3.0 * n1["static_rmse"]
    assert n1["rmse"] > 10.0 * n1["first_order_rmse"]
    assert found["ti_tt"]["channels"]["N1_pct"]["passed"] == 0
    assert found["ti_tt"]["channels"]["N2_pct"]["passed"] > 0
    assert (
        found["baselines"]["first_order"]["passed"] == found["baselines"]["first_order"]["assessed"]
    )
    missed = evaluation.missed[0]
    assert re.fullmatch(
        r"Ti/Tt: \d+ of \d+ transients pass \(50\.0 %\), at least 95 % have to", missed
    )


def test_parts_add_up_to_the_whole(make_bundle, make_log):
    (found,) = evaluate(make_bundle(tau_s=(3.0, 2.0)), [make_log(offset=(0.5, -0.5))]).logs
    for figures in found.scores.values():
        moving = figures.samples - figures.static_samples
        parts = figures.static_samples * figures.static_rmse**2 + moving * figures.dynamic_rmse**2
        assert math.sqrt(parts / figures.samples) == pytest.approx(figures.rmse)


def test_pooled_figures_weigh_samples_and_not_logs(make_bundle, make_log):
    logs = [
        make_log("a.csv:left", 120.0, offset=(3.0, 0.0)),
        make_log("b.csv:left", 360.0, offset=(1.0, 0.0)),
    ]
    pooled = evaluate(make_bundle(), logs).pooled["N1_pct"]
    # Each run starts at its first measured value, so the offset grows within some tau.
    assert pooled.rmse == pytest.approx(math.sqrt((9.0 + 3 * 1.0) / 4), rel=0.01)
    assert pooled.samples == 4800


def test_masked_outputs_are_left_out_of_their_channel_only(make_bundle, make_log, mask):
    log = mask(make_log(offset=(50.0, 0.0)), "N1_pct", slice(100, None))
    (found,) = evaluate(make_bundle(), [log]).document()["logs"]
    assert found["channels"]["N1_pct"]["samples"] == 100
    assert found["channels"]["N2_pct"]["samples"] == 2400
    reasons = found["ti_tt"]["channels"]["N1_pct"]
    assert reasons["assessed"] < reasons["events"]


def test_a_channel_without_any_sample_gives_null_and_no_pass(make_bundle, make_log, mask):
    log = mask(mask(make_log(), "N1_pct", slice(None)), "N2_pct", slice(None))
    document = evaluate(make_bundle(), [log]).document()
    (found,) = document["logs"]
    assert found["channels"]["N1_pct"]["rmse"] is None
    assert found["channels"]["N1_pct"]["samples"] == 0
    assert found["ti_tt"]["assessed"] == 0
    assert json.dumps(document, allow_nan=False)


def test_held_inputs_are_counted_and_their_rows_not_scored(make_bundle, make_log, mask):
    log = mask(make_log(), "Mach", slice(150, 450))
    (found,) = evaluate(make_bundle(), [log]).document()["logs"]
    assert found["inputs"]["held_samples"] == 300
    assert found["channels"]["N1_pct"]["samples"] == 2100
    assert any("inputs are missing" in one for one in found["ti_tt"]["not_assessable_reasons"])


def test_the_share_outside_the_envelope_is_shown(make_bundle, make_log):
    log = make_log()
    fast = np.where(log.time_s < 60.0, 0.9, 0.3)
    (found,) = evaluate(make_bundle(), [log.with_channels({"Mach": fast})]).document()["logs"]
    assert found["inputs"]["outside_envelope_share"] == pytest.approx(0.25)


def test_samples_say_what_a_log_is_not_its_name_or_its_bytes(make_bundle, make_log):
    used, other = make_log("train.csv:left"), make_log("train.csv:left", offset=(1.0, 0.5))
    same = replace(used, name="b.csv:left", source=replace(used.source, file="b", sha256="other"))
    other = replace(other, source=replace(other.source, sha256="other"))
    found = evaluate(make_bundle(train=[used]), [used, same, other])
    assert [log.role for log in found.logs] == ["train", "train", "new"]


def test_a_training_log_earns_no_pass(make_bundle, make_log):
    used = make_log("train.csv:left")
    copy = replace(used, name="new.csv:left", source=replace(used.source, file="n", sha256="n"))
    found = evaluate(make_bundle(train=[used]), [copy])
    assert found.outcome.passed is None
    text = "new.csv:left: the model was trained on it under the name train.csv:left"
    assert found.lacking == [f"{text}; that earns no pass"]
    (row,) = found.document()["logs"]
    assert row["holds"] == {"log": "train.csv:left", "share": 1.0, "from_s": 0.0, "to_s": 239.9}


def test_a_bound_on_the_error_is_missed_by_name(make_bundle, make_log):
    bundle = make_bundle(evaluate={"largest_rmse": {"N1_pct": 1.0, "N2_pct": 1.0}})
    evaluation = evaluate(bundle, [make_log(offset=(2.0, 0.0))])
    assert evaluation.missed == ["N1_pct: RMSE 1.99, at most 1 allowed"]
    assert evaluation.document()["ok"] is False


def test_a_bound_on_a_channel_that_is_not_there_is_refused(make_bundle, make_log):
    bundle = make_bundle(evaluate={"largest_rmse": {"EGT_C": 10.0}})
    expected = (
        "channel EGT_C: [evaluate.largest_rmse] bounds a channel that the model does not give. "
        "It gives N1_pct, N2_pct"
    )
    with pytest.raises(ConfigError, match=f"^{re.escape(expected)}$"):
        evaluate(bundle, [make_log()]).document()


def test_trim_takes_an_offset_away_and_scores_the_rest_only(make_bundle, make_log):
    log = make_log(offset=(0.8, -0.4), duration_s=900.0)
    settings = EvaluateConfig.parse({"trim": {"correlation_s": 5.0}})
    evaluation = evaluate(make_bundle(), [log], trim=0.2, settings=settings)
    (found,) = evaluation.document()["logs"]
    for figures, offset in zip(found["channels"].values(), (0.8, 0.4), strict=True):
        assert figures["samples"] == 7200
        assert figures["untrimmed_rmse"] == pytest.approx(offset, rel=0.01)
        assert figures["rmse"] < 0.35 * offset
        assert figures["steady_state_rmse"] > 1.0
    assert found["trim"]["scored_from_s"] == pytest.approx(180.0)
    assert min(event["start_s"] for event in found["events"]) >= 179.9


def test_trim_looks_at_nothing_after_its_part(make_bundle, make_log):
    log = make_log(duration_s=600.0, offset=(0.5, 0.5))
    later = log["N1_pct"] + np.where(log.time_s < 120.0, 0.0, 30.0)
    first, second = (
        evaluate(make_bundle(), [one], trim=0.2).document()["logs"][0]["trim"]
        for one in (log, log.with_channels({"N1_pct": later}))
    )
    assert first == second


@pytest.mark.parametrize("fraction", [0.0, 1.0, -0.2, 20.0])
def test_a_trim_that_leaves_nothing_is_refused(make_bundle, make_log, fraction):
    expected = (
        f"the trim fraction has to lie between 0 and 1, found {fraction:g}. "
        "0.2 takes the first 20 % of each log and scores the rest"
    )
    with pytest.raises(ConfigError, match=f"^{re.escape(expected)}$"):
        evaluate(make_bundle(), [make_log()], trim=fraction)


def test_a_log_at_another_interval_is_refused(make_bundle, make_log):
    log = make_log()
    log = replace(log, time_s=log.time_s * 2.0)
    expected = (
        "flight.csv:left: the model samples every 0.1 s, this log every 0.2 s. "
        "Resample the log to the model's interval: raster_hz in [logs]"
    )
    with pytest.raises(DataError, match=f"^{re.escape(expected)}$"):
        evaluate(make_bundle(), [log])


def test_a_bundle_whose_configuration_is_missing_or_wrong_is_refused(make_bundle):
    expected = "the bundle does not say how its logs were prepared. Train it with narxcal train"
    with pytest.raises(ModelError, match=f"^{re.escape(expected)}$"):
        run_config(Bundle(make_bundle().calibration))
    expected = (
        "bundle.json, [evaluate]: unknown key 'least_pased_pct'. Did you mean 'least_passed_pct'?"
    )
    with pytest.raises(ConfigError, match=f"^{re.escape(expected)}$"):
        run_config(make_bundle(evaluate={"least_pased_pct": 90.0}))


def test_without_baselines_the_rest_is_still_there(make_bundle, make_log):
    bundle = make_bundle()
    bare = Bundle(bundle.calibration, bundle.record.having(baselines=None))
    (found,) = evaluate(bare, [make_log()]).document()["logs"]
    assert found["channels"]["N1_pct"]["first_order_rmse"] is None
    assert found["channels"]["N1_pct"]["steady_state_rmse"] > 3.0


def test_events_that_differ_only_in_the_response_are_counted_together(make_bundle, make_log):
    log = make_log()
    weak = log.with_channels({"N1_pct": 50.0 + 0.01 * log["N1_pct"]})
    (found,) = evaluate(make_bundle(), [weak]).document()["logs"]
    reasons = found["ti_tt"]["not_assessable_reasons"]
    assert reasons["response .. % is below 5 %"] == found["ti_tt"]["channels"]["N1_pct"]["events"]


def test_nothing_to_score_is_refused(make_bundle):
    with pytest.raises(DataError, match=r"^expected at least one log to score, found none$"):
        evaluate(make_bundle(), []).document()


def without(log, *names):
    return replace(log, channels={k: v for k, v in log.channels.items() if k not in names})


def test_a_log_that_lacks_an_output_is_judged_by_the_others(make_bundle, make_log):
    bundle, whole = make_bundle(tau_s=(1.5, 0.9)), make_log()
    lacking, usual = (evaluate(bundle, [log]) for log in (without(whole, "N1_pct"), whole))
    (found,), (known,) = lacking.document()["logs"], usual.document()["logs"]
    figures = found["channels"]["N1_pct"]
    assert figures.pop("samples") == figures.pop("static_samples") == 0
    assert set(figures.values()) == {None}
    assert found["masked"]["N1_pct"] == {"samples": 2400, "reasons": {"not recorded": 2400}}
    for name in ("rmse", "one_step_rmse", "first_order_rmse", "arx_rmse"):
        assert found["channels"]["N2_pct"][name] == known["channels"]["N2_pct"][name]
    assert found["ti_tt"]["channels"]["N2_pct"]["assessed"] >= 5
    assert found["ti_tt"]["channels"]["N1_pct"]["assessed"] == 0
    # Without a measured start the engine begins settled, as this log does.
    free = [one.logs[0].run.model for one in (lacking, usual)]
    assert free[0] == pytest.approx(free[1])


def test_an_output_that_a_log_lacks_is_not_trimmed(make_bundle, make_log):
    lacking = without(make_log(offset=(1.0, 1.0)), "N1_pct")
    (found,) = evaluate(make_bundle(), [lacking], trim=0.2).document()["logs"]
    assert found["trim"]["samples"]["N1_pct"] == 0
    assert not np.any(found["trim"]["offsets"]["N1_pct"])
    n2 = found["channels"]["N2_pct"]
    assert n2["rmse"] < n2["untrimmed_rmse"]


def test_a_log_without_any_output_is_refused(make_bundle, make_log):
    with pytest.raises(DataError) as caught:
        evaluate(make_bundle(), [without(make_log(), "N1_pct", "N2_pct")])
    assert caught.value.problem == "the log has none of the outputs N1_pct, N2_pct"


def test_a_bound_on_an_output_that_nobody_recorded_is_not_met(make_bundle, make_log):
    bundle = make_bundle(evaluate={"largest_rmse": {"N1_pct": 1.0}})
    evaluation = evaluate(bundle, [without(make_log(), "N1_pct")])
    none = "N1_pct is not assessable, 0 % of it is judged (not recorded), at least 90 % have to be"
    least = "a verdict takes 3 of each that can be assessed"
    assert evaluation.missed == [
        "N1_pct: no sample to judge by, at most RMSE 1 allowed",
        f"flight.csv:left: {none}",
        f"Ti/Tt of engine left: no pushes in N1, no pulls in N1; {least}",
    ]
    both = evaluate(bundle, [make_log(), without(make_log(), "N1_pct")])
    assert both.missed == [f"flight.csv:left: {none}"]


def test_what_lies_between_two_measurements_is_not_scored(make_bundle, make_log):
    whole = make_log()
    seldom = np.arange(len(whole)) % 10 > 0
    line = np.interp(whole.time_s, whole.time_s[~seldom], whole["N1_pct"][~seldom])
    slow = replace(whole.with_channels({"N1_pct": line}), interpolated={"N1_pct": seldom})
    (found,) = evaluate(make_bundle(), [slow]).document()["logs"]
    assert found["channels"]["N1_pct"]["samples"] == 240
    assert found["channels"]["N1_pct"]["rmse"] < 1e-9
    assert found["channels"]["N2_pct"]["samples"] == 2400
    assert slow.part(5, 25).measured(["N1_pct"])[:, 0] == pytest.approx(
        np.where(seldom[5:25], np.nan, line[5:25]), nan_ok=True
    )


def with_levels(bundle, levels, lags=(0.0, 0.0, 0.0, 0.0), rmse=(0.0, 0.0)):
    """A bundle whose training held logs out, with these levels and lags in every output.

    `rmse` are the errors that are usual on another log.
    """
    own = {"weights": {"network": 1.0}, "held_out_level": levels, "held_out_lag_s": list(lags)}
    names = bundle.calibration.output_names
    usual = {name: [each] for name, each in zip(names, rmse, strict=True)}
    held = {"logs": ["a"], "fitted": False, "rmse": usual}
    mixture = {"channels": dict.fromkeys(names, own)}
    return replace(bundle, record=bundle.record.having(mixture=mixture, held_out=held))


def test_a_level_beyond_that_of_held_out_logs_fails_beside_right_times(make_bundle, make_log):
    levels = [0.3, -0.2, 0.4, -0.1]
    sound = evaluate(with_levels(make_bundle(), levels), [make_log()])
    assert sound.missed == []
    bundle = with_levels(make_bundle(), levels, rmse=(8.0, 0.1))
    wrong = evaluate(bundle, [make_log(offset=(-8.0, 0.1))])
    (missed,) = wrong.missed
    assert re.fullmatch(
        r"flight.csv:left: level error of N1_pct \+8 %, [\d.]+ is the spread of 4 held-out "
        "training logs",
        missed,
    )
    document = wrong.document()
    assert document["ok"] is False
    (n1, n2) = document["logs"][0]["levels"]
    assert (n1["ok"], n2["ok"], n1["held_out_logs"]) == (False, True, 4)
    assert n1["error"] == pytest.approx(8.0, abs=1e-6)
    assert document["logs"][0]["ti_tt"]["passed"] == document["logs"][0]["ti_tt"]["assessed"]


@pytest.mark.parametrize("levels", [[], [0.1, -0.2]])
def test_with_few_held_out_logs_a_level_is_a_caution_with_its_size(make_bundle, make_log, levels):
    bundle = with_levels(make_bundle(), levels, rmse=(8.0, 0.1))
    found = evaluate(bundle, [make_log(offset=(-8.0, 0.1))])
    assert found.missed == []
    (caution,) = found.level_cautions
    assert caution == (
        "flight.csv:left: level error of N1_pct +8 %, N2_pct -0.1 % is not judged: fewer than 3 "
        "training logs were held out"
    )


def test_levels_of_several_logs_that_cannot_be_judged_are_one_caution(make_bundle, make_log):
    logs = [make_log(offset=(size, 0.1)) for size in (0.5, -8.0, 3.0)]
    (caution,) = evaluate(with_levels(make_bundle(), []), logs).level_cautions
    assert caution.startswith(
        "flight.csv:left and 2 more: level error of up to N1_pct +8 %, N2_pct"
    )


def test_a_lag_beyond_that_of_held_out_logs_is_a_caution(make_bundle, make_log):
    bundle = with_levels(make_bundle(tau_s=(5.0, 0.8)), [0.1] * 4)
    found = evaluate(bundle, [make_log()]).level_cautions
    assert len(found) == 1
    assert re.fullmatch(
        r"flight.csv:left: N1_pct is [\d.]+ s late over the whole log, [\d.]+ s is the spread of "
        "held-out training logs",
        found[0],
    )
