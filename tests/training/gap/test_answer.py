"""Intervals and weights of a finding: closed forms, and what flights do not show."""

import numpy as np
import pytest
from scipy.stats import t

from narxcal.effects import effect
from tests.training.gap.conftest import NOISE
from training.gap.answer import Worth, interval, probabilities, shrink, tried
from training.gap.fitting import Problem, fit
from training.gap.quadratic import misfit

NAME = "sensor_lag:EGT_C"


def test_the_jackknife_of_a_mean_is_students_interval():
    """Leaving one out of a mean gives back the standard error of the mean (Efron, 11.5)."""
    values = np.array([1.0, 2.0, 4.0, 7.0, 7.0])
    others = (values.sum() - values) / 4.0
    reach = t.ppf(0.95, 4) * values.std(ddof=1) / np.sqrt(5)
    found = interval(others, values.mean())
    assert (found.low, found.high) == pytest.approx((4.2 - reach, 4.2 + reach))
    wider = interval(others, values.mean(), 3.0)
    assert wider.high - 4.2 == pytest.approx(np.hypot(reach, 3.0))


def test_one_flight_bounds_nothing():
    found = interval(np.array([2.0]), 2.0, 1.0)
    assert (found.low, found.high) == (-np.inf, np.inf)
    assert (shrink(np.array([0.5]), 0.5).low, shrink(np.array([0.5]), 0.5).high) == (-np.inf, 1.0)


def test_what_a_model_leaves_makes_its_sizes_uncertain(flights, engine, recorded):
    """A fifth of the size, by the root of the share that is left; nothing where nothing is."""
    measure = misfit(flights, recorded({NAME: [1.0, 0.5]}), NOISE)
    model = fit([effect(NAME)], Problem(flights, engine, measure))
    rows = [tried(model, Worth(0.9, np.full(5, 0.9), left), 1.0) for left in (0.0, 0.25, 1.0)]
    reaches = [row.parameters[NAME]["tau_s"].high - model.theta[0] for row in rows]
    assert reaches[0] == pytest.approx(interval(model.others[:, 0], 0.0).high)
    for left, reach in zip((0.25, 1.0), reaches[1:], strict=True):
        beside = 0.2 * np.sqrt(left) * model.theta[0]
        assert reach == pytest.approx(np.hypot(reaches[0], beside))


def test_of_two_that_flights_do_not_tell_apart_neither_leads():
    same = np.array([1.0, 2.0, 3.0])
    either = probabilities([same, same + np.array([0.1, -0.1, 0.0])])
    np.testing.assert_allclose(either, [0.5, 0.5], atol=0.01)
    far = probabilities([same, same + 10.0])
    assert far[0] == pytest.approx(1.0)
