"""The fuel's way: closed forms of each part alone, and of all in series."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from narxcal.turbofan.fadec import METERED, FuelValveParameters, steady_valve, valve_step

DT = 0.015
NOTHING = FuelValveParameters(0.0, math.inf, 0.0, 0.0, 0.0)


def run(parameters, demand, dt_s=DT, start=None):
    """Metered and burned fuel, (2, time), at the end of each step."""
    state = steady_valve(parameters, demand[0] if start is None else start, dt_s)
    out = []
    for value in demand:
        burned = valve_step(parameters, state, float(value), dt_s)
        out.append((state[METERED], burned))
    return np.array(out).T


def times(count, dt_s=DT):
    return dt_s * np.arange(1, count + 1)


def test_nothing_in_the_way_passes_the_demand_on():
    demand = np.array([1.0, 3.0, 2.0, 0.5])
    metered, burned = run(NOTHING, demand)
    np.testing.assert_array_equal(metered, demand)
    np.testing.assert_array_equal(burned, demand)


@given(st.floats(0.01, 3.0))
def test_a_settled_valve_stays_exactly_where_it_is(fuel):
    every = FuelValveParameters(0.1, 0.5, 0.04, 0.03, 0.05)
    metered, burned = run(every, np.full(30, fuel))
    np.testing.assert_array_equal(metered, fuel)
    np.testing.assert_allclose(burned, fuel, rtol=1e-14)


def test_the_valve_answers_a_step_like_a_first_order_lag():
    metered, burned = run(NOTHING._replace(tau_s=0.1), np.full(60, 2.0), start=1.0)
    np.testing.assert_allclose(metered, 2.0 - np.exp(-times(60) / 0.1), atol=1e-13)
    np.testing.assert_array_equal(burned, metered)


def test_a_step_too_large_for_the_slew_is_a_ramp_first():
    metered, _ = run(NOTHING._replace(tau_s=0.1, slew_kgps2=1.0), np.full(200, 2.0), start=1.0)
    t = times(200)
    expected = np.where(t < 0.9, 1.0 + t, 2.0 - 0.1 * np.exp(-(t - 0.9) / 0.1))
    np.testing.assert_allclose(metered, expected, atol=1e-12)


@pytest.mark.parametrize("delay", [0.015, 0.04, 0.0525, 0.3, 0.004])
def test_the_line_delays_by_its_length_whatever_the_step(delay):
    demand = 1.0 + 0.2 * times(80)
    metered, burned = run(NOTHING._replace(delay_s=delay), demand, start=1.0)
    np.testing.assert_array_equal(metered, demand)
    np.testing.assert_allclose(burned, np.maximum(1.0 + 0.2 * (times(80) - delay), 1.0), atol=1e-12)


def test_the_volume_follows_what_arrives():
    _, burned = run(NOTHING._replace(volume_tau_s=0.2), np.full(80, 2.0), start=1.0)
    t = times(80)
    # The demand is taken to rise over the first step, so that what arrives has no edge.
    first = 2.0 - 0.2 / DT + math.exp(-DT / 0.2) * (0.2 / DT)
    np.testing.assert_allclose(burned, 2.0 - (2.0 - first) * np.exp(-(t - DT) / 0.2), atol=1e-12)


def test_in_series_all_of_it_is_the_textbook_response():
    tau, delay, volume, dt = 0.1, 0.04, 0.05, 0.0005
    parameters = FuelValveParameters(tau, math.inf, delay, volume)
    _, burned = run(parameters, np.full(2000, 2.0), dt, start=1.0)
    t = np.maximum(times(2000, dt) - delay, 0.0)
    exact = 2.0 - (tau * np.exp(-t / tau) - volume * np.exp(-t / volume)) / (tau - volume)
    np.testing.assert_allclose(burned, exact, atol=2e-5)


def test_halving_the_step_hardly_changes_the_response():
    parameters = FuelValveParameters(0.1, 2.0, 0.04, 0.02)
    coarse = run(parameters, np.full(40, 1.6), DT, start=1.0)[1]
    fine = run(parameters, np.full(160, 1.6), DT / 4, start=1.0)[1][3::4]
    assert np.max(np.abs(coarse - fine)) < 0.01


def test_a_slower_servo_lags_further():
    quick, slow = (
        run(FuelValveParameters(servo_tau_s=tau), np.full(40, 2.0), start=1.0)[0]
        for tau in (0.0, 0.2)
    )
    assert np.all(slow < quick)


def test_what_flows_in_flows_out():
    """Fuel is only delayed: after a pulse the burned total is the metered total."""
    demand = np.where(np.arange(400) < 50, 2.0, 1.0)
    metered, burned = run(FuelValveParameters(0.1, 3.0, 0.0475, 0.05), demand, start=1.0)
    assert np.sum(burned - 1.0) == pytest.approx(np.sum(metered - 1.0), rel=1e-9)
