"""Pairs become one batch: means over blocks, padding, noise, and what the signals are."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from eval.diagnosis.flights import block_means, block_size
from eval.diagnosis.pairs import pair_logs
from tests.eval.diagnosis.conftest import batch


def slow_means(values, size):
    rows = []
    for start in range(0, len(values) - size + 1, size):
        part = values[start : start + size]
        known = [v for v in part if np.isfinite(v)]
        rows.append(sum(known) / len(known) if 2 * len(known) >= size else np.nan)
    return np.array(rows)


@given(
    st.lists(st.sampled_from([0.0, 1.5, -2.0, np.nan]), min_size=5, max_size=40), st.integers(1, 5)
)
def test_block_means_are_those_of_a_loop(values, size):
    values = np.array(values)
    np.testing.assert_allclose(block_means(values, size), slow_means(values, size))


@pytest.mark.parametrize(
    ("rate_hz", "size"), [(64.0, 16), (32.0, 8), (16.0, 4), (12.0, 3), (5.0, 1), (4.0, 1)]
)
def test_blocks_bring_logs_to_about_4_hz_and_leave_slow_ones(rate_hz, size):
    assert block_size(1.0 / rate_hz) == size


def test_shorter_flights_are_filled_up_and_unknown_there(pair):
    pairs = [pair(0, duration_s=60.0), pair(1, duration_s=90.0)]
    data = batch(pairs)
    assert data.flights.u.shape == (2, 720, 5)
    assert data.flights.lengths.tolist() == [480, 720]
    np.testing.assert_array_equal(
        data.flights.y[0, 480:], np.repeat(data.flights.y[0, 479:480], 240, axis=0)
    )
    assert np.isnan(data.real[0, 480:]).all()
    assert np.isfinite(data.real[1]).all()


def test_signals_say_what_moves_and_how_far(pair):
    signals = batch([pair(0)]).flights.signals
    assert signals.driver == "TRA_deg"
    assert signals.active == ("TRA_deg", "ALT_ft", "NAI")  # Mach and dT_C never change
    assert signals.dt_s == pytest.approx(0.125)
    assert signals.lever[0] < 20.0
    assert signals.lever[1] > 50.0
    assert (signals.low < signals.high).all()


def test_noise_is_found_beside_a_gap_that_moves(make_data, probe):
    for effect in (lambda _: {}, probe):
        found = make_data(effect).noise
        np.testing.assert_allclose(found, np.array([0.05, 0.04, 0.8]) / np.sqrt(2.0), rtol=0.15)


def test_a_coarse_reading_that_mostly_repeats_has_noise_all_the_same(fly, log_of):
    sim = fly(0, rate_hz=8.0)
    flat = {**sim, "N1_pct": np.where(np.arange(len(sim["time_s"])) % 2000 < 1000, 60.0, 80.0)}
    rng = np.random.default_rng(0)
    real = {**flat, "N1_pct": flat["N1_pct"] + 0.5 * (rng.random(len(sim["time_s"])) < 0.04)}
    noise = batch([pair_logs("f", log_of(real), log_of(flat))]).noise
    assert 0.0 < noise[0] < 0.2
    # Logs that agree to the digit have next to none, but not so little that nothing can be said.
    assert 0.0 < noise[1] < 1e-3
