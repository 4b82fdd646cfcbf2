"""Lags against their closed forms and a slow twin; the table against numpy."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from narxcal.support.compiled import lag_share, lagged, ramp_lagged, slewed, table_value

SLOW = 20000  # Euler steps of the slow twin
finite = st.floats(-10.0, 10.0)
taus = st.floats(0.01, 5.0)


def euler(y, rate, dt_s):
    """Slow twin: explicit Euler in very small steps; `rate` is given y and time."""
    h = dt_s / SLOW
    for k in range(SLOW):
        y += h * rate(y, k * h)
    return y


def test_a_lag_covers_the_textbook_share_and_none_means_none():
    assert lag_share(2.0, 2.0) == pytest.approx(1.0 - math.exp(-1.0), rel=1e-15)
    assert lag_share(0.0, 0.1) == 1.0
    assert lagged(3.0, 7.0, 0.0, 0.1) == 7.0
    assert ramp_lagged(3.0, (1.0, 7.0), 0.0, 0.1) == 7.0


@given(finite, finite, taus, st.floats(0.01, 1.0))
def test_many_short_steps_are_one_long_step(y, target, tau, dt):
    short = y
    for _ in range(8):
        short = lagged(short, target, tau, dt / 8)
    assert short == pytest.approx(lagged(y, target, tau, dt), abs=1e-12)


@given(finite, finite, finite, taus)
def test_a_ramp_may_be_cut_anywhere(y, start, end, tau):
    middle = start + 0.3 * (end - start)
    there = ramp_lagged(y, (start, middle), tau, 0.3)
    cut = ramp_lagged(there, (middle, end), tau, 0.7)
    assert cut == pytest.approx(ramp_lagged(y, (start, end), tau, 1.0), abs=1e-9)


def test_a_ramp_is_followed_as_its_differential_equation_says():
    slow = euler(1.0, lambda y, t: (2.0 + 3.0 * t - y) / 0.4, 1.0)
    assert ramp_lagged(1.0, (2.0, 5.0), 0.4, 1.0) == pytest.approx(slow, abs=1e-4)


@pytest.mark.parametrize("dt", [0.05, 0.5, 3.0])
@pytest.mark.parametrize("target", [1.3, 4.0, -3.0])
def test_a_slewing_lag_solves_its_differential_equation(target, dt):
    tau, slew = 0.5, 2.0
    slow = euler(1.0, lambda y, _: min(max((target - y) / tau, -slew), slew), dt)
    assert slewed(1.0, target, (tau, slew), dt) == pytest.approx(slow, abs=2e-4)


@given(finite, finite, st.floats(0.0, 1.0), st.floats(0.1, 9.0))
def test_slewing_keeps_its_limit_and_never_passes_its_target(y, target, tau, slew):
    moved = slewed(y, target, (tau, slew), 0.1) - y
    assert abs(moved) <= slew * 0.1 * (1.0 + 1e-12) + 1e-12
    assert abs(moved) <= abs(target - y) * (1.0 + 1e-12) + 1e-12


def test_no_slew_limit_and_no_lag_is_the_target_itself():
    assert slewed(1.0, 5.0, (0.0, math.inf), 0.1) == 5.0
    assert slewed(1.0, 5.0, (0.3, math.inf), 0.1) == lagged(1.0, 5.0, 0.3, 0.1)
    assert slewed(1.0, 5.0, (0.0, 10.0), 0.1) == pytest.approx(2.0)


@given(st.floats(-5.0, 15.0))
def test_a_table_is_read_as_numpy_reads_it(x):
    knots, values = np.array([0.0, 1.0, 4.0, 9.0]), np.array([2.0, -1.0, 5.0, 5.5])
    assert table_value(x, knots, values) == pytest.approx(np.interp(x, knots, values), abs=1e-12)


def test_a_table_passes_on_what_is_no_number():
    assert math.isnan(table_value(math.nan, np.array([0.0, 1.0]), np.array([2.0, 3.0])))
