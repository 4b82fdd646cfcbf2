"""The Spey paper's procedure on simulated records."""

import numpy as np
import pytest

from eval.reproduce.spey import identify, prediction_error, tau_engine_of
from narxcal.output_error.engine import EngineAndControl
from narxcal.output_error.paper import fly, noise_sd, table_4
from training.papers.output_error import Plan, fit

TRUE = table_4("left")


@pytest.fixture(scope="module")
def found():
    return identify(fly(TRUE, 11), noise_sd())


@pytest.fixture(scope="module")
def control(found):
    return found[1]


@pytest.mark.slow
def test_the_last_step_recovers_every_parameter(control):
    truth = np.array([TRUE[name] for name in control.names])
    assert control.status == "converged"
    assert control.white
    assert np.abs((control.values - truth) / control.sd).max() < 4.0
    assert control.parameters()["C_FB"] == control.parameters()["C_FH"]


@pytest.mark.slow
def test_tau_engine_is_known_better_than_its_factors_since_their_errors_go_together(control):
    value, sd = tau_engine_of(control)
    assert abs(value - 0.232 / (3.11 * 0.114)) < 4.0 * sd
    tau_H, sd_H = control.estimates()["tau_H"]
    assert sd / value < 0.7 * sd_H / tau_H


@pytest.mark.slow
def test_a_meter_at_the_input_biases_alpha_alike_in_every_record(found):
    alpha = found[0]["alpha"]
    assert alpha.value - 0.64 > 4.0 * alpha.sd
    assert alpha.birge < 3.0


@pytest.mark.slow
def test_a_record_that_was_not_used_is_predicted_to_the_noise_of_its_sensors(control):
    model = EngineAndControl(0.05)
    *used, unused = [one.of(model) for one in fly(TRUE, 12)]
    start = {name: value for name, (value, _) in control.estimates().items()}
    other = fit(model, used, Plan(start=start, sigma=noise_sd()))
    for name, rms in prediction_error(model, other.parameters(), unused).items():
        assert rms == pytest.approx(noise_sd()[name], rel=0.06)


def test_from_throttle_to_speed_alone_only_tau_engine_is_determined():
    model = EngineAndControl(0.05)
    record = fly(TRUE, 1)[0].of(model)
    record.y[:, [0, 1, 3, 4, 5]] = np.nan  # N_H only
    plan = Plan(free=("K_AF", "tau_H", "C_FH"), start=TRUE | {"C_FB": 0.114}, sigma=noise_sd())
    seen = fit(model, [record], plan)
    assert seen.status == "unidentifiable"
    assert len(seen.unidentifiable) == 2
    assert np.isinf(seen.sd).all()
