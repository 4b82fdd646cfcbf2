"""From lever to command: what each defect of the linkage does, the schedules, and their map."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.interpolate import PchipInterpolator

from narxcal.atmosphere import air_state
from narxcal.support.errors import ConfigError
from narxcal.turbofan.design import preset
from narxcal.turbofan.lever import (
    LeverParameters,
    _monotone,
    idle,
    n1_command,
    resolver,
)

DT = 1.0 / 32.0
levers = arrays(np.float64, st.integers(1, 60), elements=st.floats(0.0, 85.0))


def slow_play(angle, width):
    """Play as a rope of two stops: what the definition says, sample by sample."""
    out, state = [], float(angle[0])
    for a in angle.tolist():
        if a - state > width / 2:
            state = a - width / 2
        elif state - a > width / 2:
            state = a + width / 2
        out.append(state)
    return np.array(out)


@given(levers)
def test_a_perfect_linkage_leaves_the_lever_untouched(angle):
    read = resolver(angle, DT, LeverParameters())
    np.testing.assert_array_equal(read, angle)
    assert read is not angle


@given(levers, st.floats(0.01, 20.0))
def test_play_is_its_slow_twin_and_stays_within_half_its_width(angle, width):
    read = resolver(angle, DT, LeverParameters(backlash_deg=width))
    np.testing.assert_allclose(read, slow_play(angle, width), atol=1e-12)
    assert np.all(np.abs(read - angle) <= width / 2 + 1e-12)


@given(levers, st.floats(0.01, 20.0))
def test_play_does_not_ask_how_fast_the_lever_moves(angle, width):
    slowly = np.repeat(angle, 3)
    once, thrice = (resolver(a, DT, LeverParameters(width)) for a in (angle, slowly))
    np.testing.assert_array_equal(thrice[2::3], once)


def test_a_reversal_has_to_take_up_the_whole_width():
    angle = np.array([20.0, 30.0, 29.0, 28.0, 27.0, 26.0])
    read = resolver(angle, DT, LeverParameters(backlash_deg=2.0))
    np.testing.assert_allclose(read, [20.0, 29.0, 29.0, 29.0, 28.0, 27.0])


@pytest.mark.parametrize("steps", [1.0, 2.5, 3.25])
def test_a_delay_shifts_a_ramp_by_its_length(steps):
    angle = np.arange(40.0)
    read = resolver(angle, DT, LeverParameters(delay_s=steps * DT))
    np.testing.assert_allclose(read, np.maximum(angle - steps, 0.0), atol=1e-12)


@given(levers, st.floats(1.0, 500.0))
def test_the_rate_is_limited_and_what_is_slower_passes(angle, rate):
    read = resolver(angle, DT, LeverParameters(rate_limit_degps=rate))
    assert np.all(np.abs(np.diff(read)) <= rate * DT * (1.0 + 1e-9) + 1e-12)
    np.testing.assert_array_equal(
        resolver(read, DT, LeverParameters(rate_limit_degps=rate * (1.0 + 1e-6))), read
    )


def test_a_rate_limited_step_is_a_ramp_that_arrives():
    angle = np.where(np.arange(100) < 10, 10.0, 40.0)
    read = resolver(angle, DT, LeverParameters(rate_limit_degps=32.0))
    np.testing.assert_allclose(read[10:39], 11.0 + np.arange(29))
    np.testing.assert_array_equal(read[40:], 40.0)


def test_the_bias_is_on_what_is_read_not_on_the_lever():
    angle = np.linspace(0.0, 85.0, 50)
    crooked = LeverParameters(3.0, 0.1, 60.0)
    np.testing.assert_allclose(
        resolver(angle, DT, crooked._replace(bias_deg=-1.5)),
        resolver(angle, DT, crooked) - 1.5,
    )


# --- ratings ---

BUSINESS_JET, SINGLE_AISLE = (preset(name).ratings for name in ("business_jet", "single_aisle"))
PRESETS = pytest.mark.parametrize("ratings", [BUSINESS_JET, SINGLE_AISLE])
TAKE_OFF_DEG = 85.0


def at(tra=0.0, alt=0.0, mach=0.0, dt=0.0, wow=0.0, approach=0.0, bleeds=(0.0, 0.0, 0.0)):  # noqa: PLR0917
    """Inputs (..., 9) of any broadcastable arguments."""
    return np.stack(
        np.broadcast_arrays(*map(np.asarray, (tra, alt, mach, dt, wow, approach, *bleeds))), axis=-1
    ).astype(float)


conditions = st.tuples(
    st.floats(0.0, 42000.0),
    st.floats(0.0, 0.85),
    st.floats(-30.0, 30.0),
    st.sampled_from([0.0, 1.0]),
    st.sampled_from([0.0, 1.0]),
    st.tuples(*[st.sampled_from([0.0, 1.0])] * 3),
)


@PRESETS
@given(condition=conditions)
def test_more_lever_never_means_less_speed(ratings, condition):
    command = n1_command(ratings, at(np.linspace(0.0, TAKE_OFF_DEG, 200), *condition))
    assert np.all(np.diff(command) >= -1e-9)
    assert np.all(command <= ratings.N1_max_pct + 1e-9)


@PRESETS
@given(condition=conditions)
def test_the_map_has_no_corners(ratings, condition):
    """Its slope is continuous: halving the spacing halves the largest change of slope."""

    def largest(count):
        lever = np.linspace(0.0, TAKE_OFF_DEG, count)
        slope = np.diff(n1_command(ratings, at(lever, *condition))) / (lever[1] - lever[0])
        return np.max(np.abs(np.diff(slope)))

    assert largest(1601) <= 0.6 * largest(801) + 1e-6


@PRESETS
def test_the_detents_give_the_ratings(ratings):
    expected = [
        ratings.flight_idle_pct,
        ratings.cruise_pct[0],
        ratings.climb_pct[0],
        ratings.take_off_pct[0],
    ]
    np.testing.assert_allclose(n1_command(ratings, at(ratings.detents_deg)), expected, rtol=1e-14)
    beyond = n1_command(ratings, at([-5.0, 90.0]))
    np.testing.assert_allclose(beyond, [expected[0], expected[-1]], rtol=1e-14)


@PRESETS
def test_take_off_is_flat_to_the_corner_and_falls_beyond(ratings):
    warm = np.array([-30.0, 0.0, 15.0, 16.0, 25.0])
    physical = n1_command(ratings, at(TAKE_OFF_DEG, dt=warm))
    corrected = physical / np.sqrt(air_state(0.0, 0.0, warm).theta2)
    np.testing.assert_allclose(corrected[:3], ratings.take_off_pct[0], rtol=1e-13)
    np.testing.assert_allclose(np.diff(corrected[2:]), [-0.28, -2.52], rtol=1e-9)
    assert np.all(np.diff(physical[:3]) > 0.0)
    assert np.all(np.diff(physical[2:]) < 0.0)


@PRESETS
def test_bleeds_take_from_high_power_only(ratings):
    levers = np.array([0.0, 30.0, 58.0, 85.0])
    for which in np.eye(3):
        loss = n1_command(ratings, at(levers)) - n1_command(ratings, at(levers, bleeds=which))
        assert loss[0] == 0.0
        assert np.all(np.diff(loss[:3]) > 0.0)
        assert np.all((loss[2:] >= 0.4) & (loss[2:] <= 0.8))  # A32NX


@PRESETS
def test_idles_are_ordered_and_rise_with_height_and_mach(ratings):
    ground, flight, approach = (
        float(n1_command(ratings, at(wow=w, approach=a))) for w, a in ((1, 0), (0, 0), (0, 1))
    )
    assert ground < flight < approach
    assert n1_command(ratings, at(wow=1, approach=1)) == ground
    high = idle(ratings, at(alt=35000.0, mach=0.78))
    assert flight + 10.0 < high < ratings.cruise_pct[0]


@PRESETS
def test_effects_are_parameters(ratings):
    warmed = dataclasses.replace(ratings, temperature_bias_pct_per_C=0.05)
    difference = n1_command(warmed, at(60.0, dt=-20.0)) - n1_command(ratings, at(60.0, dt=-20.0))
    assert difference == pytest.approx(-1.0)
    shifted = dataclasses.replace(ratings, approach_idle_pct=ratings.approach_idle_pct + 2.0)
    for approach, shift in ((0.0, 0.0), (1.0, 2.0)):
        u = at(approach=approach)
        assert n1_command(shifted, u) - n1_command(ratings, u) == pytest.approx(shift)


@PRESETS
def test_the_command_is_a_pure_function_of_any_shape(ratings):
    u = at(np.linspace(0, 85, 12).reshape(3, 4), np.linspace(0, 4e4, 4), 0.5)
    whole = n1_command(ratings, u)
    assert whole.shape == (3, 4)
    single = [[float(n1_command(ratings, u[i, j])) for j in range(4)] for i in range(3)]
    np.testing.assert_array_equal(whole, single)


@pytest.mark.parametrize("column", range(9))
def test_what_is_no_number_gives_none(column):
    u = at(40.0, 10000.0, 0.4)
    u[column] = np.nan
    assert np.isnan(n1_command(SINGLE_AISLE, u))


def test_the_map_is_scipys_where_knots_are_even():
    knots, values = np.arange(4.0), np.array([0.0, 1.0, 5.0, 6.0])
    x = np.linspace(1.0, 2.0, 30)  # the inner piece: the ends are closed otherwise
    np.testing.assert_allclose(
        _monotone(x, knots, np.repeat(values[:, None], 30, axis=1)),
        PchipInterpolator(knots, values)(x),
        atol=1e-12,
    )


def test_a_disordered_idle_is_refused():
    with pytest.raises(ConfigError, match="ground idle <= flight idle <= approach idle, found"):
        dataclasses.replace(BUSINESS_JET, approach_idle_pct=20.0)
