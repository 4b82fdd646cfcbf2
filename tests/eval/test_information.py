"""What moves tell of parameters: slopes in closed form, noise by the whole covariance, refusals."""

import numpy as np
import pytest

from eval.cards.information import Parameters, parameters_of, whitened
from narxcal.calibration.bundle import Bundle
from narxcal.calibration.identified import IdentifiedCalibration, NoDynamics, ResponseDynamics
from narxcal.steady.function import SteadyCallable
from narxcal.support.errors import ModelError
from narxcal.transfer import Schedule

DT_S, TAU_S = 0.1, 1.3


@pytest.fixture
def lagging():
    """An output that settles at its only input and follows it by a lag."""
    steady = SteadyCallable(lambda u: 1.0 * u, (("TRA_deg",), ("N2_pct",)))
    dynamics = ResponseDynamics((), (Schedule((), np.log([TAU_S])),), DT_S)
    return IdentifiedCalibration(steady, dynamics, DT_S)


def test_the_slope_of_a_lag_is_that_of_its_closed_form(lagging):
    """y = 1 - (tau / h) (exp(h / tau) - 1) exp(-t / tau) behind a ramp to 1 within h."""
    found = parameters_of(Bundle(lagging))
    assert isinstance(found, Parameters)
    assert found.names == ("N2_pct: ln parameter 1",)
    inputs = np.ones((80, 1))
    inputs[0] = 0.0
    t, h = DT_S * np.arange(1, 80), DT_S
    growth = np.exp(h / TAU_S)
    by_tau = -np.exp(-t / TAU_S) * (
        (growth - 1.0) / h - growth / TAU_S + (growth - 1.0) * t / (h * TAU_S)
    )
    slopes = found.slopes(inputs)
    assert slopes[0] == pytest.approx(0.0)
    np.testing.assert_allclose(slopes[1:, 0, 0], TAU_S * by_tau, rtol=1e-5, atol=1e-8)


def test_a_run_without_dynamic_parameters_is_refused(lagging):
    static = IdentifiedCalibration(lagging.steady, NoDynamics(), DT_S)
    with pytest.raises(ModelError) as refused:
        parameters_of(Bundle(static))
    assert str(refused.value) == (
        "a card needs parameters of responses, and this run has none: steady state without "
        "dynamics. Train with [narx] lag = true, or identify --method transfer or output-error"
    )


def test_whitening_is_that_of_the_whole_covariance():
    """Against the inverse of the covariance of b + v, where the noise is stationary."""
    phi, q, r, n = 0.9, 0.3, 0.5, 40
    p0 = q / (1.0 - phi**2)
    lags = np.abs(np.subtract.outer(np.arange(n), np.arange(n)))
    covariance = p0 * phi**lags + r * np.eye(n)
    columns = np.random.default_rng(1).normal(size=(n, 3))
    known = np.arange(n) % 7 != 3
    rows = whitened(columns, np.zeros(n), known, np.array([phi, q, 0.0, 0.5, r, p0]))
    some = columns[known]
    expected = some.T @ np.linalg.solve(covariance[np.ix_(known, known)], some)
    np.testing.assert_allclose(rows.T @ rows, expected, rtol=1e-9)


def test_errors_of_a_moving_engine_make_its_samples_tell_less():
    columns, known = np.ones((30, 1)), np.ones(30, dtype=np.bool_)
    noise = np.array([0.8, 0.01, 5.0, 0.5, 0.1, 0.02])
    still = whitened(columns, np.zeros(30), known, noise)
    moving = whitened(columns, np.ones(30), known, noise)
    assert np.sum(moving**2) < 0.5 * np.sum(still**2)
