"""The linkage: neutral values change nothing, each defect does what its definition says."""

import math
import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from narxcal.support.errors import ConfigError
from narxcal.turbofan.lever import LeverParameters, resolver

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


@settings(deadline=None)  # the first example waits for the compiler
@given(levers)
def test_a_perfect_linkage_leaves_the_lever_untouched(angle):
    read = resolver(angle, DT, LeverParameters())
    np.testing.assert_array_equal(read, angle)
    assert read is not angle


@settings(deadline=None)  # the first example waits for the compiler
@given(levers, st.floats(0.01, 20.0))
def test_play_is_its_slow_twin_and_stays_within_half_its_width(angle, width):
    read = resolver(angle, DT, LeverParameters(backlash_deg=width))
    np.testing.assert_allclose(read, slow_play(angle, width), atol=1e-12)
    assert np.all(np.abs(read - angle) <= width / 2 + 1e-12)


@settings(deadline=None)  # the first example waits for the compiler
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


@settings(deadline=None)  # the first example waits for the compiler
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


def test_an_empty_lever_stays_empty():
    assert len(resolver(np.empty(0), DT, LeverParameters(1.0, 1.0, 1.0, 1.0))) == 0


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"backlash_deg": -1.0}, "'backlash_deg' has to be zero or more, found -1.0"),
        ({"delay_s": math.inf}, "'delay_s' has to be zero or more, found inf"),
        ({"rate_limit_degps": 0.0}, "'rate_limit_degps' has to be above zero, found 0.0. Leave"),
        ({"bias_deg": math.nan}, "'bias_deg' has to be finite, found nan"),
    ],
)
def test_an_impossible_linkage_is_refused(change, message):
    with pytest.raises(ConfigError, match=re.escape(message)):
        resolver(np.zeros(3), DT, LeverParameters(**change))


def test_time_has_to_go_on():
    with pytest.raises(ConfigError, match=r"the sampling interval has to be above zero, found 0.0"):
        resolver(np.zeros(3), 0.0, LeverParameters())
