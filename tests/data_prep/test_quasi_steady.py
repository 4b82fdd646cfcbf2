"""Where a log stands still: against a slow twin, and at the edges of what is known."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from data_prep.equilibrium import QuasiSteadyConfig, quasi_steady
from data_prep.log import Log

DT_S = 0.5


def log(lever, n1):
    time_s = DT_S * np.arange(len(lever))
    channels = {"TRA_deg": np.array(lever, dtype=float), "N1_pct": np.array(n1, dtype=float)}
    return Log("flight", time_s, channels)


def still(given_, **config):
    return quasi_steady(given_, "TRA_deg", ("N1_pct",), QuasiSteadyConfig(**config))


def test_a_slam_is_not_steady_and_what_is_far_from_it_is():
    lever = np.r_[np.full(40, 10.0), np.full(40, 70.0)]
    found = still(log(lever, lever), window_s=6.0)
    # The window reaches 6 samples to either side of the slam between samples 39 and 40.
    assert np.flatnonzero(~found).tolist() == list(range(34, 46))


def test_a_window_longer_than_the_log_is_as_long_as_the_log():
    lever = np.r_[np.full(40, 10.0), np.full(40, 70.0)]
    assert not still(log(lever, lever), window_s=1e12).any()
    assert still(log(np.full(80, 10.0), np.full(80, 70.0)), window_s=1e12).all()


def test_a_speed_that_still_moves_is_not_steady():
    lever = np.r_[np.full(20, 10.0), np.full(80, 70.0)]
    n1 = 70.0 - 50.0 * np.exp(-np.maximum(np.arange(100) - 20, 0) / 8.0)
    found = still(log(lever, n1), window_s=2.0, speed_pct=1.0)
    settled = np.flatnonzero(found & (np.arange(100) > 22))
    assert settled[0] > 35
    assert found[-10:].all()


def test_nothing_is_steady_beside_an_unknown_sample():
    n1 = np.full(50, 40.0)
    n1[20] = np.nan
    found = still(log(np.linspace(10.0, 10.01, 50) * 0 + 10.0, n1), window_s=2.0)
    assert np.flatnonzero(~found).tolist() == [18, 19, 20, 21, 22]


def test_a_log_without_its_driver_is_never_steady():
    assert not still(log(np.full(30, np.nan), np.full(30, 40.0))).any()


@settings(max_examples=40, deadline=None)
@given(
    seed=st.integers(0, 999),
    window_s=st.sampled_from([1.0, 3.0, 6.0]),
    speed_pct=st.sampled_from([0.5, 2.0, 8.0]),
)
def test_it_is_what_a_loop_over_windows_finds(seed, window_s, speed_pct):
    rng = np.random.default_rng(seed)
    n1 = np.cumsum(rng.normal(size=60))
    n1[rng.integers(0, 60)] = np.nan
    lever = np.repeat(rng.uniform(0.0, 80.0, 4), 15)
    found = still(log(lever, n1), window_s=window_s, speed_pct=speed_pct)
    half = round(0.5 * window_s / DT_S)
    low, high = np.percentile(lever, [1, 99])
    for k in range(60):
        part = slice(max(k - half, 0), k + half + 1)
        expected = (
            np.isfinite(n1[part]).all()
            and np.ptp(n1[part]) <= speed_pct
            and np.ptp(lever[part]) <= 0.03 * (high - low)
        )
        assert found[k] == expected


@pytest.mark.parametrize("key", ["window_s", "speed_pct", "driver_fraction"])
def test_bounds_have_to_be_positive(key):
    with pytest.raises(ValueError, match="greater than 0"):
        QuasiSteadyConfig(**{key: 0.0})
