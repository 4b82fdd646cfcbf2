"""Verdicts: what passes, what fails, what is not assessable, and how many of each."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from data_prep.events import Event
from data_prep.log import Log
from narxcal.support.errors import ConfigError, DataError
from narxcal.support.files import finite
from training.config import RunConfig
from training.responses.response import Transient
from training.responses.rules import RULES, compare_transients, rules, time_bands
from training.responses.transients import (
    AssessedEvent,
    Overlay,
    Tally,
    TransientsConfig,
    assess_events,
    assessed,
    not_assessable,
    responses,
    tally,
)


def transient(initial_s=0.5, total_s=2.0, response=20.0, dt_s=0.03125):
    t0_s = 10.0
    return Transient(
        t0_s=t0_s,
        dt_s=dt_s,
        t10_s=t0_s + initial_s,
        t90_s=t0_s + initial_s + total_s,
        Ti_s=initial_s,
        Tt_s=total_s,
        before=60.0,
        after=60.0 + response,
        response=response,
    )


times = st.floats(0.05, 20.0)


@given(initial_s=times, total_s=times, name=st.sampled_from(sorted(RULES)))
def test_identical_transients_pass_under_all_rules(initial_s, total_s, name):
    same = transient(initial_s, total_s)
    verdict = compare_transients(same, same, rules(name))
    assert verdict.ok is True
    assert verdict.Ti.error_s == verdict.Tt.error_s == 0.0


@given(initial_s=times, total_s=times, delay_s=st.floats(0.0, 5.0))
def test_a_delayed_copy_fails_paper_and_part60_only_beyond_the_Ti_tolerance(  # noqa: N802
    initial_s, total_s, delay_s
):
    allowed_s = max(0.1 * initial_s, 0.25)
    if abs(delay_s - allowed_s) < 1e-6:
        return
    late = transient(initial_s + delay_s, total_s)
    for name in ("paper", "part60"):
        verdict = compare_transients(transient(initial_s, total_s), late, rules(name))
        assert verdict.ok is (delay_s < allowed_s)
        assert verdict.Tt.ok


def test_an_error_of_exactly_the_tolerance_passes():
    verdict = compare_transients(transient(0.5), transient(0.75), rules("paper"))
    assert verdict.Ti.ok
    assert verdict.Ti.allowed_s == 0.25
    late = compare_transients(transient(0.1 + 0.2), transient(0.3 + 0.25), rules("paper"))
    assert late.Ti.ok


def test_the_less_restrictive_of_share_and_floor_applies():
    verdict = compare_transients(transient(4.0, 4.0), transient(4.4, 4.4), rules("paper"))
    assert (verdict.Ti.allowed_s, verdict.Tt.allowed_s) == (0.4, 0.4)
    assert verdict.ok


def test_part60_gives_Tt_no_floor():  # noqa: N802
    flight, model = transient(0.5, 1.0), transient(0.5, 1.2)
    assert compare_transients(flight, model, rules("paper")).ok
    verdict = compare_transients(flight, model, rules("part60"))
    assert verdict.ok is False
    assert verdict.Ti.ok
    assert not verdict.Tt.ok
    assert verdict.Tt.allowed_s == pytest.approx(0.1)


def test_icao9625_measures_Tt_from_the_lever():  # noqa: N802
    flight, model = transient(0.6, 2.0), transient(0.8, 1.9)
    verdict = compare_transients(flight, model, rules("icao9625"))
    assert verdict.Tt.flight_s == pytest.approx(2.6)
    assert verdict.Tt.model_s == pytest.approx(2.7)
    assert verdict.Tt.allowed_s == pytest.approx(0.26)


def test_where_the_floor_of_Tt_is_unresolved_the_stricter_reading_decides():  # noqa: N802
    flight, model = transient(0.5, 1.0), transient(0.5, 1.2)
    verdict = compare_transients(flight, model, rules("cs-fstd"))
    assert (verdict.ok, verdict.otherwise) == (False, True)
    assert compare_transients(flight, flight, rules("cs-fstd")).otherwise is None
    assert compare_transients(flight, model, rules("part60")).otherwise is None


def test_data_of_an_engineering_simulator_narrow_the_tolerances():
    flight, model = transient(0.5, 4.0), transient(0.61, 4.0)
    config = TransientsConfig(rules="part60", data_source="engineering")
    verdict = compare_transients(flight, model, config.rule_set)
    assert verdict.Ti.allowed_s == pytest.approx(0.1)
    assert verdict.Tt.allowed_s == pytest.approx(0.16)
    assert (verdict.ok, compare_transients(flight, model, rules("part60")).ok) == (False, True)
    assert (str(config.rule_set.Ti), str(config.rule_set.Tt)) == ("±4 % or 0.1 s", "±4 %")


@pytest.mark.parametrize("name", sorted(RULES))
def test_what_was_not_read_in_an_edition_says_so(name):
    marks = [clause.mark for clause in rules(name).clauses]
    assert all(
        mark.startswith("read in") or mark == "unverified; check your edition" for mark in marks
    )
    assert "unverified; check your edition" in marks


def test_relative_error_is_of_the_flight_time_but_of_no_less_than_one_sample():
    verdict = compare_transients(transient(0.5, 2.0), transient(0.6, 1.8), rules("paper"))
    assert verdict.Ti.relative == pytest.approx(0.2)
    assert verdict.Tt.relative == pytest.approx(0.1)
    early = compare_transients(transient(0.0, dt_s=0.1), transient(0.05), rules("paper"))
    assert early.Ti.relative == pytest.approx(0.5)


def test_unknown_rules_are_refused():
    with pytest.raises(
        ConfigError,
        match=r"^unknown rule set 'faa'. Known rule sets: "
        r"paper, part60, part60-2016, cs-fstd, icao9625$",
    ):
        rules("faa")


def test_a_model_that_hardly_moves_fails_even_if_it_is_in_time():
    verdict = compare_transients(transient(), transient(response=1.2), rules("paper"))
    assert verdict.ok is False
    assert verdict.reason == "model: its response 1.2 is 6 % of the flight's, less than 50 %"


def test_a_model_that_moves_the_other_way_fails():
    verdict = compare_transients(transient(), transient(response=-20.0), rules("paper"))
    assert verdict.ok is False
    assert verdict.reason == "model: it moves by -20 where the flight moves by 20"


def bands(flight, model, name="paper"):
    return time_bands(flight, model, compare_transients(flight, model, rules(name)))


def test_bands_surround_the_crossings_of_the_flight():
    flight, failed = transient(0.5, 4.0), transient(response=1.0)
    low, high = bands(flight, failed)
    assert low == (10.25, 10.75)
    assert high == (pytest.approx(14.1), pytest.approx(14.9))
    assert bands(flight, failed, "icao9625")[1][1] == pytest.approx(14.95)


@given(times, times, st.floats(-1.0, 1.0), st.floats(-1.0, 1.0), st.sampled_from(sorted(RULES)))
def test_a_model_passes_where_its_crossings_are_inside_their_bands(
    initial_s, total_s, early_s, slow_s, name
):
    flight = transient(initial_s, total_s)
    model = transient(initial_s + early_s, total_s + slow_s)
    verdict = compare_transients(flight, model, rules(name))
    for (start_s, stop_s), reached_s, check in zip(
        time_bands(flight, model, verdict),
        (model.t10_s, model.t90_s),
        (verdict.Ti, verdict.Tt),
        strict=True,
    ):
        if min(abs(reached_s - start_s), abs(reached_s - stop_s)) > 1e-6:
            assert check.ok is (start_s < reached_s < stop_s)


def test_a_transient_that_is_not_assessable_has_no_bands():
    assert bands(replace(transient(), reason="too small"), transient()) == []


# Whole logs: pushes and pulls of 20 % every 20 s at 10 Hz, the spool a lag of 1 s.
DT_S = 0.1
STARTS = (50, 250, 450, 650)


def log(tau_s=1.0, delay=0, size=20.0):
    """Lag of `tau_s` and `delay` samples on a lever that goes up and down at STARTS."""
    index = np.arange(900)
    level = np.full(len(index), 60.0)
    for number, start in enumerate(STARTS):
        level[start + 1 + delay :] = 60.0 + size * (number % 2 == 0)
    y = level.copy()
    decay = np.exp(-DT_S / tau_s)
    for k in range(1, len(y)):
        y[k] = level[k] + (y[k - 1] - level[k]) * decay
    return y


def events():
    return [
        Event(
            log="F:left",
            start=start,
            stop=start + 150,
            label=number % 2,
            speed="fast",
            start_s=start * DT_S,
            lever_before=0.0,
            lever_after=0.0,
            settled=True,
            interrupted=False,
        )
        for number, start in enumerate(STARTS)
    ]


def overlay(flight, model, **kwargs):
    return Overlay(
        np.arange(len(flight)) * DT_S, flight[:, None], model[:, None], ("N1_pct",), **kwargs
    )


def assess(flight, model, some=None, config=None, **kwargs):
    return assess_events(
        events() if some is None else some,
        overlay(flight, model, **kwargs),
        config or TransientsConfig(),
    )


def test_every_event_of_a_perfect_model_passes():
    result = assess(log(), log())
    assert [one.verdict.ok for one in result] == [True] * 4
    assert tally(result) == Tally(4, 4, 4, 4, 0, 0.0, 0.0, 0.0, 0.0)
    assert tally(result).passed_pct == 100.0
    assert [one.row()["label"] for one in result] == ["push", "pull", "push", "pull"]


def test_an_event_passes_if_every_channel_that_could_be_assessed_does():
    both = np.column_stack([log(), log(tau_s=1.4), log(size=1.0)])
    flight = np.column_stack([log(), log(), log(size=1.0)])
    names = ("N1_pct", "N2_pct", "EGT_C")
    found = assessed(
        events(),
        Overlay(np.arange(900) * DT_S, flight, both, names),
        TransientsConfig(channels=names),
    )
    assert [one.ok for one in found] == [False] * 4
    assert [one.move for one in found] == ["fast push", "fast pull"] * 2
    first = found[0]
    assert [first.of(name).verdict.ok for name in names] == [True, False, None]
    check = first.of("N2_pct").verdict.Tt
    assert first.severity == pytest.approx(abs(check.error_s) / check.allowed_s)
    assert AssessedEvent(first.event, first.assessments[:1]).ok is True
    assert AssessedEvent(first.event, first.assessments[2:]).ok is None
    assert AssessedEvent(first.event).of("N1_pct") is None


def test_a_failure_without_times_is_the_most_severe():
    [first, *_] = assessed(events(), overlay(log(), np.full(900, 70.0)), TransientsConfig())
    assert first.severity == np.inf


def test_a_steady_offset_is_not_a_fault_of_timing():
    assert all(one.verdict.ok for one in assess(log(), log() + 3.0))


def test_too_slow_a_model_fails_on_Tt_alone():  # noqa: N802
    result = assess(log(), log(tau_s=1.4))
    assert all(one.verdict.Ti.ok and not one.verdict.Tt.ok for one in result)
    assert tally(result).passed == 0
    assert tally(result).mean_relative_Tt_pct == pytest.approx(40.0, abs=0.5)
    assert tally(result).mean_absolute_Tt_s == pytest.approx(0.4 * np.log(9.0), abs=0.01)


def test_a_constant_model_fails_and_counts_as_100_percent():
    result = assess(log(), np.full(900, 70.0))
    assert {one.verdict.reason for one in result} == {
        "model: its response 0 is 0 % of the flight's, less than 50 %"
    }
    assert tally(result) == Tally(4, 4, 0, 0, 0, 100.0, 100.0, None, None)


def test_a_model_without_a_value_fails_unless_its_inputs_were_missing():
    model = log()
    model[60:65] = np.nan
    first = assess(log(), model)[0]
    assert first.verdict.ok is False
    assert first.verdict.reason == "model: 5 of 160 samples are missing"
    first = assess(log(), model, inputs_known=np.isfinite(model))[0]
    assert first.verdict.ok is None
    assert first.verdict.reason == "inputs are missing at 5 of 160 samples"


def test_interrupted_unsettled_small_and_masked_events_are_reported_not_passed():
    flight = log()
    flight[700] = np.nan
    one, two, three, four = events()
    some = [replace(one, interrupted=True, settled=False), replace(two, settled=False), four]
    reasons = [item.verdict.reason for item in assess(flight, log(), some)]
    assert reasons == [
        "the lever moves again before the response settles",
        "the response does not settle",
        "1 of 160 samples are missing",
    ]
    small = assess(log(size=1.2), log(size=1.2), [three])
    assert small[0].verdict.reason == "response 1.2 % is below 5 %"
    assert small[0].verdict.ok is None
    assert tally(small) == Tally(1, 0, 0, 0, 1, None, None, None, None)
    assert tally(small).passed_pct is None


@pytest.mark.parametrize(
    ("reasons", "shown"),
    [
        (["response 2 % is below 5 %"], {"response 2 % is below 5 %": 1}),
        (
            ["response 0.2 % is below 5 %", "response 4 % is below 5 %", "it drifts", "it drifts"],
            {"it drifts": 2, "response 0.2 to 4 % is below 5 %": 2},
        ),
        (
            [f"only {count} up to the move, 3 are needed" for count in ("1 sample", "2 samples")],
            {
                "only 1 to 2 samples up to the move, 3 are needed: "
                "raise before_s of [evaluate.transients]": 2
            },
        ),
        (
            ["1 of 72 samples are missing", "5 of 79 samples are missing"],
            {"1 to 5 samples are missing": 2},
        ),
    ],
)
def test_reasons_are_counted_with_the_range_of_their_figures(reasons, shown):
    (one, *_) = assess(log(), log())
    some = [replace(one, verdict=replace(one.verdict, ok=None, reason=text)) for text in reasons]
    assert not_assessable(some, figures=True) == shown


def test_rules_can_be_kept_to_rapid_movements():
    some = [
        replace(one, speed=speed) for one, speed in zip(events(), ("slow", "fast"), strict=False)
    ]
    result = assess(log(), log(), some, TransientsConfig(speeds=("fast",)))
    assert [one.verdict.ok for one in result] == [None, True]
    assert result[0].verdict.reason == "the movement is slow; only fast ones are judged"


def test_the_flight_alone_decides_whether_a_small_response_is_assessed():
    result = assess(log(size=5.1), log(size=4.9))
    assert [one.verdict.ok for one in result] == [True] * 4


def test_only_configured_channels_are_judged_and_each_has_its_least_response():
    both = np.column_stack([log(), log()])
    time_s = np.arange(900) * DT_S
    pair = Overlay(time_s, both, both, ("N1_pct", "EGT_C"))
    config = TransientsConfig(channels=("EGT_C",), least_response={"EGT_C": 10.0})
    assert [one.channel for one in assess_events(events(), pair, config)] == ["EGT_C"] * 4
    strict = assess_events(events(), pair, TransientsConfig(channels=("EGT_C",)))
    assert strict[0].verdict.reason == "response 20 degC is below 30 degC"


def test_a_channel_without_a_least_response_is_refused():
    config = TransientsConfig(channels=("FN_kN",))
    with pytest.raises(
        ConfigError,
        match=r"^channel FN_kN: the smallest response to assess is not set. "
        r"Set least_response.FN_kN$",
    ):
        config.reading_of("FN_kN")


def test_overlay_of_unequal_shapes_is_refused():
    with pytest.raises(
        DataError,
        match=r"^expected flight and model of shape \(time, channel\) = \(9, 1\), "
        r"got \(9, 1\) and \(8, 1\)$",
    ):
        Overlay(np.arange(9.0), np.zeros((9, 1)), np.zeros((8, 1)), ("N1_pct",))


def test_rows_show_the_flight_times_of_the_rules_even_where_the_model_failed():
    config = TransientsConfig(rules="icao9625")
    row = assess(log(), np.full(900, 70.0), config=config)[0].row()
    assert row["Tt"]["flight"] == pytest.approx(np.log(10.0), abs=0.02)
    assert row["Tt"]["ok"] is False


def test_rows_are_json_and_keep_the_raw_times():
    model = log(tau_s=1.1)
    model[460] = np.nan
    rows = [one.row() for one in assess(log(), model)]
    again = json.loads(json.dumps(finite(rows), allow_nan=False))
    assert again[0]["Ti"]["ok"] is True
    assert again[0]["raw"]["flight"]["t0_s"] == 5.0
    assert again[0]["raw"]["flight"]["t10_s"] == pytest.approx(5.0 + again[0]["Ti"]["flight"])
    assert again[2]["ok"] is False
    assert again[2]["Tt"] == {
        "flight": pytest.approx(np.log(9.0), abs=0.02),
        "model": None,
        "error": None,
        "allowed": None,
        "ok": False,
    }
    json.dumps(tally(assess(log(), model)).row(), allow_nan=False)


@given(seed=st.integers(0, 10_000), delay=st.integers(0, 6))
def test_a_delay_of_whole_samples_is_found_in_spite_of_noise(seed, delay):
    """0.25 s lie between 2 and 3 samples of 0.1 s; noise of 0.05 % moves Ti by less than 20 ms."""
    noise = np.random.default_rng(seed).normal(0.0, 0.05, (2, 900))
    result = assess(log() + noise[0], log(delay=delay) + noise[1])
    assert all(one.verdict.Ti.ok is (delay <= 2) for one in result)


@pytest.mark.parametrize(
    ("late_s", "loss"), [(0.0, 0.0), (0.25, 0.25), (0.5, 0.4), (1.0, 0.5 / (1.0 + 1.0 / 16.0))]
)
def test_the_loss_of_a_delay_is_that_of_its_share_of_the_tolerance(late_s, loss):
    """A delay of r tolerances of 0.25 s changes Ti alone: the mean with Tt is r^2 / 2 (1 + r^2)."""
    time_s = 0.05 * np.arange(1200)
    lever = np.where((time_s > 20.0) & (time_s < 40.0), 60.0, 20.0)

    def response(delay_s):
        y = np.empty_like(time_s)
        y[0] = 20.0
        moved = np.interp(time_s - delay_s, time_s, lever)
        for k in range(1, len(y)):
            y[k] = y[k - 1] + (1.0 - np.exp(-0.05)) * (moved[k] - y[k - 1])
        return y

    flight = response(0.0)
    log = Log("a", time_s, {"TRA_deg": lever, "N1_pct": flight, "EGT_C": 5.0 * flight})
    model = np.column_stack([response(late_s), np.full(len(time_s), 400.0)])
    config = RunConfig.parse({"steady_state": {"inputs": ["TRA_deg"]}})
    found = responses(log, model, ("N1_pct", "EGT_C"), config)
    assert len(found.rows) == 2
    assert found.losses[:, 0] == pytest.approx([loss] * 2, abs=0.02)
    assert found.passed[:, 0].tolist() == [float(late_s <= 0.25)] * 2
    assert np.isnan(found.losses[:, 1]).all()  # [evaluate] judges speeds


def test_a_model_that_does_not_respond_has_loss_one():
    time_s = 0.05 * np.arange(1200)
    lever = np.where(time_s > 20.0, 60.0, 20.0)
    log = Log("a", time_s, {"TRA_deg": lever, "N1_pct": lever})
    config = RunConfig.parse({"steady_state": {"inputs": ["TRA_deg"]}})
    found = responses(log, np.full((1200, 1), 20.0), ("N1_pct",), config)
    assert (found.losses.tolist(), found.passed.tolist()) == ([[1.0]], [[0.0]])
