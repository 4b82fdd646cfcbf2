"""Lags, delays, play and limits of rate against closed forms and loops written out."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from narxcal.effects.operators import delay, lag, play, rate_limit, smooth_delay, smooth_lag

DT = 0.125
PARTS = {
    "lag": lambda x: lag(x, np.array([0.0, 0.05, 2.0]), DT),
    "delay": lambda x: delay(x, np.array([0.0, 0.3, 1.0]), DT),
    "smooth lag": lambda x: smooth_lag(x, np.array([0.0, 0.05, 2.0]), DT),
    "smooth delay": lambda x: smooth_delay(x, np.array([0.0, 0.3, 1.0]), DT),
    "play": lambda x: play(x, np.array([0.0, 0.5, 3.0])),
    "limit": lambda x: rate_limit(x, np.array([0.5, 4.0, np.inf]), DT),
}


def walk(steps=200, rows=3, seed=0):
    return np.cumsum(np.random.default_rng(seed).normal(size=(rows, steps)), axis=1)


def over(operator, x, parameter, *dt_s):
    """An operator of one parameter over one signal."""
    return operator(np.atleast_2d(x), np.array([parameter]), *dt_s)[0]


@pytest.mark.parametrize("part", PARTS.values(), ids=PARTS)
def test_what_comes_later_changes_nothing_before(part):
    x = walk()
    y = x.copy()
    y[:, 120:] += 5.0
    np.testing.assert_array_equal(part(x)[:, :120], part(y)[:, :120])


@pytest.mark.parametrize("part", PARTS.values(), ids=PARTS)
def test_at_rest_they_stay_at_rest(part):
    x = np.full((3, 50), 7.25)
    np.testing.assert_allclose(part(x), x, rtol=1e-14)


@pytest.mark.parametrize("tau", [0.02, 0.2, 3.0, 60.0])
def test_a_lag_follows_a_ramp_as_the_equation_says(tau):
    t, slope = DT * np.arange(400), 3.0
    found = over(lag, slope * t, tau, DT)
    np.testing.assert_allclose(found, slope * (t - tau * (1.0 - np.exp(-t / tau))), atol=1e-10)


def test_a_lag_is_the_loop_written_out():
    tau, x = 0.7, walk(rows=1)[0]
    y = [x[0]]
    for k in range(1, len(x)):
        behind = tau * (x[k] - x[k - 1]) / DT
        y.append(x[k] - behind + np.exp(-DT / tau) * (y[-1] - x[k - 1] + behind))
    np.testing.assert_allclose(over(lag, x, tau, DT), y, atol=1e-12)


def test_a_lag_of_nothing_changes_not_a_bit():
    np.testing.assert_array_equal(lag(walk(), np.zeros(3), DT), walk())


def test_a_delay_of_whole_samples_is_a_shift():
    x = walk()
    found = delay(x, np.array([4 * DT, 4 * DT, 0.0]), DT)
    np.testing.assert_array_equal(found[:2, 4:], x[:2, :-4])
    np.testing.assert_array_equal(found[:2, :4], np.repeat(x[:2, :1], 4, axis=1))
    np.testing.assert_array_equal(found[2], x[2])


def test_a_delay_lies_on_straight_lines_between_samples():
    x = walk(rows=1)[0]
    t = DT * np.arange(len(x))
    found = over(delay, x, 0.33, DT)
    np.testing.assert_allclose(found, np.interp(t - 0.33, t, x), atol=1e-12)


@pytest.mark.parametrize("tau", [0.02, 0.1, 0.6, 2.0])
def test_a_smooth_lag_follows_a_parabola_as_the_equation_says(tau):
    """Of `x = t^2` the settled lag is `t^2 - 2 tau t + 2 tau^2`."""
    t = DT * np.arange(600)
    found = over(smooth_lag, t**2, tau, DT)
    settled = t > 25.0 * tau + 1.0
    expected = t**2 - 2.0 * tau * t + 2.0 * tau**2
    np.testing.assert_allclose(found[settled], expected[settled], rtol=1e-9)


@pytest.mark.parametrize("delay_s", [0.0, 0.05, 0.3, 0.5, 1.99])
def test_a_smooth_delay_moves_a_cubic_by_itself(delay_s):
    t = DT * np.arange(100)
    found = over(smooth_delay, t**3 - 4.0 * t**2, delay_s, DT)
    late = t - delay_s
    np.testing.assert_allclose(found[60:], (late**3 - 4.0 * late**2)[60:], rtol=1e-9)


def test_a_smooth_delay_does_not_overshoot_a_step():
    step = np.repeat([0.0, 1.0], 20)
    found = over(smooth_delay, step, 0.7 * DT, DT)
    assert (np.diff(found) >= 0.0).all()
    assert (found.min(), found.max()) == (0.0, 1.0)


@pytest.mark.parametrize("tau", [0.03, 0.06, 0.1])
def test_a_short_lag_and_a_short_delay_of_means_over_samples_are_told_apart(tau):
    """What is lagged or late at a fine raster, then averaged, is nearer to its own kind."""
    fine, random = 16, np.random.default_rng(1)
    t = DT / fine * np.arange(400 * fine)
    x = sum(
        np.sin(2 * np.pi * f * t + p) / f
        for f, p in zip((0.1, 0.3, 0.6), random.random(3), strict=True)
    )

    def means(values):
        return values.reshape(-1, fine).mean(axis=1)[10:]

    truths = means(over(lag, x, tau, DT / fine)), means(np.interp(t - tau, t, x))
    kinds = smooth_lag, smooth_delay
    off = np.array(
        [
            [np.std(over(kind, means(x), tau, DT)[5:] - truth[5:]) for kind in kinds]
            for truth in truths
        ]
    )
    assert off[0, 0] < 0.5 * off[0, 1]
    assert off[1, 1] < 0.5 * off[1, 0]


def test_play_is_the_loop_written_out():
    half, x = 0.4, walk(rows=1)[0]
    y = [x[0]]
    for value in x[1:]:
        if value - half > y[-1]:
            y.append(value - half)
        elif value + half < y[-1]:
            y.append(value + half)
        else:
            y.append(y[-1])
    np.testing.assert_array_equal(over(play, x, 2 * half), y)


@settings(max_examples=15)
@given(st.floats(0.1, 3.0), st.integers(1, 12))
def test_play_does_not_know_how_fast_it_is_pushed(width, slower):
    corners = np.array([0.0, 5.0, 1.0, 4.0, -3.0, 2.0])
    fine = np.interp(np.linspace(0, 5, 1 + 5 * slower), np.arange(6), corners)
    slow = over(play, fine, width)[::slower]
    np.testing.assert_allclose(slow, over(play, corners, width), atol=1e-12)


def test_a_limit_of_rate_ramps_a_step_and_leaves_the_slow_alone():
    t = DT * np.arange(80)
    step = over(rate_limit, 5.0 * (t > 0.0), 2.0, DT)
    np.testing.assert_allclose(step, np.minimum(2.0 * t, 5.0), atol=1e-12)
    slow = 1.9 * t
    np.testing.assert_array_equal(over(rate_limit, slow, 2.0, DT), slow)


def test_a_limit_of_rate_is_never_passed():
    y = rate_limit(walk(), np.array([0.5, 4.0, 1.0]), DT)
    assert np.all(np.abs(np.diff(y)) <= np.array([[0.5], [4.0], [1.0]]) * DT + 1e-12)


def test_each_row_has_its_own_parameter():
    taus, x = np.array([0.5, 0.0, 2.0, 0.5]), walk(rows=4)
    together = lag(x, taus, DT)
    for j, tau in enumerate(taus):
        np.testing.assert_array_equal(together[j], over(lag, x[j], tau, DT))
