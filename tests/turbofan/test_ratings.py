"""The schedules: order, flat rating, bleeds, idles, and a map without corners."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.interpolate import PchipInterpolator

from narxcal.atmosphere import air_state
from narxcal.support.errors import ConfigError
from narxcal.turbofan.ratings import BUSINESS_JET, SINGLE_AISLE, _monotone, idle, n1_command

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


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"detents_deg": (0.0, 50.0, 50.0, 85.0)}, "'detents_deg' has to ascend, found"),
        ({"altitude_ft": (0.0, 1.0, 3.0, 2.0, 5.0)}, "'altitude_ft' has to ascend, found"),
        ({"climb_pct": (90.0, 91.0)}, "'climb_pct' has to have a value for each of the 5"),
        ({"cruise_pct": (99.0,) * 5}, "expected cruise <= climb <= take-off at every altitude"),
        ({"approach_idle_pct": 20.0}, "ground idle <= flight idle <= approach idle, found"),
    ],
)
def test_disordered_schedules_are_refused(change, message):
    with pytest.raises(ConfigError, match=message):
        dataclasses.replace(BUSINESS_JET, **change)
