"""Levers on a raster: placing, stops, the hand's rate, and the difference between two levers."""

import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from narxcal.flight_test.manoeuvres import (
    Sweep,
    hold,
    impulse,
    step,
    switch,
    travel,
)
from narxcal.flight_test.pilot import TAKE_OFF_DEG, Placed, compose, flips, rate_limited, set_apart
from narxcal.support.errors import ConfigError

DT = 1 / 32
RASTER = np.arange(0, 60 * 32) * DT
PLACED = [Placed(3.3, travel(40.0, 30.0)), Placed(20.0, Sweep(3.0, 0.1, 0.5, 20.0))]


def test_manoeuvres_begin_where_the_lever_stands():
    angle = compose([*PLACED, Placed(50.0, travel(-45.0, 60.0))], RASTER, 10.0)
    slow_twin = 10.0 + sum(
        item.manoeuvre.swing_deg(RASTER - item.start_s)
        for item in [*PLACED, Placed(50.0, travel(-45.0, 60.0))]
    )
    np.testing.assert_allclose(angle, slow_twin, atol=1e-9)
    assert angle[0] == 10.0
    assert angle[-1] == pytest.approx(5.0)


def test_the_order_of_placing_does_not_matter():
    np.testing.assert_array_equal(
        compose(PLACED, RASTER, 10.0), compose(PLACED[::-1], RASTER, 10.0)
    )


def test_a_one_sample_impulse_survives_the_raster():
    angle = compose([Placed(2.0, impulse(8.0, DT))], RASTER, 20.0)
    np.testing.assert_array_equal(np.flatnonzero(angle != 20.0), [96])
    assert angle[96] == 28.0


def test_a_hand_turns_a_step_into_a_ramp():
    angle = compose([Placed(2.0, step(50.0))], RASTER, 20.0, hand_deg_s=160.0)
    assert np.diff(angle).max() == pytest.approx(160.0 * DT)
    assert angle[-1] == 70.0
    np.testing.assert_allclose(
        angle, np.clip(20.0 + 160.0 * (RASTER - 3.0 + DT), 20.0, 70.0), atol=1e-9
    )


@given(st.lists(st.floats(0.0, 85.0), min_size=2, max_size=50), st.floats(0.1, 100.0))
@settings(max_examples=100, deadline=None)
def test_a_limited_rate_is_kept_and_what_is_slower_is_untouched(angles, most):
    wanted = np.array(angles)
    followed = rate_limited(wanted, most)
    assert np.abs(np.diff(followed)).max() <= most * (1 + 1e-9) + 1e-12
    assert followed[0] == wanted[0]
    np.testing.assert_array_equal(rate_limited(wanted, 1000.0), wanted)


@given(st.integers(0, 10_000))
@settings(max_examples=30, deadline=None)
def test_two_levers_stand_a_degree_apart_at_most_and_only_part_while_they_move(seed):
    random = np.random.default_rng(seed)
    meant = compose(PLACED, RASTER, 0.0)
    left, right = set_apart(meant, random), set_apart(meant, random)
    assert np.abs(left - right).max() <= 1.0
    for lever in (left, right):
        assert lever.min() >= 0.0
        assert lever.max() <= TAKE_OFF_DEG
        assert lever[0] == 0.0  # both at the stop
        np.testing.assert_array_equal(np.diff(lever)[np.diff(meant) == 0.0], 0.0)


def test_switches_are_moved_to_where_the_manoeuvre_is_placed():
    (flip,) = flips([Placed(100.0, switch("WAI", 10.0, before_s=5.0))])
    assert (flip.channel, flip.start_s, flip.stop_s) == ("WAI", 105.0, 115.0)


@pytest.mark.parametrize(
    ("placed", "message"),
    [
        (
            [Placed(1.0, hold(5.0)), Placed(4.0, hold(1.0))],
            "a manoeuvre begins at 4.00 s, before the one from 1.00 s has ended at 6.00 s",
        ),
        (
            [Placed(1.0, travel(70.0, 70.0))],
            "the lever would go to 85.62 deg at 1.94 s, and its stops are at 0 and 85 deg",
        ),
        ([Placed(1.0, travel(-30.0, 16.0))], "the lever would go to -0.50 deg"),
    ],
)
def test_manoeuvres_that_overlap_or_pass_a_stop_are_refused(placed, message):
    with pytest.raises(ConfigError, match=re.escape(message)):
        compose(placed, RASTER, 20.0)
