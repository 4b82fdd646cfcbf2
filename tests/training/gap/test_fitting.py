"""Fits recover what was put in, to within their own intervals; held-out flights pay for a fit."""

import numpy as np
import pytest

from narxcal.effects import effect
from narxcal.effects.base import Run
from tests.training.gap.conftest import NOISE
from training.gap.fitting import Problem, fit
from training.gap.quadratic import misfit

KNOWN = {
    "throttle_delay": [0.4],
    "throttle_backlash": [3.0],
    "throttle_rate_limit": [12.0],
    "spool_lag": [1.4],
    "spool_coupling": [1.5],
    "accel_limit": [0.6, 30.0],
    "actuator_lag": [0.4, 1.6, 0.0],
    "accel_decel_asymmetry": [1.5, 0.0],
    "altitude_lag": [0.6],
    "sensor_lag:EGT_C": [1.3, 0.5],
    "time_skew:N1_pct": [0.35],
}


@pytest.mark.parametrize("name", KNOWN)
def test_known_parameters_are_recovered(name, flights, engine, recorded):
    measure = misfit(flights, recorded({name: KNOWN[name]}), NOISE)
    found = fit([effect(name)], Problem(flights, engine, measure))
    np.testing.assert_allclose(found.theta, KNOWN[name], rtol=0.02)
    assert found.left.sum() < 1.1 * measure.floor.sum()


def test_a_valve_outside_any_loop_is_known_as_such(flights, engine, recorded):
    measure = misfit(flights, recorded({"actuator_lag": [0.4, 1.0, 1.0]}), NOISE)
    found = fit([effect("actuator_lag")], Problem(flights, engine, measure))
    tau_s, _, outside = found.theta
    assert outside == 1.0
    np.testing.assert_allclose(tau_s, 0.4, rtol=0.02)
    assert found.left.sum() < 1.1 * measure.floor.sum()


def test_a_control_that_holds_pulls_back_is_known_as_such(flights, engine, recorded):
    measure = misfit(flights, recorded({"accel_decel_asymmetry": [0.7, 1.0]}), NOISE)
    found = fit([effect("accel_decel_asymmetry")], Problem(flights, engine, measure))
    np.testing.assert_allclose(found.theta, [0.7, 1.0], rtol=0.02)
    assert found.left.sum() < 1.1 * measure.floor.sum()


def test_a_fit_never_ends_farther_away_than_no_effect(flights, engine, recorded, monkeypatch):
    monkeypatch.setattr("training.gap.fitting._STEPS", 0)
    measure = misfit(flights, recorded({"spool_lag": [1.02]}), NOISE)
    found = fit([effect("spool_lag")], Problem(flights, engine, measure))
    np.testing.assert_allclose(found.theta, 1.0)
    np.testing.assert_allclose(found.left, measure.size(measure.gap))


def test_linear_parameters_need_no_start(flights, engine, recorded):
    truth = [0.0, 0.0, 9.0]
    measure = misfit(flights, recorded({"bleed_extraction": [*truth, 0.0]}), NOISE)
    found = fit([effect("bleed_extraction")], Problem(flights, engine, measure))
    np.testing.assert_allclose(found.theta[:3], truth, atol=0.5)


def test_what_a_bleed_takes_of_the_acceleration_is_found(flights, engine, recorded):
    truth = [0.0, 0.3, 20.0, 25.0]
    measure = misfit(flights, recorded({"bleed_extraction": truth}), NOISE)
    found = fit([effect("bleed_extraction")], Problem(flights, engine, measure))
    np.testing.assert_allclose(found.theta, truth, rtol=0.25, atol=0.2)
    assert float(found.left.sum()) < 0.1 * float(measure.size(measure.gap).sum())


def test_two_effects_are_fitted_together(flights, engine, recorded):
    truth = {"throttle_delay": [0.4], "sensor_lag:EGT_C": [1.0, 0.5]}
    measure = misfit(flights, recorded(truth), NOISE)
    both = [effect(name) for name in truth]
    found = fit(both, Problem(flights, engine, measure), np.array([0.2, 0.5, 0.2]))
    np.testing.assert_allclose(found.theta, [0.4, 1.0, 0.5], rtol=0.05)
    assert found.sizes == (1, 2)
    assert found.name == "throttle_delay + sensor_lag:EGT_C"


def test_the_jackknife_is_close_to_fitting_again_without_the_flight(flights, engine, recorded):
    real = recorded({"sensor_lag:EGT_C": [1.3, 0.5]}, noise=20.0 * NOISE)
    whole = fit(
        [effect("sensor_lag:EGT_C")], Problem(flights, engine, misfit(flights, real, NOISE))
    )
    real[0] = np.nan
    again = fit(
        [effect("sensor_lag:EGT_C")], Problem(flights, engine, misfit(flights, real, NOISE))
    )
    spread = np.ptp(whole.others[:, 0])
    assert abs(again.theta[0] - whole.others[0, 0]) < 0.2 * spread + 1e-3


def test_a_flight_does_not_gain_from_its_own_noise(flights, engine, recorded):
    measure = misfit(flights, recorded({}, seed=5), NOISE)
    found = fit([effect("bleed_extraction")], Problem(flights, engine, measure))
    assert found.held_out.sum() > measure.size(measure.gap).sum() - 1e-6
    assert found.left.sum() < measure.size(measure.gap).sum()


@pytest.mark.parametrize(("channel", "explained"), [("EGT_C", True), ("N1_pct", False)])
def test_a_lag_of_seconds_that_gets_longer_is_a_probe_or_a_rotor(
    channel, explained, flights, engine
):
    """`(1 + 2 s) / (1 + 4 s)`: a probe may be so; a speed is counted, and its rotor is heavier."""
    lag = effect(f"sensor_lag:{channel}")
    slower = lag.on_output(Run(flights.signals, np.array([[2.0, 2.0]] * 5), flights.u), flights.y)
    measure = misfit(flights, slower, NOISE)
    found = fit([lag], Problem(flights, engine, measure))
    left = float(found.left.sum() / measure.size(measure.gap).sum())
    assert (left < 0.01) is explained
    assert (left > 0.05) is not explained
