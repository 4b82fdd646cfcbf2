"""What the best of many hypotheses gains on residuals turned in time."""

from dataclasses import replace

import numpy as np
import pytest

from narxcal.effects import effect
from tests.training.gap.conftest import NOISE
from training.gap.fitting import Problem, fit
from training.gap.null import null_gains
from training.gap.quadratic import misfit

DRIFT, CUT = [400.0], 600  # per hour; samples of the shorter flights
NAMES = ("sensor_drift:EGT_C", "sensor_lag:EGT_C")


@pytest.fixture
def shorter(flights, recorded):
    """Flights of which two end early, filled up with their last rows, and a drift in them."""
    u, y, lengths = flights.u.copy(), flights.y.copy(), flights.lengths.copy()
    real = recorded({"sensor_drift:EGT_C": DRIFT})
    for f in (1, 3):
        u[f, CUT:], y[f, CUT:], lengths[f] = u[f, CUT - 1], y[f, CUT - 1], CUT
        real[f, CUT:] = np.nan
    of = replace(flights, u=u, y=y, lengths=lengths)
    return of, misfit(of, real, NOISE)


def test_what_the_best_says_behind_the_end_of_a_flight_is_no_residual(shorter, engine):
    """A drift goes on in what fills a flight up: turned into the flight it is any size."""
    flights, measure = shorter
    fits = [fit([effect(name)], Problem(flights, engine, measure)) for name in NAMES]
    residual = measure.cleaned(measure.gap - fits[0].response)
    assert np.abs(residual[1, CUT:, 2]).max() > 10.0
    gains = null_gains(fits, measure, residual, 40, 0)
    left = float(measure.size(np.where(measure.weights > 0.0, residual, 0.0)).sum())
    assert gains.max() < 0.05 * left
    np.testing.assert_array_equal(
        gains, null_gains(fits, measure, np.where(measure.weights > 0.0, residual, 7.0), 40, 0)
    )


def test_no_draw_gains_more_than_there_is(shorter, engine):
    flights, measure = shorter
    fits = [fit([effect(name)], Problem(flights, engine, measure)) for name in NAMES]
    gains = null_gains(fits, measure, measure.gap, 20, 1)
    assert gains.max() <= float((measure.weights * measure.gap**2).sum())
    assert len(set(gains)) == 20


def test_a_flight_of_which_nothing_is_known_says_nothing(flights, engine, recorded):
    real = recorded({"sensor_lag:EGT_C": [0.5, 0.5]})
    real[2] = np.nan
    measure = misfit(flights, real, NOISE)
    fits = [fit([effect(NAMES[1])], Problem(flights, engine, measure))]
    residual = measure.cleaned(measure.gap - fits[0].response)
    gains = null_gains(fits, measure, residual, 20, 2)
    assert np.isfinite(gains).all()
    assert gains.max() < 0.02 * float(measure.size(measure.gap).sum())
