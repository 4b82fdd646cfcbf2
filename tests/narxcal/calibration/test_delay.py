"""Inputs that act late: a closed form, the same numbers by every way, and storage."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from narxcal.calibration.delay import DelayLine, TransportDelay
from narxcal.calibration.identified import (
    IdentifiedCalibration,
    StateSpaceDynamics,
    calibration_from_arrays,
)
from narxcal.calibration.members import Member
from narxcal.state_space import StateSpace
from narxcal.steady.table import SteadyTable
from narxcal.support.errors import ModelError

NAMES, DT_S = (("TRA_deg", "ALT_ft"), ("N1_pct", "EGT_C")), 0.1


def calibration(delay_s=0.47):
    points = np.array([[0.0, 0.0], [0.0, 30e3], [80.0, 0.0], [80.0, 30e3]])
    table = SteadyTable(NAMES, points, np.column_stack([20.0 + points[:, 0], 400.0 + points[:, 1]]))
    rng = np.random.default_rng(0)
    matrices = np.diag([0.9, 0.7]), rng.normal(size=(2, 2)), rng.normal(size=(2, 2))
    dynamics = StateSpaceDynamics(StateSpace(*matrices, np.zeros((2, 2)), DT_S))
    own = IdentifiedCalibration(table, dynamics, DT_S)
    return own.with_delay(TransportDelay(("TRA_deg",), delay_s, delay_s, delay_s))


def log(seed=0, samples=60):
    rng = np.random.default_rng(seed)
    return np.column_stack([rng.uniform(0.0, 80.0, samples), np.linspace(0.0, 9e3, samples)])


@given(st.floats(0.0, 3.0), st.integers(1, 59))
def test_a_line_shifts_by_whole_samples_and_a_part_of_one(delay_s, cut):
    inputs = log()
    line = DelayLine(delay_s / DT_S, np.array([0]), inputs[0])
    found = np.concatenate([line.advance(inputs[:cut]), line.advance(inputs[cut:])])
    at = np.arange(len(inputs)) - delay_s / DT_S
    np.testing.assert_allclose(
        found[:, 0], np.interp(at, np.arange(len(inputs)), inputs[:, 0]), atol=1e-9
    )
    np.testing.assert_array_equal(found[:, 1], inputs[:, 1])


@pytest.mark.parametrize("members", [(), (Member("first_order", 1, 0.2, 0.3),)])
@pytest.mark.parametrize("delay_s", [0.0, 0.4, 0.47])
def test_steps_blocks_and_the_whole_are_one(delay_s, members):
    model, inputs, start = calibration(delay_s).with_members(members), log(), [25.0, 333.0]
    whole = model.simulate(inputs, start)
    first = model.reset(inputs[0], start)
    np.testing.assert_allclose([first, *map(model.step, inputs[1:])], whole, rtol=1e-10)
    model.reset(inputs[0], start)
    parts = [model.extend(inputs[1:23]), model.extend(inputs[23:])]
    np.testing.assert_allclose(np.concatenate(parts), whole[1:], rtol=1e-10)


def test_a_run_is_that_over_inputs_as_they_act():
    model, inputs = calibration(0.3), log()
    acting = inputs.copy()
    acting[:, 0] = np.concatenate([np.full(3, inputs[0, 0]), inputs[:-3, 0]])
    plain = model.with_delay(None)
    np.testing.assert_allclose(model.delayed_inputs(inputs), acting)
    np.testing.assert_allclose(model.simulate(inputs), plain.simulate(acting))
    measured = plain.simulate(acting) + 1.0
    np.testing.assert_allclose(model.predict(inputs, measured), plain.predict(acting, measured))


def test_a_stored_model_acts_as_late():
    model = calibration()
    back = calibration_from_arrays(*model.to_arrays())
    assert back.delay == model.delay
    np.testing.assert_array_equal(back.simulate(log()), model.simulate(log()))
    assert model.delay.words == "TRA_deg acts 0.47 s late (0.47 to 0.47 s)"


def test_what_does_not_fit_is_refused():
    model, wrong = calibration(), TransportDelay(("Mach",), 0.1, 0.1, 0.1)
    with pytest.raises(ModelError, match="the delay names 'Mach', which is no input"):
        model.with_delay(wrong)
    for stored in (wrong.to_json(), {**model.delay.to_json(), "delay_s": -1.0}):
        with pytest.raises(ModelError, match="'delay' does not fit the inputs"):
            TransportDelay.from_json(stored, NAMES[0])
