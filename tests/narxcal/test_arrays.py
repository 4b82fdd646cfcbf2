"""Gaps and flags of signals, each against a loop over the samples."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from narxcal.support.arrays import (
    bridge_gaps,
    last_true,
    long_runs,
    noise_level,
    robust_range,
    sample_and_hold,
    spans,
)

FLAGS = st.lists(st.booleans(), max_size=40).map(lambda flags: np.array(flags, dtype=np.bool_))
VALUES = st.lists(st.one_of(st.none(), st.integers(-9, 9)), min_size=1, max_size=40).map(
    lambda values: np.array([np.nan if value is None else value for value in values], dtype=float)
)


@given(flags=FLAGS)
def test_spans_are_the_longest_stretches_of_true(flags):
    found = spans(flags)
    covered = np.zeros(len(flags), dtype=np.bool_)
    for start, stop in found:
        assert flags[start:stop].all()
        assert start < stop
        assert start == 0 or not flags[start - 1]
        assert stop == len(flags) or not flags[stop]
        covered[start:stop] = True
    assert (covered == flags).all()


@given(flags=FLAGS, longest=st.integers(0, 10))
def test_long_runs_keep_what_is_longer(flags, longest):
    kept = [span for span in spans(flags) if span[1] - span[0] > longest]
    assert spans(long_runs(flags, longest)) == kept


@given(flags=FLAGS)
def test_the_last_true_is_at_or_before_each_sample(flags):
    for k, at in enumerate(last_true(flags)):
        known = np.flatnonzero(flags[: k + 1])
        assert at == (known[-1] if len(known) else -1)
    columns = np.stack([flags, ~flags], axis=1)
    np.testing.assert_array_equal(last_true(columns)[:, 0], last_true(flags))


@given(values=VALUES)
def test_the_last_finite_value_is_held_and_the_first_one_carried_back(values):
    known = values[np.isfinite(values)]
    expected, last = [], known[0] if len(known) else np.nan
    for value in values:
        last = value if np.isfinite(value) else last
        expected.append(last)
    np.testing.assert_array_equal(sample_and_hold(values), expected)


@given(values=VALUES)
def test_gaps_are_bridged_by_straight_lines(values):
    filled, known = bridge_gaps(values), np.isfinite(values)
    np.testing.assert_array_equal(filled[known], values[known])
    assert np.isfinite(filled).all() == known.any()
    for start, stop in spans(~known):
        if known.any() and start > 0 and stop < len(values):
            line = np.linspace(values[start - 1], values[stop], stop - start + 2)
            np.testing.assert_allclose(filled[start:stop], line[1:-1], atol=1e-12)


@pytest.mark.parametrize("trend", [0.0, 0.3])
def test_the_noise_level_is_that_of_white_noise_on_a_ramp_with_a_step(trend):
    time = np.arange(20_000.0)
    signal = trend * time + 50.0 * (time > 9_000) + np.random.default_rng(0).normal(0, 0.2, 20_000)
    assert noise_level(signal) == pytest.approx(0.2, rel=0.03)
    assert noise_level(signal[:2]) == 0.0


def test_the_robust_range_leaves_out_half_a_percent_at_each_end():
    values = np.append(np.arange(1001.0), np.nan)
    assert robust_range(values) == (5.0, 995.0)
    assert np.isnan(robust_range(np.full(3, np.nan))).all()
