"""The pilot: levers over time, their stops, rates and differences, and the set of test points."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from narxcal.flight_test.manoeuvres import (
    HAND_DEG_S,
    SLAM_DEG_S,
    Corners,
    Sweep,
    switch,
    travel,
)
from narxcal.flight_test.pilot import (
    TAKE_OFF_DEG,
    Placed,
    TestLevels,
    compose,
    flips,
    rate_limited,
    separating_set,
    set_apart,
)

DT = 1 / 32
TIME_S = np.arange(0, 60 * 32) * DT
PLACED = [Placed(3.3, travel(40.0, 30.0)), Placed(20.0, Sweep(3.0, 0.1, 0.5, 20.0))]


def test_manoeuvres_begin_where_the_lever_stands():
    angle = compose([*PLACED, Placed(50.0, travel(-45.0, 60.0))], TIME_S, 10.0)
    slow_twin = 10.0 + sum(
        item.manoeuvre.swing_deg(TIME_S - item.start_s)
        for item in [*PLACED, Placed(50.0, travel(-45.0, 60.0))]
    )
    np.testing.assert_allclose(angle, slow_twin, atol=1e-9)
    assert angle[0] == 10.0
    assert angle[-1] == pytest.approx(5.0)


def test_the_order_of_placing_does_not_matter():
    np.testing.assert_array_equal(
        compose(PLACED, TIME_S, 10.0), compose(PLACED[::-1], TIME_S, 10.0)
    )


def test_a_one_sample_impulse_survives_the_raster():
    impulse = Corners(((0.0, 0.0), (1.0, 0.0), (1.0, 8.0), (1.0 + DT, 8.0), (1.0 + DT, 0.0)))
    angle = compose([Placed(2.0, impulse)], TIME_S, 20.0)
    np.testing.assert_array_equal(np.flatnonzero(angle != 20.0), [96])
    assert angle[96] == 28.0


def test_a_hand_turns_a_step_into_a_ramp():
    step = Corners(((0.0, 0.0), (1.0, 0.0), (1.0, 50.0)))
    angle = compose([Placed(2.0, step)], TIME_S, 20.0, hand_deg_s=160.0)
    assert np.diff(angle).max() == pytest.approx(160.0 * DT)
    assert angle[-1] == 70.0
    np.testing.assert_allclose(
        angle, np.clip(20.0 + 160.0 * (TIME_S - 3.0 + DT), 20.0, 70.0), atol=1e-9
    )


@given(st.lists(st.floats(0.0, 85.0), min_size=2, max_size=50), st.floats(0.1, 100.0))
def test_a_limited_rate_is_kept_and_what_is_slower_is_untouched(angles, most):
    wanted = np.array(angles)
    followed = rate_limited(wanted, most)
    assert np.abs(np.diff(followed)).max() <= most * (1 + 1e-9) + 1e-12
    assert followed[0] == wanted[0]
    np.testing.assert_array_equal(rate_limited(wanted, 1000.0), wanted)


@given(st.integers(0, 10_000))
def test_two_levers_stand_a_degree_apart_at_most_and_only_part_while_they_move(seed):
    random = np.random.default_rng(seed)
    meant = compose(PLACED, TIME_S, 0.0)
    left, right = set_apart(meant, random), set_apart(meant, random)
    assert np.abs(left - right).max() <= 1.0
    for lever in (left, right):
        assert lever.min() >= 0.0
        assert lever.max() <= TAKE_OFF_DEG
        assert lever[0] == 0.0  # both at the stop
        np.testing.assert_array_equal(np.diff(lever)[np.diff(meant) == 0.0], 0.0)


def test_switches_are_moved_to_where_the_manoeuvre_is_placed():
    (flip,) = flips([Placed(100.0, switch("WAI", 10.0, after_s=5.0))])
    assert (flip.channel, flip.start_s, flip.stop_s) == ("WAI", 105.0, 115.0)


# Test points

LEVELS = TestLevels(low=5.0, trim=50.0, high=80.0)
POINTS = separating_set(LEVELS)


def angle(name, at=LEVELS):
    point = separating_set(at)[name]
    time_s = np.arange(0.0, point.duration_s + 1.0, DT)
    return compose([Placed(0.0, point)], time_s, at.trim)


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
    slow, fast = (np.abs(np.diff(angle(f"{how} reversals"))).max() for how in ("slow", "fast"))
    assert fast == pytest.approx(10 * slow)


@pytest.mark.parametrize("hold_s", [180.0, 300.0])
def test_the_lever_rests_for_minutes_after_a_large_step(hold_s):
    values = angle("long hold", replace(LEVELS, hold_s=hold_s))
    assert np.round(rests(values, hold_s - 1.0), 6) == [80.0]


def test_bleed_and_anti_ice_are_switched_at_constant_lever():
    for name in ("ECS", "NAI", "WAI"):
        point = POINTS[f"{name} on and off"]
        assert [flip.channel for flip in point.switched] == [name]
        assert point.reach_deg == (0.0, 0.0)


def test_throttle_rates_go_from_slow_to_slam():
    moved = np.diff(angle("throttle rates")) / DT
    found = {rate for rate in (5.0, 15.0, 40.0, 120.0) if np.isclose(moved, rate).any()}
    assert found == {5.0, 15.0, 40.0, 120.0}


@given(st.floats(0.0, 20.0), st.floats(30.0, 60.0), st.floats(65.0, 85.0), st.floats(5.0, 40.0))
def test_every_point_comes_back_to_its_trim_within_the_stops(low, trim, high, stay_s):
    levels = TestLevels(low, trim, high, stay_s=stay_s, hold_s=200.0)
    for name, point in separating_set(levels).items():
        below, above = point.reach_deg
        assert low - 1e-9 <= trim + below
        assert trim + above <= high + 1e-9
        assert point.net_deg == pytest.approx(0.0, abs=1e-9)
        moved = np.diff(angle(name, levels))
        assert np.abs(moved).max() <= HAND_DEG_S * DT
