"""Measures against what a person computes by hand."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from eval.gap.blind.metrics import (
    area_under_curve,
    brier,
    calibration_error,
    kappa,
    log_score,
    macro_f1,
    mean,
    median,
    overlap,
    rate,
    selective_accuracy,
    slope,
)


def test_wilson_as_tabulated():
    # 81 of 263, z = 1.96: [0.2553, 0.3662] (R. G. Newcombe, Stat. Med. 17, 1998, 857, table I).
    found = rate([True] * 81 + [False] * 182)
    assert (found.hits, found.of) == (81, 263)
    assert (found.low, found.high) == pytest.approx((0.2553, 0.3662), abs=5e-5)
    # 0 of 20 and 15 of 148, from the same table.
    assert rate([False] * 20)[2:] == pytest.approx((0.0, 0.0, 0.1611), abs=5e-5)
    assert rate([True] * 15 + [False] * 133)[3:] == pytest.approx((0.0624, 0.1605), abs=5e-5)


def test_a_rate_of_nothing_is_no_number():
    found = rate([])
    assert found.of == 0
    assert all(math.isnan(each) for each in found[2:])


@given(st.integers(0, 40), st.integers(0, 40))
def test_the_interval_holds_the_rate_and_mirrors(hits, misses):
    if hits + misses == 0:
        return
    found, mirrored = rate([True] * hits + [False] * misses), rate([True] * misses + [False] * hits)
    assert 0.0 <= found.low <= found.value + 1e-12
    assert found.value <= found.high + 1e-12
    assert found.high <= 1.0
    assert found.low == pytest.approx(1.0 - mirrored.high, abs=1e-12)


def test_f1_is_the_mean_over_true_labels():
    truths, answers = ["a", "a", "b", "none"], ["a", "b", "b", "c"]
    # a: tp 1, fn 1 -> 2/3; b: tp 1, fp 1 -> 2/3; none: 0. What nobody is (c) has no share.
    assert macro_f1(truths, answers) == pytest.approx((2 / 3 + 2 / 3 + 0.0) / 3)
    assert macro_f1(truths, truths) == 1.0
    assert math.isnan(macro_f1([], []))


def test_kappa_takes_chance_away():
    # Cohen's own form: seen 0.75, chance 2/4*3/4 + 2/4*1/4 = 0.5.
    assert kappa(["a", "a", "b", "b"], ["a", "a", "a", "b"]) == pytest.approx(0.5)
    assert kappa(["a", "b"], ["b", "a"]) == pytest.approx(-1.0)
    assert kappa(["a", "a"], ["a", "a"]) == 1.0
    assert math.isnan(kappa([], []))


def test_brier_counts_what_was_not_listed():
    assert brier([{"a": 0.7, "b": 0.3}], [{"a"}]) == pytest.approx(0.09 + 0.09)
    assert brier([{"a": 0.7, "b": 0.3}], [{"c"}]) == pytest.approx(0.49 + 0.09 + 1.0)
    assert brier([{}, {"a": 1.0}], [(), ("a",)]) == 0.0


def test_calibration_error_over_bins():
    # Bin 0.9-1: mean 0.95, half right; bin 0.2-0.3: mean 0.25, all right. Weights 2/3 and 1/3.
    found = calibration_error([0.95, 0.95, 0.25], [True, False, True])
    assert found == pytest.approx(2 / 3 * 0.45 + 1 / 3 * 0.75)
    assert calibration_error([1.0], [True]) == 0.0
    assert math.isnan(calibration_error([], []))


def test_overlap_is_intersection_over_union():
    assert overlap({"a", "b", "c"}, {"b", "c", "d"}) == pytest.approx(0.5)
    assert overlap({"a"}, {"b"}) == 0.0
    assert overlap(set(), set()) == 1.0


def test_means_of_nothing_are_no_numbers():
    assert math.isnan(mean([]))
    assert math.isnan(median([]))
    assert (mean([1.0, 4.0]), median([1.0, 9.0, 2.0])) == (2.5, 2.0)


def test_log_score_area_selection_and_slope():
    assert log_score([1.0, 0.5]) == pytest.approx(0.5 * math.log(2.0))
    assert log_score([0.0]) == pytest.approx(-math.log(0.01))
    assert area_under_curve([3.0, 2.0], [1.0, 2.0]) == pytest.approx((1 + 1 + 1 + 0.5) / 4)
    assert math.isnan(area_under_curve([], [1.0]))
    assert selective_accuracy([0.9, 0.1, 0.8, 0.7, 0.6], [True, False, True, True, False]) == 0.75
    assert math.isnan(selective_accuracy([], []))
    assert slope([0.0, 1.0, 2.0], [1.0, 3.0, 5.0]) == pytest.approx(2.0)
    assert math.isnan(slope([1.0, 1.0], [0.0, 1.0]))
