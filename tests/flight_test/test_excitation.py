"""The set of test points holds what makes effects separable, within the levers' range."""

import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from narxcal.flight_test.manoeuvres import HAND_DEG_S, SLAM_DEG_S
from narxcal.flight_test.pilot import Placed, TestLevels, compose, separating_set
from narxcal.support.errors import ConfigError

DT = 1 / 32
POINTS = {point.name: point for point in separating_set()}


def angle(name, at=None):
    at = at or TestLevels()
    point = {point.name: point for point in separating_set(at)}[name]
    time_s = np.arange(0.0, point.manoeuvre.duration_s + 1.0, DT)
    return compose([Placed(0.0, point.manoeuvre)], time_s, at.trim)


def rests(values, least_s):
    """Angles at which the lever stays for at least `least_s`."""
    still = np.split(values, np.flatnonzero(np.abs(np.diff(values)) > 1e-9) + 1)
    return [float(run[0]) for run in still if len(run) * DT >= least_s]


def test_two_slams_between_idle_and_high_at_slam_rate():
    values = angle("two slams")
    assert np.round(rests(values, 15.0), 6).tolist() == [5.0, 80.0, 5.0, 80.0, 5.0]
    assert np.abs(np.diff(values)).max() == pytest.approx(SLAM_DEG_S * DT)


def test_three_step_sizes():
    assert sorted(np.unique(np.round(rests(angle("three step sizes"), 15.0), 6))) == [
        50.0,
        59.0,
        68.0,
        80.0,
    ]


@pytest.mark.parametrize("name", ["slow reversals", "fast reversals"])
def test_small_reversals_are_two_to_five_percent_about_one_trim(name):
    values = angle(name)
    share = (np.ptp(values) / 2) / 85.0
    assert 0.02 <= share <= 0.05
    assert (values.max() + values.min()) / 2 == pytest.approx(50.0, abs=0.1)


def test_reversals_come_slow_and_fast():
    slow, fast = (POINTS[f"{how} reversals"].manoeuvre.fastest_deg_s for how in ("slow", "fast"))
    assert fast == pytest.approx(10 * slow)


@pytest.mark.parametrize("hold_s", [180.0, 300.0])
def test_the_lever_rests_for_minutes_after_a_large_step(hold_s):
    assert np.round(rests(angle("long hold", TestLevels(hold_s=hold_s)), hold_s - 1.0), 6) == [80.0]


def test_bleed_and_anti_ice_are_switched_at_constant_lever():
    for name in ("ECS", "NAI", "WAI"):
        point = POINTS[f"{name} on and off"]
        assert [flip.channel for flip in point.manoeuvre.switched] == [name]
        assert point.manoeuvre.reach_deg == (0.0, 0.0)


def test_throttle_rates_go_from_slow_to_slam():
    moved = np.diff(angle("throttle rates")) / DT
    found = {rate for rate in (5.0, 15.0, 40.0, 120.0) if np.isclose(moved, rate).any()}
    assert found == {5.0, 15.0, 40.0, 120.0}


@given(st.floats(0.0, 20.0), st.floats(30.0, 60.0), st.floats(65.0, 85.0), st.floats(5.0, 40.0))
@settings(max_examples=40, deadline=None)
def test_every_point_comes_back_to_its_trim_within_the_stops(low, trim, high, stay_s):
    for point in separating_set(TestLevels(low, trim, high, stay_s=stay_s, hold_s=200.0)):
        below, above = point.manoeuvre.reach_deg
        assert low - 1e-9 <= trim + below
        assert trim + above <= high + 1e-9
        assert point.manoeuvre.net_deg == pytest.approx(0.0, abs=1e-9)
        assert point.manoeuvre.fastest_deg_s <= HAND_DEG_S
        assert point.separates


@pytest.mark.parametrize(
    ("levels", "message"),
    [
        ({"low": 60.0}, "rise from low over trim to high within 0 .. 85 deg, got 60, 50, 80"),
        ({"high": 90.0}, "within 0 .. 85 deg, got 5, 50, 90"),
        ({"stay_s": 1.0}, "test points stay at least 5 s, got 1 s"),
    ],
)
def test_levels_out_of_order_are_refused(levels, message):
    with pytest.raises(ConfigError, match=re.escape(message)):
        TestLevels(**levels)
