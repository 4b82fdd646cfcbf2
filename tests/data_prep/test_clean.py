"""Single gross errors: found, repaired, counted; slams, peaks and good samples untouched."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from data_prep.cleaning.clean import (
    CleanConfig,
    _critical,
    _grubbs,
    clean,
    deviations,
    running_median,
)
from data_prep.log import Log

DT = 1 / 32
METHODS = ["3-sigma", "grubbs"]


def gross_errors(values, method="3-sigma"):
    return deviations(values, 33).gross(3.0, method)


def noisy(seed=0, count=6400, sigma=0.05):
    rng = np.random.default_rng(seed)
    time_s = np.arange(count) * DT
    return 75 + 15 * np.sin(time_s / 20) + rng.normal(0, sigma, count)


def log_of(**channels):
    count = len(next(iter(channels.values())))
    return Log("flight:left", np.arange(count) * DT, channels)


@pytest.mark.parametrize("method", METHODS)
@given(seed=st.integers(0, 1000))
def test_isolated_spikes_are_repaired_and_counted(method, seed):
    rng = np.random.default_rng(seed)
    truth = noisy(seed)
    spikes = rng.choice(np.arange(50, 6350, 150), 20, replace=False)
    values = truth.copy()
    values[spikes] += rng.choice([-1, 1], 20) * rng.uniform(2, 30, 20)
    cleaned = clean(log_of(N1_pct=values), CleanConfig(method=method))
    assert np.abs(cleaned["N1_pct"][spikes] - truth[spikes]).max() < 0.4
    repaired = sum(entry.samples for entry in cleaned.audit.entries)
    assert {entry.action for entry in cleaned.audit.entries} == {"repaired"}
    assert repaired == (cleaned["N1_pct"] != values).sum()
    assert 20 <= repaired <= 20 + 0.006 * 6400


@pytest.mark.parametrize("method", METHODS)
def test_few_good_samples_of_white_noise_are_touched(method):
    cleaned = clean(log_of(N1_pct=noisy(count=30_000)), CleanConfig(method=method))
    assert sum(entry.samples for entry in cleaned.audit.entries) < 0.003 * 30_000


@pytest.mark.parametrize("window", [3, 5, 11, 33])
@pytest.mark.parametrize("slope", [0.0, 0.5])
def test_the_spread_of_white_noise_is_found_in_a_window_of_any_length_on_any_slope(window, slope):
    noise = np.random.default_rng(0).normal(size=20_000)
    found = deviations(noise + slope * np.arange(20_000), window).spread
    low, middle, high = np.quantile(found, [0.01, 0.5, 0.99])
    assert middle == pytest.approx(1.0, rel=0.15)
    assert (low > 0.7, high < 1.6) == (True, True)


@pytest.mark.parametrize("dt_s", [1.0, 0.5, 0.25])
def test_a_slow_recorder_loses_no_good_sample_and_no_spike(dt_s):
    values = 650.0 + np.random.default_rng(1).normal(0.0, 1.2, 5000)
    spikes = np.arange(40, 5000, 160)
    values[spikes] += 25.0
    cleaned = clean(Log("flight:left", np.arange(5000) * dt_s, {"EGT_C": values}))
    masked = np.isnan(cleaned["EGT_C"])
    assert masked[spikes].all()
    assert masked.sum() - len(spikes) <= 1


@pytest.mark.parametrize("method", METHODS)
@given(rate=st.floats(0.1, 40.0), tau_s=st.floats(0.3, 4.0))
def test_a_slam_is_no_outlier(method, rate, tau_s):
    time_s = np.arange(3200) * DT
    step = np.clip((time_s - 40) * rate, 0, 40)
    lagged = 50 + 40 * (1 - np.exp(-np.maximum(time_s - 60, 0) / tau_s))
    assert not gross_errors(50 + step, method).any()
    assert not gross_errors(lagged, method).any()


@pytest.mark.parametrize("method", METHODS)
def test_an_overshoot_of_a_second_is_no_outlier(method):
    time_s = np.arange(6400) * DT
    peak = 600 + 150 * np.exp(-(((time_s - 100) / 0.7) ** 2))
    noise = np.random.default_rng(0).normal(0, 0.2, 6400)
    assert not gross_errors(peak, method).any()
    near = np.abs(time_s - 100) < 3
    assert gross_errors(peak + noise, method)[near].mean() < 0.02


def test_the_last_digit_of_a_noise_free_simulation_is_no_outlier():
    values = np.round(75 + 15 * np.tanh(np.arange(6400) * DT / 20), 3)
    values[::97] += 0.001
    assert not gross_errors(values).any()


def test_a_coarsely_quantised_channel_keeps_its_steps():
    rng = np.random.default_rng(1)
    values = np.round((10 - np.arange(6400) / 800 + rng.normal(0, 0.15, 6400)) * 4) / 4
    assert gross_errors(values).mean() < 0.003


def test_a_spike_on_a_slam_is_found():
    values = noisy()
    values += np.clip(np.arange(6400) - 3000, 0, 100) * 0.1
    values[3050] += 20.0
    assert gross_errors(values)[3050]


def test_running_median_of_a_monotone_signal_is_the_signal():
    values = np.sort(np.random.default_rng(0).normal(size=300))
    np.testing.assert_array_equal(running_median(values, 33)[16:-16], values[16:-16])


def test_grubbs_critical_values_match_the_published_table():
    """Grubbs (1969), two-sided 5 %: N = 10, 20, 50."""
    np.testing.assert_allclose(_critical(np.array([10, 20, 50])), [2.290, 2.708, 3.128], atol=1e-3)
    assert _critical(np.array([2]))[0] == np.inf


def test_grubbs_in_one_block_equals_the_textbook_loop():
    rng = np.random.default_rng(4)
    residual = rng.normal(0, 1, 100)
    residual[[5, 50, 77]] = [9.0, -7.0, 5.0]
    kept = list(range(100))
    while True:
        x = residual[kept]
        count = len(x)
        worst = int(np.argmax(np.abs(x - x.mean())))
        t = stats.t.ppf(1 - 0.05 / (2 * count), count - 2)
        limit = (count - 1) / np.sqrt(count) * np.sqrt(t**2 / (count - 2 + t**2))
        if abs(x[worst] - x.mean()) <= limit * x.std(ddof=1):
            break
        kept.pop(worst)
    assert np.flatnonzero(~_grubbs(residual, 100)).tolist() == kept


def test_short_faults_out_of_range_are_repaired_longer_ones_masked():
    values = noisy()
    values[1000:1003] = 500.0
    values[2000:2020] = -50.0
    cleaned = clean(log_of(N1_pct=values))
    entries = {(e.action, e.reason): e.samples for e in cleaned.audit.entries}
    assert entries["repaired", "out of range"] == 3
    assert entries["masked", "out of range"] == 20
    assert np.abs(cleaned["N1_pct"][1000:1003] - noisy()[1000:1003]).max() < 0.4
    assert np.isnan(cleaned["N1_pct"][2000:2020]).all()


@pytest.mark.parametrize(
    ("channel", "sound", "rows", "value", "lost"),
    [
        ("N1_pct", noisy(), slice(1000, 1100), np.inf, {"N1_pct": {"out of range": 100}}),
        ("N1_pct", noisy(), slice(100, 400), np.nan, {}),
        ("WOW", np.zeros(6400), slice(3000, 3001), 1.0, {}),
        ("WOW", np.zeros(6400), slice(4000, 4100), 7.0, {"WOW": {"out of range": 100}}),
        ("WOW", np.repeat([0.0, 1.0], 3200), slice(3199, 3201), 3.0, {}),  # repaired, to 0 or 1
    ],
)
def test_what_of_one_channel_is_masked(channel, sound, rows, value, lost):
    values = sound.copy()
    values[rows] = value
    cleaned = clean(log_of(**{channel: values}))
    assert cleaned.audit.masked() == lost
    unknown = np.isnan(values)
    unknown[rows] |= bool(lost)
    np.testing.assert_array_equal(np.isnan(cleaned[channel]), unknown)
    assert channel != "WOW" or {*cleaned["WOW"][~unknown]} <= {0.0, 1.0}


def test_short_spans_are_only_counted_long_ones_are_listed():
    values = noisy()
    values[2000:2020] = -50.0
    values[4000:4200] = -50.0
    entries = [e for e in clean(log_of(N1_pct=values)).audit.entries if e.action == "masked"]
    assert [entry.samples for entry in entries] == [220]
    np.testing.assert_allclose(entries[0].spans_s, [(4000 * DT, 4200 * DT)], atol=DT)


def test_cleaning_twice_masks_nothing_more():
    values = noisy()
    values[2000:2200] = values[2000]
    log = clean(log_of(N1_pct=values, EGT_C=noisy(1)))
    again = clean(log)
    assert again.audit.masked() == log.audit.masked() == {"N1_pct": {"frozen": 200}}


def test_disabled_cleaning_returns_the_log_itself():
    log = log_of(N1_pct=np.full(100, 999.0))
    assert clean(log, CleanConfig(enabled=False)) is log
