"""A calibration: simulate, step and extend agree; at rest it is the steady-state model."""

from functools import partial

import numpy as np
import pandas as pd
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from narxcal.calibration.dynamic import DynamicCalibration, narx_features
from narxcal.calibration.identified import calibration_from_arrays
from narxcal.narx.config import NarxConfig
from narxcal.narx.module import NarxNet
from narxcal.narx.network import NarxModel, Scaling
from narxcal.steady.fitted import FittedSteadyState, Layout
from narxcal.steady.model import Envelope
from narxcal.steady.table import SteadyTable
from narxcal.support.errors import ConfigError, DataError, ModelError
from tests.narxcal.calibration.test_calibration_lag import calibration as behind_lags
from training.dynamics.network import net_of

INPUTS, OUTPUTS = ("TRA_deg", "Mach"), ("N1_pct", "EGT_C")


def table():
    points = np.array([[0.0, 0.0], [0.0, 0.8], [78.0, 0.0], [78.0, 0.8]])
    settled = np.column_stack([20.0 + points[:, 0], 300.0 + 4.0 * points[:, 0]])
    return SteadyTable((INPUTS, OUTPUTS), points, settled)


def two_engines():
    return FittedSteadyState(
        layout=Layout(input_names=INPUTS, output_names=OUTPUTS, driver="TRA_deg", corrected=False),
        envelope=Envelope(np.array([0.0, 0.0]), np.array([78.0, 0.8])),
        seen=np.array([0.0, 78.0]),
        knots=np.linspace(0.0, 78.0, 4),
        curve=np.random.default_rng(0).uniform(1.0, 20.0, (2, 1, 5)),
        engines=("left", "right"),
        engine_curves=np.eye(5)[0] * [[[1.0], [2.0]], [[-1.0], [-2.0]]],
    )


def calibration(config=None, steady=None, seed=0, settle_s=None):
    torch.manual_seed(seed)
    steady = steady or table()
    net = NarxNet(config or NarxConfig(lags=2, hidden=4, moving=2), 5, 2)
    net.low[:], net.high[:] = -2.0, 2.0
    inputs = Scaling(np.array([0.0, 0.0, 60.0, 450.0, 0.3]), np.array([5.0, 20.0, 30.0, 90.0, 0.2]))
    network = NarxModel(net, inputs, Scaling(np.zeros(2), np.array([4.0, 30.0])))
    return DynamicCalibration(steady, network, 0.1, ("Mach",), settle_s)


def log(samples=60, seed=0):
    rng = np.random.default_rng(seed)
    lever = np.repeat(rng.uniform(0.0, 78.0, samples // 10 + 1), 10)[:samples]
    return np.column_stack([lever, np.linspace(0.0, 0.7, samples)])


configs = st.builds(
    NarxConfig,
    lags=st.integers(1, 4),
    taps=st.sampled_from([(0,), (0, 1), (1, 2), (0, 3, 7)]),
    hidden=st.integers(1, 4),
    moving=st.sampled_from([0, 2]),
)


@settings(max_examples=12)
@given(config=configs, seed=st.integers(0, 99), settled=st.booleans(), cut=st.integers(2, 59))
def test_steps_blocks_and_the_whole_are_one(config, seed, settled, cut):
    model, inputs = calibration(config, seed=seed), log(seed=seed)
    start = None if settled else model.steady.outputs(inputs[0]) - np.array([-2.0, 10.0])
    whole = model.simulate(inputs, start)
    by_step = [model.reset(inputs[0], start), *(model.step(row) for row in inputs[1:])]
    np.testing.assert_allclose(by_step, whole, rtol=1e-10, atol=1e-10)
    blocks = [model.reset(inputs[0], start)[None], model.extend(inputs[1:cut])]
    blocks.append(model.extend(inputs[cut:]))
    np.testing.assert_allclose(np.concatenate(blocks), whole, rtol=1e-10, atol=1e-10)


def test_its_text_tells_inputs_outputs_and_step():
    model = calibration()
    names = f"{', '.join(model.input_names)} -> {', '.join(model.output_names)}"
    assert repr(model) == f"<DynamicCalibration {names} every {model.dt_s:g} s>"


def test_an_anchored_calibration_stays_at_the_steady_state_where_nothing_moves():
    model, still = calibration(), np.tile([40.0, 0.5], (500, 1))
    np.testing.assert_allclose(model.simulate(still), model.steady.outputs(still), rtol=1e-12)


def stubborn(settle_s):
    """A network that keeps any deviation for ever, or lets it grow."""
    model = calibration(settle_s=settle_s)
    with torch.no_grad():
        net_of(model.narx).output.weight.zero_()
        net_of(model.narx).linear.weight.zero_()
        net_of(model.narx).linear.weight[:, :2] = 1.05 * torch.eye(2)
    return model


def test_whatever_the_weights_a_fading_bound_brings_the_engine_to_its_steady_state():
    still = np.tile([40.0, 0.3], (3001, 1))
    start = table().outputs(still[0]) + np.array([3.0, -25.0])
    free = stubborn(None).simulate(still, start)
    faded = stubborn(10.0).simulate(still, start)
    assert abs(free[-1] - table().outputs(still[0])).min() > 3.0
    off = abs(faded - table().outputs(still[0]))
    envelope = 2.0 * np.array([3.0, 25.0]) * np.exp(-np.arange(3001) * 0.1 / 10.0)[:, None]
    assert (off <= envelope + 1e-9).all()


def test_after_a_move_the_deviation_stays_below_twice_that_of_the_slow_lag():
    inputs = np.tile([20.0, 0.3], (2000, 1))
    inputs[100:, 0] = 60.0
    outputs = stubborn(10.0).simulate(inputs)
    steady = table().outputs(inputs)
    lag, worst = np.zeros(2), np.zeros(2)
    keep = np.exp(-0.1 / 10.0)
    for k in range(1, 2000):
        lag = keep * (lag + steady[k] - steady[k - 1])
        worst = np.maximum(abs(lag), keep * worst)
        assert (abs(steady[k] - outputs[k]) <= 2.0 * worst + 1e-9).all()


def test_a_fading_bound_is_the_same_in_steps_blocks_and_the_whole():
    inputs = log(60)
    whole = stubborn(5.0).simulate(inputs)
    stepped, blocks = stubborn(5.0), stubborn(5.0)
    np.testing.assert_allclose([stepped.step(row) for row in inputs], whole, atol=1e-10)
    parts = [blocks.extend(inputs[:23]), blocks.extend(inputs[23:])]
    np.testing.assert_allclose(np.concatenate(parts), whole, atol=1e-10)


def test_a_correction_may_widen_a_fading_bound():
    model = stubborn(10.0)
    model.reset([40.0, 0.3])
    value = table().outputs(np.array([40.0, 0.3]))
    after = model.step([40.0, 0.3], correction=value + 2.0)
    np.testing.assert_allclose(after - value, 2.0 * 1.05, atol=1e-9)


@pytest.mark.parametrize("make", [calibration, partial(behind_lags, settle_s=None)])
def test_eighty_minutes_of_wild_levers_stay_inside_the_guaranteed_bounds(make):
    model = make()
    inputs = np.random.default_rng(0).uniform(-1e6, 1e6, (48_000, 2))
    deviation = (model.steady.outputs(inputs) - model.simulate(inputs))[1:]
    low, high = model.bounds()
    assert (deviation >= low - 1e-9).all()
    assert (deviation <= high + 1e-9).all()


def test_it_starts_where_it_is_told_and_settled_where_that_is_unknown():
    model, inputs = calibration(), log()
    ss = model.steady.outputs(inputs[0])
    assert model.simulate(inputs)[0] == pytest.approx(ss)
    assert model.simulate(inputs, [33.0, np.nan])[0] == pytest.approx([33.0, ss[1]])


def test_prediction_knows_nothing_after_a_masked_sample():
    model, inputs = calibration(), log()
    measured = model.simulate(inputs)
    np.testing.assert_allclose(model.predict(inputs, measured)[2:], measured[2:], rtol=1e-9)
    measured[20, 0] = np.nan
    unknown = np.isnan(model.predict(inputs, measured)).any(axis=1)
    assert np.flatnonzero(unknown).tolist() == [0, 21, 22]


def test_a_correction_replaces_the_newest_output_before_the_step():
    model, inputs = calibration(NarxConfig(lags=1, taps=(0,), hidden=4)), log()
    measured = model.steady.outputs(inputs) - np.array([-1.0, 5.0])
    model.reset(inputs[0], measured[0])
    for k in range(1, 40):
        expected = model.predict(inputs, measured)[k]
        assert model.step(inputs[k], measured[k - 1]) == pytest.approx(expected, rel=1e-9)


PLAIN_AND_BEHIND_LAGS = pytest.mark.parametrize("make", [calibration, behind_lags])


@PLAIN_AND_BEHIND_LAGS
def test_a_correction_of_nan_keeps_the_models_own(make):
    model, inputs = make(), log()
    whole = model.simulate(inputs)
    model.reset(inputs[0])
    steps = [model.step(row, [np.nan, np.nan]) for row in inputs[1:]]
    np.testing.assert_allclose(steps, whole[1:], rtol=1e-10)


def test_each_engine_gets_its_own_steady_state_and_register():
    both = calibration(steady=two_engines())
    both.reset([40.0, 0.1])
    left, right = both.for_engine("left"), both.for_engine("right")
    inputs = log()
    assert np.abs(left.simulate(inputs) - right.simulate(inputs)).min() > 0.0
    settled = [one.step([40.0, 0.3]) for one in (left, right)]
    np.testing.assert_allclose(settled[0] - settled[1], [2.0, 4.0])
    assert both.step([40.0, 0.1]) == pytest.approx(both.steady.outputs(np.array([40.0, 0.1])))


def test_a_steady_state_model_of_one_engine_serves_all():
    model = calibration()
    assert np.array_equal(model.for_engine("left").simulate(log()), model.simulate(log()))


def test_the_network_sees_increments_values_and_the_schedule():
    ss = np.array([[1.0], [4.0], [2.0]])
    features = narx_features(ss, np.array([[7.0], [8.0], [9.0]]))
    assert features.tolist() == [[0.0, 1.0, 7.0], [3.0, 4.0, 8.0], [-2.0, 2.0, 9.0]]


@pytest.mark.parametrize(
    "model", [calibration(steady=two_engines()).for_engine("right"), behind_lags()]
)
def test_it_comes_back_from_json_and_arrays_as_it_was(model):
    again = DynamicCalibration.from_arrays(*model.to_arrays())
    assert np.array_equal(again.simulate(log()), model.simulate(log()))
    assert (again.dt_s, again.schedule) == (0.1, ("Mach",))


def test_a_lost_part_is_named():
    meta, arrays = calibration().to_arrays()
    del meta["dt_s"]
    with pytest.raises(ModelError) as error:
        DynamicCalibration.from_arrays(meta, arrays)
    assert str(error.value) == (
        "the stored calibration has no 'dt_s'. The bundle was altered; train it again"
    )


def test_a_schedule_of_unknown_inputs_is_refused():
    with pytest.raises(ModelError) as error:
        DynamicCalibration(table(), calibration().narx, 0.1, ("ALT_ft",))
    assert str(error.value) == (
        "the schedule names 'ALT_ft', which is no input of the steady-state model. "
        "Inputs are TRA_deg, Mach"
    )


@pytest.mark.parametrize(
    ("inputs", "start", "message"),
    [
        (
            np.zeros((5, 3)),
            None,
            "expected inputs of shape (time, 2) (TRA_deg, Mach), found (5, 3)",
        ),
        (
            np.array([[0.0, 0.0], [np.inf, 0.0]]),
            None,
            (
                "channel TRA_deg, row 1: expected a finite input, found inf. "
                "Hold the last good value, or cut the log there"
            ),
        ),
        (
            np.zeros((5, 2)),
            np.zeros(3),
            "expected start values of shape (2,) (N1_pct, EGT_C), found (3,)",
        ),
    ],
)
def test_unfit_inputs_are_refused(inputs, start, message):
    with pytest.raises(DataError) as error:
        calibration().simulate(inputs, start)
    assert str(error.value) == message


def test_inputs_saturate_at_the_reach_and_nowhere_else():
    free = calibration()
    bounded = free.with_input_limits([-10.0, 0.0], [90.0, 1.0])
    inside = log()
    np.testing.assert_array_equal(bounded.simulate(inside), free.simulate(inside))
    beyond = log()
    beyond[30:] = [1e9, -40.0]
    limit = log()
    limit[30:] = [90.0, 0.0]
    np.testing.assert_array_equal(bounded.simulate(beyond), free.simulate(limit))
    np.testing.assert_array_equal(bounded.predict(beyond, inside), free.predict(limit, inside))


def test_the_reach_is_stored_and_checked():
    bounded = calibration().with_input_limits([-10.0, 0.0], [90.0, 1.0])
    meta, arrays = bounded.to_arrays()
    again = calibration_from_arrays(meta, arrays)
    np.testing.assert_array_equal(again.reach.low, [-10.0, 0.0])
    with pytest.raises(ModelError, match=r"^'reach' is no range for each input"):
        calibration_from_arrays({**meta, "reach": {"low": [0.0], "high": [1.0]}}, arrays)


def test_tables_are_taken_by_name():
    model = calibration()
    table = pd.DataFrame(log(), columns=model.input_names)
    turned = table[list(model.input_names[::-1])]
    start = pd.Series([51.0, 61.0], index=model.output_names)
    expected = model.simulate(log(), start.to_numpy())
    assert np.array_equal(model.simulate(turned, start[::-1]), expected)
    measured = pd.DataFrame(expected, columns=model.output_names)
    one_step = model.predict(log(), expected)
    np.testing.assert_array_equal(model.predict(turned, measured[measured.columns[::-1]]), one_step)
    assert np.array_equal(model.reset(turned.iloc[0], start[::-1]), expected[0])
    stepped = [model.step(turned.iloc[k]) for k in range(1, 6)]
    np.testing.assert_allclose(stepped, expected[1:6])
    assert np.array_equal(model.steady.outputs(turned), model.steady.outputs(log()))
    with pytest.raises(DataError, match="channel speed: unknown column; expected the columns"):
        model.simulate(table.rename(columns={model.input_names[0]: "speed"}))
    with pytest.raises(DataError, match=f"channel {model.input_names[1]}: the column is missing"):
        model.simulate(table[[model.input_names[0]]])


def test_an_engine_that_the_model_does_not_know_lists_those_that_it_knows():
    model = calibration(steady=two_engines())
    with pytest.raises(ConfigError) as error:
        model.for_engine("centre")
    assert "expected one of the engines left, right, found 'centre'" in str(error.value)
    mean = model.for_engine("").simulate(log())
    assert np.array_equal(model.for_engine("centre", or_mean=True).simulate(log()), mean)
