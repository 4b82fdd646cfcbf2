"""Manoeuvres: closed forms and continuity."""

import math
import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.signal import chirp

from narxcal.flight_test.manoeuvres import (
    HAND_DEG_S,
    SLAM_DEG_S,
    Corners,
    Sweep,
    Switched,
    doublet,
    hold,
    ladder,
    reslam,
    reversals,
    sequence,
    switch,
    three_two_one_one,
    travel,
)
from narxcal.support.errors import ConfigError

DT = 1 / 32
TIME_S = np.arange(0, 40 * 32) * DT

angles = st.floats(-40.0, 40.0)
rates = st.floats(1.0, HAND_DEG_S)
small = st.floats(1.0, 10.0)
pieces = st.one_of(
    st.builds(hold, st.floats(0.1, 10.0)),
    st.builds(travel, angles, rates),
    st.builds(doublet, small, st.floats(2.0, 5.0)),
    st.builds(three_two_one_one, small, st.floats(2.0, 5.0)),
    st.builds(reversals, small, rates, st.integers(1, 4)),
    st.builds(reslam, small, st.floats(0.5, 3.0)),
    st.builds(lambda sizes: ladder(sizes, 6.0), st.lists(small, min_size=1, max_size=4)),
    st.builds(switch, st.sampled_from(["ECS", "NAI"]), st.floats(1.0, 9.0), st.just(20.0)),
)
parts = st.lists(pieces, min_size=1, max_size=6)


def fastest_deg_s(piece):
    time_s = np.arange(0.0, piece.duration_s, 1e-3)
    return np.abs(np.diff(piece.swing_deg(time_s))).max() / 1e-3


@pytest.mark.parametrize("by_deg", [60.0, -60.0])
def test_a_push_and_a_pull_go_at_the_stated_rate(by_deg):
    piece = travel(by_deg, SLAM_DEG_S)
    assert piece.net_deg == by_deg
    assert piece.duration_s == 60.0 / SLAM_DEG_S
    assert fastest_deg_s(piece) == pytest.approx(SLAM_DEG_S)


def test_a_three_two_one_one_stands_for_its_units():
    unit, rate = 4.0, 40.0
    piece = three_two_one_one(8.0, unit, rate)
    ends = np.cumsum([3, 2, 1, 1, 1]) * unit
    np.testing.assert_allclose(piece.swing_deg(ends - 1e-9), [8.0, -8.0, 8.0, -8.0, 0.0])
    assert piece.duration_s == 8 * unit


def test_a_ladder_goes_out_to_each_size_and_back():
    piece = ladder((5.0, 10.0, 20.0), stay_s=6.0)
    np.testing.assert_allclose(
        piece.swing_deg(np.arange(1, 7) * 6.0 - 1e-9), [5.0, 0.0, 10.0, 0.0, 20.0, 0.0]
    )


def test_reversals_are_a_triangle_wave():
    amplitude, rate, cycles = 3.0, 2.0, 3
    piece = reversals(amplitude, rate, cycles)
    period = 4 * amplitude / rate
    time_s = np.linspace(0.0, cycles * period, 997)
    expected = 2 * amplitude / math.pi * np.arcsin(np.sin(2 * math.pi * time_s / period))
    np.testing.assert_allclose(piece.swing_deg(time_s), expected, atol=1e-9)
    assert fastest_deg_s(piece) == pytest.approx(rate)


def test_a_reslam_comes_back_before_the_engine_can_settle():
    piece = reslam(50.0, pause_s=1.5)
    low = np.flatnonzero(piece.swing_deg(TIME_S) == -50.0)
    assert len(low) * DT == pytest.approx(1.5, abs=2 * DT)
    assert piece.net_deg == 0.0


def test_a_sweep_has_the_closed_form_phase_over_whole_cycles():
    piece = Sweep(4.0, low_hz=0.05, high_hz=1.0, wanted_s=60.0)
    time_s = np.arange(0.0, piece.duration_s, DT)
    # SciPy's chirp is a cosine: a quarter turn later.
    expected = 4.0 * chirp(time_s, 0.05, piece.duration_s, 1.0, "logarithmic", phi=-90)
    np.testing.assert_allclose(piece.swing_deg(time_s), expected, atol=1e-9)
    assert piece.swing_deg(np.array([piece.duration_s - 1e-9])) == pytest.approx(0.0, abs=1e-6)
    assert piece.duration_s == pytest.approx(60.0, rel=0.05)
    assert fastest_deg_s(piece) <= 2 * math.pi * 1.0 * 4.0


def test_a_switch_flips_while_the_lever_rests():
    piece = switch("NAI", on_s=10.0, after_s=20.0)
    assert piece.switched == (Switched("NAI", 5.0, 15.0),)
    assert not piece.swing_deg(TIME_S).any()


def test_a_sequence_carries_its_switches_along():
    both = sequence(
        travel(10.0, 5.0), switch("ECS", 4.0, 20.0), hold(3.0), switch("NAI", 2.0, 20.0)
    )
    flips = {flip.channel: (flip.start_s, flip.stop_s) for flip in both.switched}
    assert flips == {"ECS": (7.0, 11.0), "NAI": (39.0, 41.0)}


@given(parts)
def test_joined_manoeuvres_are_continuous_and_within_rate_and_reach(parts):
    joined = sequence(*parts)
    time_s = np.linspace(-1.0, joined.duration_s + 1.0, 4001)
    moved = joined.swing_deg(time_s)
    dt = time_s[1] - time_s[0]
    assert np.abs(np.diff(moved)).max() <= HAND_DEG_S * dt * (1 + 1e-6) + 1e-9
    low, high = joined.reach_deg
    assert low <= 0.0 <= high
    assert moved.min() >= low - 1e-9
    assert moved.max() <= high + 1e-9
    assert moved[0] == 0.0
    assert moved[-1] == pytest.approx(joined.net_deg, abs=1e-9)


@given(parts)
def test_a_sequence_is_its_parts_one_after_another(parts):
    joined, start, level = sequence(*parts), 0.0, 0.0
    for part in parts:
        within = np.linspace(0.0, part.duration_s, 50)
        np.testing.assert_allclose(
            joined.swing_deg(start + within), level + part.swing_deg(within), atol=1e-6
        )
        start, level = start + part.duration_s, level + part.net_deg
    assert joined.duration_s == pytest.approx(start)


@pytest.mark.parametrize(
    ("points", "message"),
    [
        (((0.0, 0.0), (2.0, 1.0), (1.0, 1.0)), "be in order of time"),
        (((1.0, 0.0),), "corner points have to begin at (0, 0)"),
        ((), "corner points have to begin at (0, 0)"),
    ],
)
def test_corners_out_of_order_are_refused(points, message):
    with pytest.raises(ConfigError, match=re.escape(message)):
        Corners(points)
