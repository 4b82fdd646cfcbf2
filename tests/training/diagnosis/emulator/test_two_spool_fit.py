"""What temperatures and flows make of core speed at rest, and of power the core has to spare."""

import numpy as np
import pytest

from narxcal.two_spool import FLOW
from training.diagnosis.two_spool_fit import Course, fit_two_spool, working_line

DT = 0.25
LOW, SPAN = 60.0, 40.0
AIR = -0.2
SLOPE = (6.0, 9.0, -4.0, 2.0)  # of EGT over core speed: constant, over x, x^2 and L
POWER, LAG_S = 7.0, 0.8


def on_the_line(core):
    """Temperature at rest at a core speed: the integral of the slope."""
    x = (core - LOW) / SPAN
    flat = SLOPE[0] + SLOPE[3] * AIR
    return 300.0 + SPAN * (flat * x + SLOPE[1] * x**2 / 2.0 + SLOPE[2] * x**3 / 3.0)


def course_of(steady):
    """Flights whose core follows its settled speed behind 1.5 s, the temperature behind a probe.

    Speed still to come and power to spare are then in one proportion throughout.
    """
    core, hot = steady.copy(), np.empty_like(steady)
    for k in range(1, core.shape[1]):
        core[:, k] = steady[:, k] + np.exp(-DT / 1.5) * (core[:, k - 1] - steady[:, k])
    gas = on_the_line(core) + POWER * np.gradient(core, DT, axis=1)
    hot[:, 0] = gas[:, 0]
    kept = np.exp(-DT / LAG_S)
    for k in range(1, core.shape[1]):
        hot[:, k] = (1.0 - kept) * gas[:, k] + kept * hot[:, k - 1]
    rest = np.stack([2.0 * steady - 90.0, steady, on_the_line(steady)], axis=-1)
    air = np.full(steady.shape, AIR)
    return Course(np.stack([2.0 * core - 90.0, core, hot], -1), rest, air, np.ones_like(air), DT)


@pytest.fixture(scope="module")
def course():
    random = np.random.default_rng(4)
    levels = random.uniform(LOW, LOW + SPAN, (3, 16))
    levels[:, 1:3] = LOW, LOW + SPAN
    steady = np.repeat(levels, 60, axis=1)
    return course_of(steady)


def slope_at(coefficients, x):
    return coefficients[0] + coefficients[1] * x + coefficients[2] * x**2 + coefficients[3] * AIR


def test_the_working_line_is_that_of_the_settled_values(course):
    x = np.linspace(0.0, 1.0, 5)
    assert slope_at(working_line(course, 2), x) == pytest.approx(slope_at(SLOPE, x), rel=0.01)
    assert slope_at(working_line(course, 0), x) == pytest.approx(2.0, rel=0.01)


def test_the_end_of_a_short_flight_says_nothing_of_the_line(course):
    inside = course.inside.copy()
    inside[0, 400:] = 0.0
    steady = course.steady.copy()
    steady[0, 400:] = 0.0
    short = course._replace(inside=inside, steady=steady)
    x = np.linspace(0.0, 1.0, 5)
    assert slope_at(working_line(short, 2), x) == pytest.approx(slope_at(SLOPE, x), rel=0.01)


def test_power_is_told_from_speed_where_moves_cannot_tell_them_apart(course):
    """Of a core that lags by one constant, moves fit any split between the two."""
    engine, _ = fit_two_spool(course, 1)
    (found,) = engine.thermal
    assert len(found) == FLOW
    assert slope_at(found, 0.5) == pytest.approx(slope_at(SLOPE, 0.5), rel=0.01)
    x = np.linspace(0.2, 0.8, 4)
    power = found[4] + found[5] * x + found[6] * x**2 + found[7] * AIR
    assert power == pytest.approx(np.full(4, POWER), rel=0.1)
    assert found[-1] == pytest.approx(LAG_S, rel=0.15)
