"""A calibration with lags in front of its network: all doors lead to the same numbers."""

import numpy as np
import pytest
import torch

from narxcal.calibration.dynamic import DynamicCalibration, narx_features
from narxcal.calibration.members import Member
from narxcal.lumped.engine import LumpedEngine
from narxcal.lumped.limited import LIMITED
from narxcal.narx.config import NarxConfig
from narxcal.narx.module import NarxNet
from narxcal.narx.network import NarxModel, Scaling
from narxcal.steady.table import SteadyTable
from narxcal.support.errors import ModelError

INPUTS, OUTPUTS = ("TRA_deg", "Mach"), ("N1_pct", "EGT_C")


def lags(names=OUTPUTS):
    parameters = 0.3 * np.random.default_rng(4).normal(size=(len(names), len(LIMITED)))
    centre, half = np.array([[60.0, 40.0], [450.0, 160.0]])[: len(names)].T
    scales = {"centre": centre, "half": half, "limit": np.array([50.0, 200.0])[: len(names)]}
    return LumpedEngine.of(names, {"parameters": parameters}, scales)


def calibration(lag=None, share=1.0, settle_s=10.0, taps=(0, 2)):
    """Network weights are `share` of drawn ones: 0 leaves the lags alone."""
    torch.manual_seed(0)
    points = np.array([[0.0, 0.0], [0.0, 0.8], [78.0, 0.0], [78.0, 0.8]])
    settled = np.column_stack([20.0 + points[:, 0], 300.0 + 4.0 * points[:, 0]])
    net = NarxNet(NarxConfig(lags=2, taps=taps, hidden=4, moving=4), 7, 2)
    net.set_theta(share * net.get_theta())
    net.low[:], net.high[:] = -2.0, 2.0
    centre = np.array([0.0, 0.0, 0.0, 0.0, 60.0, 450.0, 0.3])
    inputs = Scaling(centre, np.array([5.0, 20.0, 5.0, 20.0, 30.0, 90.0, 0.2]))
    network = NarxModel(net, inputs, Scaling(np.zeros(2), np.array([1.0, 8.0])))
    steady = SteadyTable((INPUTS, OUTPUTS), points, settled)
    plain = DynamicCalibration(steady, network, 0.1, ("Mach",), settle_s)
    return plain.with_lag(lag or lags())


def log(samples=80):
    lever = np.repeat(np.random.default_rng(0).uniform(0.0, 78.0, 8), 10)[:samples]
    return np.column_stack([lever, np.linspace(0.0, 0.7, samples)])


@pytest.mark.parametrize("settle_s", [None, 10.0])
@pytest.mark.parametrize("cut", [1, 23, 79])
def test_steps_blocks_and_the_whole_are_one(settle_s, cut):
    model, inputs, start = calibration(settle_s=settle_s), log(), [25.0, 333.0]
    whole = model.simulate(inputs, start)
    first = model.reset(inputs[0], start)
    np.testing.assert_allclose([first, *map(model.step, inputs[1:])], whole, rtol=1e-10)
    model.reset(inputs[0], start)
    parts = [model.extend(inputs[1:cut])] if cut > 1 else []
    parts.append(model.extend(inputs[cut:]))
    np.testing.assert_allclose(np.concatenate(parts), whole[1:], rtol=1e-10)


@pytest.mark.parametrize("rows", [1, 7, 79])
def test_a_long_log_in_blocks_is_the_log_as_a_whole(rows, monkeypatch):
    model, inputs = calibration(), log()
    measured = model.simulate(inputs, [25.0, 333.0]) + np.random.default_rng(1).normal(size=(80, 2))
    measured[40] = np.nan
    whole = model.simulate(inputs, measured[0]), model.predict(inputs, measured)
    monkeypatch.setattr("narxcal.calibration.calibration._BLOCK", rows)
    np.testing.assert_allclose(model.simulate(inputs, measured[0]), whole[0], rtol=1e-12)
    np.testing.assert_allclose(model.predict(inputs, measured), whole[1], rtol=1e-12)
    np.testing.assert_array_equal(model.settled(inputs), model.steady.outputs(inputs))


def test_a_silent_network_leaves_the_lags():
    model, inputs = calibration(share=0.0), log()
    ss, start = model.steady.outputs(inputs), np.array([25.0, 333.0])
    drive = model.lag.drive(inputs, INPUTS, ss)
    expected = ss - model.lag.deviations(drive, ss[0] - start, 0.1)
    np.testing.assert_allclose(model.simulate(inputs, start), expected, rtol=1e-12)


def test_the_network_is_shown_the_deviation_of_the_lags_among_what_vanishes_at_rest():
    ss, lagged = np.array([[1.0], [4.0]]), np.array([[0.5], [0.25]])
    features = narx_features(ss, np.array([[7.0], [8.0]]), lagged)
    assert features.tolist() == [[0.0, 0.5, 1.0, 7.0], [3.0, 0.25, 4.0, 8.0]]


def test_where_nothing_moves_it_comes_to_the_steady_state():
    model = calibration()
    still = np.tile([40.0, 0.3], (4000, 1))
    settled = model.steady.outputs(still[0])
    away = settled + np.array([5.0, 60.0])
    np.testing.assert_allclose(model.simulate(still, away)[-1], settled, atol=1e-6)
    np.testing.assert_allclose(model.simulate(still)[-1], settled, atol=1e-9)


def test_a_correction_replaces_the_newest_output_before_the_step():
    model, inputs = calibration(share=0.0), log()
    measured = model.steady.outputs(inputs) - np.array([-1.0, 5.0])
    expected = model.predict(inputs, measured)
    model.reset(inputs[0], measured[0])
    for k in range(1, len(inputs)):
        np.testing.assert_allclose(model.step(inputs[k], measured[k - 1]), expected[k], rtol=1e-9)


def test_its_own_free_run_is_predicted_and_nothing_after_a_masked_sample():
    model, inputs = calibration(), log()
    measured = model.simulate(inputs, [25.0, 333.0])
    predicted = model.predict(inputs, measured)
    np.testing.assert_allclose(predicted[1:], measured[1:], rtol=1e-9)
    measured[20, 0] = np.nan
    unknown = np.isnan(model.predict(inputs, measured)).any(axis=1)
    assert np.flatnonzero(unknown).tolist() == [0, 21]


def plain(count):
    return Scaling(np.zeros(count), np.ones(count))


def test_a_lost_lag_array_is_named():
    meta, arrays = calibration().to_arrays()
    del arrays["lag/half"]
    with pytest.raises(ModelError, match="lag array 'half' has to be of shape"):
        DynamicCalibration.from_arrays(meta, arrays)


def test_lags_of_other_outputs_are_refused():
    message = "the lags are those of N1_pct, the steady-state model's outputs N1_pct, EGT_C"
    with pytest.raises(ModelError, match=message):
        calibration(lags(("N1_pct",)))


def mixture():
    """0.5 lags, 0.2 network, 0.3 ARX in the first output; lags and network alike in the other."""
    arx = Member("arx", 0, poles=(0.9,), gains=((0.05, 0.0), (0.05, 0.0)), weight=0.3)
    return calibration().with_network_share([0.2 / 0.7, 0.5]).with_members([arx])


def test_a_mixture_is_the_weighted_mean_of_its_models():
    model, inputs, start = mixture(), log(), np.array([25.0, 333.0])
    own = calibration()
    network = own.simulate(inputs, start)
    lags = own.with_network_share([0.0, 0.0]).simulate(inputs, start)
    (arx,) = model.members.members
    simple = arx.simulate(own.steady.outputs(inputs), start[0])
    found = model.simulate(inputs, start)
    expected = 0.2 * network[:, 0] + 0.5 * lags[:, 0] + 0.3 * simple
    np.testing.assert_allclose(found[:, 0], expected, rtol=1e-12)
    np.testing.assert_allclose(found[:, 1], 0.5 * (network + lags)[:, 1], rtol=1e-12)
    np.testing.assert_allclose(model.own_alone().simulate(inputs, start), network, rtol=1e-12)


def test_steps_of_a_mixture_are_its_simulation_and_one_step_from_it_is_it():
    model, inputs, start = mixture(), log(), np.array([25.0, 333.0])
    whole = model.simulate(inputs, start)
    steps = [model.reset(inputs[0], start), *map(model.step, inputs[1:])]
    np.testing.assert_allclose(steps, whole, rtol=1e-10)


def test_a_corrected_mixture_goes_on_from_the_measurement():
    model, inputs = mixture(), np.tile([40.0, 0.3], (3, 1))
    model.reset(inputs[0])
    found = model.step(inputs[1], model.steady.outputs(inputs[0]))
    arx = 0.9 * 60.0 + 0.1 * 60.0
    assert found[0] == pytest.approx(0.7 * 60.0 + 0.3 * arx)


def test_a_stored_mixture_comes_back():
    model, inputs = mixture(), log()
    meta, arrays = model.to_arrays()
    loaded = DynamicCalibration.from_arrays(meta, arrays)
    np.testing.assert_array_equal(loaded.simulate(inputs), model.simulate(inputs))


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"channel": 2}, "a member of the mixture does not fit the outputs"),
        ({"gains": [[0.1]]}, "a member of the mixture does not fit the outputs"),
        ({"weight": 1.5}, "a member of the mixture does not fit the outputs"),
        ({"weight": -0.1}, "a member of the mixture does not fit the outputs"),
    ],
)
def test_a_member_that_does_not_fit_is_refused(changed, message):
    meta, arrays = mixture().to_arrays()
    meta["members"] = [{**meta["members"][0], **changed}]
    with pytest.raises(ModelError, match=message):
        DynamicCalibration.from_arrays(meta, arrays)


def test_weights_that_exceed_one_are_refused():
    meta, arrays = mixture().to_arrays()
    meta["members"] = 4 * meta["members"]
    with pytest.raises(ModelError, match="the weights of the mixture exceed one"):
        DynamicCalibration.from_arrays(meta, arrays)


@pytest.mark.parametrize("share", [[0.5], [0.5, 1.1], [0.5, np.nan]])
def test_a_share_that_is_none_is_refused(share):
    with pytest.raises(ModelError, match="'network_share' is no share for each output"):
        calibration().with_network_share(share)
