"""Smoothing: closed forms of the moving average, its gain, and the comparison of windows."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from data_prep.cleaning.smooth import (
    SmoothConfig,
    blurs,
    compare_windows,
    cutoff_hz,
    frequency_response,
    moving_average,
    smooth,
    white_noise,
)
from data_prep.log import Log
from narxcal.support.errors import ConfigError

windows = st.integers(0, 12).map(lambda n: 2 * n + 1)


def slow_twin(values, window):
    """Plain mean over a full window; else the centre of a line through what there is."""
    half = window // 2
    out = values.copy()
    for k in range(len(values)):
        index = np.arange(max(0, k - half), min(len(values), k + half + 1))
        index = index[np.isfinite(values[index])]
        if np.isnan(values[k]):
            continue
        if len(index) == window:
            out[k] = values[index].mean()
        elif len(index) > 1:
            out[k] = np.polyval(np.polyfit(index - k, values[index], 1), 0.0)
    return out


@given(seed=st.integers(0, 10_000), window=windows, missing=st.floats(0, 0.6))
def test_fast_average_equals_the_slow_twin(seed, window, missing):
    rng = np.random.default_rng(seed)
    values = rng.normal(80.0, 5.0, 60)
    values[rng.random(60) < missing] = np.nan
    np.testing.assert_allclose(
        moving_average(values, window), slow_twin(values, window), rtol=0, atol=1e-8
    )


@given(window=windows, slope=st.floats(-10, 10), gap=st.integers(0, 25))
def test_a_ramp_passes_unchanged_at_the_ends_and_beside_gaps(window, slope, gap):
    ramp = 70.0 + slope * np.arange(100.0)
    ramp[40 : 40 + gap] = np.nan
    np.testing.assert_allclose(moving_average(ramp, window), ramp, atol=1e-8)


def test_a_step_is_smeared_symmetrically_so_there_is_no_phase_shift():
    step = np.repeat([0.0, 1.0], 50)
    smoothed = moving_average(step, 11)
    np.testing.assert_allclose(smoothed + smoothed[::-1], 1.0, atol=1e-12)
    np.testing.assert_allclose(smoothed[44:56], np.arange(12) / 11, atol=1e-12)


@pytest.mark.parametrize("window", [3, 11, 21])
def test_gain_of_a_sine_is_the_frequency_response(window):
    dt_s, time_s = 1 / 32, np.arange(3200) / 32
    for hertz in (0.1, 0.7, 1.3, 3.0):
        sine = np.sin(2 * np.pi * hertz * time_s)
        gain = frequency_response(window, np.array([hertz]), dt_s)[0]
        inner = slice(window, -window)
        np.testing.assert_allclose(
            moving_average(sine, window)[inner], gain * sine[inner], atol=1e-9
        )


def test_frequency_response_at_zero_the_notch_and_the_sampling_rate():
    gain = frequency_response(11, np.array([0.0, 32 / 11, 32.0]), 1 / 32)
    np.testing.assert_allclose(gain, [1.0, 0.0, 1.0], atol=1e-12)


def test_cutoff_is_where_half_the_power_passes():
    for window in (3, 11, 21):
        gain = frequency_response(window, np.array([cutoff_hz(window, 1 / 32)]), 1 / 32)
        assert gain[0] == pytest.approx(np.sqrt(0.5), abs=1e-4)
    assert cutoff_hz(1, 1 / 32) == float("inf")


def example(**channels):
    count = len(next(iter(channels.values())))
    return Log("flight:left", np.arange(count) / 32, channels)


def test_lever_and_switches_keep_their_edges():
    step = np.repeat([0.0, 1.0], 50)
    log = example(TRA_deg=40 * step, WOW=step, N1_pct=80 * step, Mach=step)
    smoothed = smooth(log, SmoothConfig())
    assert smoothed["TRA_deg"] is log["TRA_deg"]
    assert smoothed["WOW"] is log["WOW"]
    assert smoothed["N1_pct"][50] != 80.0
    assert smoothed["Mach"][50] != 1.0


def test_named_channels_only_and_window_one_changes_nothing():
    values = np.random.default_rng(0).normal(size=50)
    log = example(N1_pct=values, N2_pct=values)
    one = smooth(log, SmoothConfig(channels=("N1_pct",)))
    assert one["N2_pct"] is log["N2_pct"]
    np.testing.assert_array_equal(smooth(log, SmoothConfig(window=1))["N1_pct"], values)


@pytest.mark.parametrize(
    ("window", "rate_hz", "message"),
    [
        (11, 32.0, ""),
        (3, 10.0, ""),
        (1, 0.5, ""),
        (11, 10.0, "lasts 1.1 s at 10 Hz, which blurs fast movements: take 3"),
        (5, 4.0, "lasts 1.2 s at 4 Hz, which blurs fast movements: take 1"),
    ],
)
def test_a_window_that_blurs_fast_movements_is_told_with_one_that_does_not(
    window, rate_hz, message
):
    said = blurs(SmoothConfig(window=window), 1.0 / rate_hz)
    assert said.removeprefix(f"[smooth] window = {window} ") == message


@pytest.mark.parametrize(
    ("hz", "window"), [(100, 35), (32, 11), (16, 5), (10, 3), (9, 3), (8, 1), (1, 1)]
)
def test_the_usual_window_goes_by_the_rate(hz, window):
    assert SmoothConfig().window_at(1 / hz) == window
    assert SmoothConfig(window=7).window_at(1 / hz) == 7


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        (
            {"channels": ["WOW"]},
            "'WOW' is a switch and cannot be smoothed. Remove it from channels in [smooth]",
        ),
        (
            {"window": 10},
            "a.toml: key 'window': a centred window is an odd number of samples, found 10",
        ),
    ],
)
def test_what_cannot_be_smoothed_is_refused(settings, message):
    with pytest.raises(ConfigError) as error:
        smooth(example(WOW=np.zeros(9)), SmoothConfig.parse(settings, file="a.toml"))
    assert str(error.value) == message


def test_comparison_shows_noise_falling_and_transients_suffering_with_the_window():
    rng = np.random.default_rng(3)
    time_s = np.arange(9600) / 32
    speed = 70 + 20 * np.tanh(3 * np.sin(time_s / 3))
    table = compare_windows(example(N1_pct=speed + rng.normal(0, 0.05, 9600)), ["N1_pct"])
    assert table["window"].tolist() == [3, 11, 21]
    assert table["window_s"].tolist() == pytest.approx([3 / 32, 11 / 32, 21 / 32])
    np.testing.assert_allclose(table["noise_gain"], 1 / np.sqrt([3, 11, 21]))
    # At rest the error is the noise that was removed: sigma * sqrt(1 - 1/M).
    np.testing.assert_allclose(
        table["rms_rest"], 0.05 * np.sqrt(1 - 1 / table["window"]), rtol=0.05
    )
    moving = table["rms_moving"].to_numpy()
    assert moving[2] > 1.5 * moving[1]
    assert (np.diff(table["cutoff_hz"]) < 0).all()
    assert table["gain_1_hz"].iloc[1] == pytest.approx(0.818, abs=1e-3)


def test_comparison_of_a_masked_channel_is_undefined_not_an_error():
    table = compare_windows(example(N1_pct=np.full(99, np.nan)), ["N1_pct"], [3])
    assert table[["rms", "rms_rest", "rms_moving"]].isna().all(axis=None)


@pytest.mark.parametrize("window", [3, 11, 21])
def test_the_noise_that_smoothing_takes_is_known(window):
    """Of samples near slams and gaps; nothing is known of what is masked or not averaged."""
    rng = np.random.default_rng(window)
    speed = np.repeat(rng.uniform(60.0, 90.0, 20), 800) + np.tile(np.linspace(0.0, 2.0, 800), 20)
    raw = speed + 0.05 * rng.normal(size=speed.size)
    raw[rng.random(raw.size) < 0.02] = np.nan
    log = Log(
        "log.csv", np.arange(raw.size) / 32, {"N1_pct": raw, "N2_pct": np.full(raw.size, np.nan)}
    )
    smoothed = smooth(log, SmoothConfig(window=window))
    assert smoothed.noise["N1_pct"] == pytest.approx(0.05**2, rel=0.08)
    assert smoothed.noise["N2_pct"] == 0.0
    assert smooth(log, SmoothConfig(window=1)).noise["N1_pct"] == 0.0
    assert white_noise(speed, moving_average(speed, window), (window, 1 / 32)) < 1e-6
