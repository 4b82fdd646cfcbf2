"""A transient read off analytic responses has the analytic Ti and Tt."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import brentq
from scipy.signal import lti, step

from narxcal.support.errors import DataError
from training.responses.response import (
    HIGH,
    LOW,
    TransientConfig,
    low_and_high_crossing,
    measure_transient,
)

START_S = 2.0
CONFIG = TransientConfig(least_response=5.0)


def first_order(tau_s, delay_s=0.0, dt_s=0.01, stop_s=None):
    """Unit response of a lag `tau_s` behind a dead time, lever at `START_S`."""
    time_s = np.arange(0.0, START_S + delay_s + (stop_s or 20.0 * tau_s + 2.0), dt_s)
    since = np.maximum(time_s - START_S - delay_s, 0.0)
    return time_s, 1.0 - np.exp(-since / tau_s)


@given(
    tau_s=st.floats(0.1, 3.0),
    delay_s=st.floats(0.0, 1.0),
    before=st.floats(-100.0, 900.0),
    response=st.sampled_from([-300.0, -20.0, 20.0, 300.0]),
)
def test_first_order_lag_with_dead_time(tau_s, delay_s, before, response):
    time_s, unit = first_order(tau_s, delay_s)
    read = measure_transient(time_s, before + response * unit, START_S, CONFIG)
    assert read.reason is None
    # Linear interpolation of a curve with curvature 1/tau^2 is wrong by dt^2/(8 tau) at most;
    # the knee at the end of the dead time costs up to one sample if it lies next to 10 %.
    tolerance = 1e-6 + 0.01**2 / tau_s
    assert read.Ti_s == pytest.approx(delay_s + tau_s * np.log(1 / 0.9), abs=tolerance)
    assert read.Tt_s == pytest.approx(tau_s * np.log(9.0), abs=2 * tolerance)
    assert read.response == pytest.approx(response, rel=1e-6)


@pytest.mark.parametrize("damping", [1.0, 1.5, 3.0, 0.5])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_second_order_against_the_exact_crossings(damping, sign):
    """Over-damped, critically damped and overshooting (first crossing of 90 %)."""
    system = lti([1.0], [1.0, 2.0 * damping, 1.0])
    since = np.arange(0.0, 60.0, 0.02)
    unit = step(system, T=since)[1]
    time_s = np.concatenate((np.arange(0.0, START_S, 0.02), START_S + since))
    y = 60.0 + sign * 20.0 * np.concatenate((np.zeros(len(time_s) - len(since)), unit))
    read = measure_transient(time_s, y, START_S, CONFIG)

    def crossing(level):
        fine = np.linspace(0.0, 60.0, 600_001)
        shape = _second_order(fine, damping)
        first = int(np.argmax(shape >= level))
        return brentq(
            lambda t: float(_second_order(np.array([t]), damping)[0]) - level,
            fine[first - 1],
            fine[first],
        )

    assert read.Ti_s == pytest.approx(crossing(0.1), abs=1e-3)
    assert read.Tt_s == pytest.approx(crossing(0.9) - crossing(0.1), abs=2e-3)


def _second_order(t, damping):
    """Step response of 1/(s^2 + 2 damping s + 1)."""
    if damping == 1.0:
        return 1.0 - (1.0 + t) * np.exp(-t)
    root = np.sqrt(complex(damping**2 - 1.0))
    p, q = -damping + root, -damping - root
    return np.real(1.0 + (q * np.exp(p * t) - p * np.exp(q * t)) / (p - q))


@given(
    scale=st.floats(0.3, 50.0),
    offset=st.floats(-500.0, 500.0),
    shift=st.integers(-2000, 2000),
    mode=st.sampled_from(["interpolated", "nearest"]),
)
def test_scale_offset_time_shift_and_direction_do_not_matter(scale, offset, shift, mode):
    config = TransientConfig(reading=mode)
    time_s, unit = first_order(0.8, 0.21, dt_s=0.03125)
    read = measure_transient(time_s, 20.0 * unit, START_S, config)
    shift_s = shift * 0.03125
    moved = measure_transient(
        time_s + shift_s, offset + scale * 20.0 * unit, START_S + shift_s, config
    )
    pull = measure_transient(time_s, 90.0 - 20.0 * unit, START_S, config)
    for other in (moved, pull):
        assert other.Ti_s == pytest.approx(read.Ti_s, abs=1e-6)
        assert other.Tt_s == pytest.approx(read.Tt_s, abs=1e-6)
    assert moved.t0_s == START_S + shift_s
    assert moved.t10_s == pytest.approx(read.t10_s + shift_s, abs=1e-6)
    assert pull.response == pytest.approx(-read.response)


@given(
    tau_s=st.floats(0.1, 3.0),
    dt_s=st.sampled_from([0.01, 0.03125, 0.1]),
    delay_s=st.floats(0.0, 1.0),
)
def test_nearest_sample_is_a_sample_within_half_an_interval(tau_s, dt_s, delay_s):
    time_s, unit = first_order(tau_s, delay_s, dt_s)
    fine = measure_transient(time_s, 20.0 * unit, START_S, CONFIG)
    near = measure_transient(time_s, 20.0 * unit, START_S, TransientConfig(reading="nearest"))
    assert abs(near.t10_s - fine.t10_s) <= dt_s / 2 + 1e-9
    assert abs(near.t90_s - fine.t90_s) <= dt_s / 2 + 1e-9
    assert np.min(np.abs(time_s - near.t10_s)) == 0.0
    assert near.dt_s == pytest.approx(dt_s)


@given(tau_s=st.floats(0.2, 3.0), dt_s=st.sampled_from([0.03125, 0.1]))
def test_nearest_sample_is_what_the_papers_loop_finds(tau_s, dt_s):
    """The paper loops over the samples for the one closest to 10 % and 90 % of the power."""
    time_s, unit = first_order(tau_s, 0.0, dt_s)
    near = measure_transient(time_s, 20.0 * unit, START_S, TransientConfig(reading="nearest"))
    for level, found in ((0.1, near.t10_s), (0.9, near.t90_s)):
        best = 0
        for k in range(len(unit)):
            if abs(unit[k] - level) < abs(unit[best] - level):
                best = k
        nearest = unit[np.argmin(np.abs(time_s - found))]
        assert abs(nearest - level) == pytest.approx(abs(unit[best] - level), abs=1e-8)


def test_noise_does_not_bias_the_readings():
    """At 32 Hz and noise of 2 % of the response Ti and Tt scatter, but about the truth."""
    time_s, unit = first_order(1.0, 0.3, dt_s=1 / 32, stop_s=10.0)
    rng = np.random.default_rng(7)
    reads = [
        measure_transient(time_s, 20.0 * unit + rng.normal(0.0, 0.4, len(time_s)), START_S, CONFIG)
        for _ in range(200)
    ]
    initial = np.array([read.Ti_s for read in reads]) - (0.3 + np.log(1 / 0.9))
    total = np.array([read.Tt_s for read in reads]) - np.log(9.0)
    assert abs(initial.mean()) < 0.01
    assert abs(total.mean()) < 0.05
    assert initial.std() < 0.05
    assert total.std() < 0.25


def test_a_blip_before_the_response_is_not_its_beginning():
    time_s, unit = first_order(0.5, 1.0)
    clean = measure_transient(time_s, 20.0 * unit, START_S, CONFIG)
    blip = 4.0 * ((time_s > START_S + 0.2) & (time_s < START_S + 0.4))
    assert measure_transient(time_s, 20.0 * unit + blip, START_S, CONFIG).Ti_s == clean.Ti_s


def test_overshoot_and_swing_back_do_not_delay_the_90_percent_crossing():
    since = np.arange(-1.0, 20.0, 0.01)
    swing = np.where(since > 0, 1.0 - np.exp(-since) * np.cos(4.0 * since), 0.0)
    assert swing.max() > 1.3
    assert swing[since > 1.0].min() < 0.9
    read = measure_transient(since, 30.0 * swing, 0.0, CONFIG)
    first = since[np.argmax(swing >= 0.9)]
    assert read.t90_s == pytest.approx(first, abs=0.01)


def test_a_step_between_two_samples_is_read():
    time_s = np.arange(0.0, 5.0, 0.1)
    read = measure_transient(time_s, np.where(time_s > 2.0, 80.0, 60.0), time_s[20], CONFIG)
    assert read.Ti_s == pytest.approx(0.01)
    assert read.Tt_s == pytest.approx(0.08)


def test_a_response_that_leads_its_driver_has_a_negative_Ti():  # noqa: N802
    time_s, unit = first_order(0.3)
    read = measure_transient(time_s, 20.0 * unit, START_S + 0.2, CONFIG)
    assert read.Ti_s == pytest.approx(0.3 * np.log(1 / 0.9) - 0.2, abs=1e-3)


@given(
    y=st.lists(st.floats(-3.0, 3.0).map(lambda x: round(x, 2)), min_size=6, max_size=60),
    move=st.integers(0, 59),
    mode=st.sampled_from(["interpolated", "nearest"]),
)
def test_any_record_gives_two_times_in_order_or_a_reason(y, move, mode):
    """Also pure noise, with the check for settled parts as good as off."""
    time_s = np.arange(len(y)) * 0.25
    t0_s = time_s[min(move, len(y) - 1)]
    config = TransientConfig(reading=mode, least_response=0.0, drift_share=1e9)
    read = measure_transient(time_s, np.array(y), t0_s, config)
    if read.reason is None:
        assert time_s[0] <= read.t10_s <= read.t90_s <= time_s[-1]
        assert read.Ti_s == read.t10_s - t0_s
        assert read.response == read.after - read.before
    else:
        assert np.isnan(read.t10_s)
        assert np.isnan(read.t90_s)


def not_assessable(reason, y, time_s=None, t0_s=START_S, config=CONFIG):
    time_s = np.arange(len(y)) * 0.1 if time_s is None else time_s
    read = measure_transient(time_s, np.asarray(y, dtype=float), t0_s, config)
    assert read.reason == reason
    assert np.isnan([read.t10_s, read.t90_s, read.Ti_s, read.Tt_s]).all()


def test_small_response_is_not_assessable():
    _, unit = first_order(0.5, dt_s=0.1)
    not_assessable("response 1.2 % is below 5 %", 60.0 + 1.2 * unit)


def test_no_response_is_not_assessable_even_without_a_least_response():
    config = TransientConfig(least_response=0.0)
    not_assessable("response 0 % is below 0 %", np.full(100, 60.0), config=config)


def test_missing_samples_in_the_window_are_not_assessable_and_earlier_ones_do_not_matter():
    time_s, unit = first_order(0.5, dt_s=0.1)
    y = 20.0 * unit
    y[:5] = np.nan
    assert measure_transient(time_s, y, START_S, CONFIG).reason is None
    y[40:43] = np.nan
    window = len(y) - 10
    not_assessable(f"3 of {window} samples are missing", y)


def test_response_still_moving_at_the_end_is_not_assessable():
    time_s, unit = first_order(2.0, dt_s=0.1, stop_s=3.0)
    not_assessable("not settled at the end: still moving by 1.5 %", 20.0 * unit, time_s)


def test_response_moving_before_the_lever_is_not_assessable():
    time_s, unit = first_order(0.5, dt_s=0.1)
    drifting = 20.0 * unit - 5.0 * np.minimum(time_s - START_S, 0.0)
    not_assessable("not settled before the move: still moving by 2.5 %", drifting)


def test_too_short_a_beginning_and_end_are_not_assessable():
    _, unit = first_order(0.5, dt_s=0.1)
    not_assessable("only 1 sample up to the move, 3 are needed", [60.0], t0_s=0.0)
    not_assessable("only 2 samples up to the move, 3 are needed", 20.0 * unit, t0_s=0.1)
    not_assessable("only 2 samples at the end, 3 are needed", np.arange(23.0))
    not_assessable("the event lasts 0.5 s, less than the settled part's 1 s", np.arange(26.0))


def test_arrays_that_do_not_belong_together_are_refused():
    time_s = np.arange(5.0)
    with pytest.raises(
        DataError,
        match=r"^expected time and response of one shape \(time,\), got "
        r"\(5,\) and \(4,\)$",
    ):
        measure_transient(time_s, np.zeros(4), 1.0, CONFIG)
    with pytest.raises(
        DataError, match=r"^expected at least 1 sample of strictly increasing time$"
    ):
        measure_transient(time_s[::-1].copy(), np.zeros(5), 1.0, CONFIG)
    with pytest.raises(
        DataError, match=r"^the lever moves at 9 s, outside the record from 0 to 4 s$"
    ):
        measure_transient(time_s, np.zeros(5), 9.0, CONFIG)


@pytest.mark.parametrize("mode", ["interpolated", "nearest"])
@pytest.mark.parametrize("hits", [(LOW,), (HIGH,), (LOW, HIGH), (LOW, LOW, HIGH, HIGH)])
def test_a_sample_on_the_level_itself_is_the_crossing(mode, hits):
    """Noise-free logs do hit a level exactly, and stay there."""
    share = np.array(sorted([0.0, 0.0, 0.05, 0.5, 0.97, 1.0, 1.0, *hits]))
    time_s = 0.25 * np.arange(len(share))
    found = low_and_high_crossing(time_s, share, 1, 0.0, mode)
    for level, at_s in zip((LOW, HIGH), found, strict=True):
        if level in hits:
            assert at_s == pytest.approx(time_s[share == level][0])


@given(st.lists(st.integers(0, 20), min_size=1, max_size=30))
def test_any_noise_free_response_crosses_both_levels_in_order(steps):
    """In twentieths, so that levels are hit often; the response goes back and forth."""
    share = np.array([0, 0, *steps, 20, 20]) / 20.0
    low_s, high_s = low_and_high_crossing(
        np.arange(len(share), dtype=float), share, 1, 0.0, "interpolated"
    )
    assert 0.0 < low_s <= high_s < len(share) - 1
    assert np.interp([low_s, high_s], np.arange(len(share)), share) == pytest.approx([LOW, HIGH])
