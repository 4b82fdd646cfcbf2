"""The measure: what nuisances may take, what they may not, and that it is a quadratic form."""

import numpy as np

from tests.training.gap.conftest import NOISE
from training.gap.quadratic import misfit


def test_an_offset_and_a_slope_over_power_cost_nothing(flights):
    real = flights.y + np.array([0.1, -0.3, 6.0])
    real[..., 2] += 9.0 * flights.signals.power(flights.y)
    measure = misfit(flights, real, NOISE)
    plain = (measure.weights * measure.gap**2).sum(axis=(1, 2))
    assert (measure.size(measure.gap) < 1e-3 * plain).all()


def test_without_room_for_nuisances_it_is_the_plain_weighted_square(flights):
    real = flights.y + np.sin(np.arange(flights.y.shape[1]))[:, None]
    measure = misfit(flights, real, NOISE, loose=1e-6)
    plain = (measure.weights * measure.gap**2).sum(axis=(1, 2))
    np.testing.assert_allclose(measure.size(measure.gap), plain, rtol=1e-6)


def test_closed_form_is_the_least_over_the_nuisances(flights):
    """The slow twin: ridge regression on the nuisances, flight by flight."""
    random = np.random.default_rng(1)
    measure = misfit(flights, flights.y + random.standard_normal(flights.y.shape), NOISE, 0.01)
    prior = np.linalg.inv(measure.solved)
    for f in range(len(flights.y)):
        w = measure.weights[f].ravel()
        x = measure.nuisances[f].reshape(len(prior[f]), -1).T
        v = measure.gap[f].ravel()
        beta = np.linalg.solve(prior[f], x.T @ (w * v))
        penalty = prior[f] - x.T @ (w[:, None] * x)
        least = ((v - x @ beta) ** 2 * w).sum() + beta @ penalty @ beta
        np.testing.assert_allclose(measure.size(measure.gap)[f], least, rtol=1e-9)
        cleaned = measure.cleaned(measure.gap)[f].ravel()
        np.testing.assert_allclose(cleaned, v - x @ beta, rtol=0, atol=1e-9)


def test_inner_products_polarise(flights):
    random = np.random.default_rng(2)
    measure = misfit(flights, flights.y, NOISE)
    a, b = random.standard_normal((2, *flights.y.shape))
    left = measure.size(a + b) - measure.size(a - b)
    np.testing.assert_allclose(left, 4.0 * measure.inner(a[None], b[None])[:, 0, 0], rtol=1e-8)


def test_unknown_samples_and_the_end_of_a_short_flight_weigh_nothing(flights):
    real = flights.y.copy()
    real[0, 10:20, 1] = np.nan
    measure = misfit(flights, real, NOISE)
    assert not measure.weights[0, 10:20, 1].any()
    assert np.isfinite(measure.size(measure.gap)).all()
