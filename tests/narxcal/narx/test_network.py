"""The network: its structure is checked, its output bounded, its arrays complete."""

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from narxcal.narx.config import NarxConfig
from narxcal.narx.module import NarxNet
from narxcal.narx.network import NarxModel, Scaling, history_before, tap
from narxcal.support.errors import ConfigError, DataError, ModelError
from training.dynamics.network import net_of


def model(seed=0, inputs=2, outputs=2, **config):
    torch.manual_seed(seed)
    net = NarxNet(NarxConfig(**config), inputs, outputs)
    with torch.no_grad():
        for parameter in net.parameters():
            parameter.mul_(4.0)
    net.low[:], net.high[:] = -0.7, 0.9
    rng = np.random.default_rng(seed)
    scalings = [Scaling(rng.normal(size=n), 1.0 + rng.random(n)) for n in (inputs, outputs)]
    return NarxModel(net, *scalings)


@settings(max_examples=15)
@given(seed=st.integers(0, 999), size=st.sampled_from([1.0, 1e6, 1e300]))
def test_eighty_minutes_of_wild_inputs_stay_inside_the_bounds(seed, size):
    network = model(seed)
    u = size * np.random.default_rng(seed).uniform(-1.0, 1.0, (48_000, 2))
    with np.errstate(over="ignore", invalid="ignore"):
        y = network.simulate(u, np.zeros(2))[1:]
    low, high = network.bounds
    assert (y >= low - 1e-12).all()
    assert (y <= high + 1e-12).all()


def test_delay_lines_stand_still_before_their_start():
    u = np.array([[1.0], [2.0], [3.0]])
    assert tap(u, (0, 2)).tolist() == [[1.0, 1.0], [2.0, 1.0], [3.0, 1.0]]
    y = np.array([[1.0, 10.0], [2.0, 20.0], [3.0, 30.0]])
    assert history_before(y, 2, 3).tolist() == [2.0, 20.0, 1.0, 10.0, 1.0, 10.0]


def test_some_steps_ahead_are_a_free_run_from_measured_outputs():
    network = model(lags=2, taps=(0, 1))
    rng = np.random.default_rng(1)
    u, y = rng.normal(size=(30, 2)), rng.normal(size=(30, 2))
    for ahead in (1, 2, 5):
        steps = network.predict(u, y, ahead)
        assert np.flatnonzero(np.isnan(steps).any(axis=1)).tolist() == list(range(ahead))
        for k in (ahead + 1, 11, 29):
            free = network.simulate(u[: k + 1], y[: k + 1 - ahead])[k]
            assert free == pytest.approx(steps[k], rel=1e-10)


def test_one_step_ahead_is_unknown_where_the_history_is():
    network = model(lags=2)
    y = np.random.default_rng(0).normal(size=(10, 2))
    y[4, 1] = np.nan
    unknown = np.isnan(network.predict(np.zeros((10, 2)), y)).all(axis=1)
    assert np.flatnonzero(unknown).tolist() == [0, 5, 6]


def test_given_samples_are_returned_as_given():
    start = np.array([[1.0, 2.0], [3.0, 4.0], [0.5, 0.1]])
    assert np.array_equal(model().simulate(np.zeros((9, 2)), start)[:3], start)
    assert np.array_equal(model().simulate(np.zeros((2, 2)), start), start[:2])


def test_weights_pass_through_one_vector():
    one, other = model(0), model(1)
    net_of(other).set_theta(net_of(one).get_theta())
    for a, b in zip(net_of(one).parameters(), net_of(other).parameters(), strict=True):
        assert torch.equal(a, b)


def test_scaling_is_undone_and_spares_constant_channels():
    values = np.column_stack([np.arange(9.0), np.full(9, 5.0)])
    values[3, 0] = np.nan
    scaling = Scaling.of(values)
    assert scaling.scale[1] == 1.0
    np.testing.assert_allclose(scaling.up(scaling.down(values)), values)
    assert Scaling.of(values, centred=False).centre.tolist() == [0.0, 0.0]


@settings(max_examples=10)
@given(seed=st.integers(0, 99), moving=st.integers(0, 2), lags=st.integers(1, 3))
def test_it_comes_back_from_json_and_arrays_as_it_was(seed, moving, lags):
    network = model(seed, moving=moving, lags=lags)
    again = NarxModel.from_arrays(*network.to_arrays())
    u = np.random.default_rng(0).normal(size=(50, 2))
    assert np.array_equal(again.simulate(u, np.zeros(2)), network.simulate(u, np.zeros(2)))
    assert again.config == network.config


def test_a_misshapen_weight_is_named():
    meta, arrays = model().to_arrays()
    arrays["hidden.bias"] = np.zeros(3)
    with pytest.raises(ModelError) as error:
        NarxModel.from_arrays(meta, arrays)
    assert str(error.value) == "weight 'hidden.bias' has to be of shape (8,), found (3,)"
    del arrays["hidden.bias"]
    with pytest.raises(ModelError) as error:
        NarxModel.from_arrays(meta, arrays)
    assert str(error.value) == "weight 'hidden.bias' has to be of shape (8,), found None"


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        (
            "output_scaling.scale",
            7e-221,
            "'output_scaling.scale' has to be at least 1e-09, found 7e-221",
        ),
        (
            "input_scaling.centre",
            -5e287,
            "'input_scaling.centre' is too large for its scale to leave a digit",
        ),
    ],
)
def test_a_scaling_that_no_data_give_is_refused(name, value, message):
    meta, arrays = model().to_arrays()
    arrays[name] = np.array([1.0, value])
    with pytest.raises(ModelError) as error:
        NarxModel.from_arrays(meta, arrays)
    assert str(error.value) == message


def test_inputs_and_starts_of_another_shape_are_refused():
    with pytest.raises(DataError) as error:
        model().simulate(np.zeros((5, 3)), np.zeros(2))
    assert str(error.value) == "expected inputs of shape (time, 2), found (5, 3)"
    with pytest.raises(DataError) as error:
        model().simulate(np.zeros((5, 2)), [0.0, np.nan])
    assert str(error.value) == (
        "expected finite start values of shape (n, 2), found (1, 2) with 1 not finite"
    )
    with pytest.raises(DataError, match=r"^expected outputs of shape \(5, 2\), found \(4, 2\)$"):
        model().predict(np.zeros((5, 2)), np.zeros((4, 2)))
    holed = np.zeros((5, 2))
    holed[3, 1] = np.nan
    with pytest.raises(DataError, match=r"^row 3: an input is not a finite number"):
        model().simulate(holed, np.zeros(2))


@pytest.mark.parametrize(
    ("table", "message"),
    [
        (
            {"taps": [1, 0]},
            ("key 'taps': has to list increasing delays >= 0, for example [0, 1], found [1, 0]"),
        ),
        ({"lags": 0}, "key 'lags': Input should be greater than or equal to 1, found 0"),
        ({"hiden": 3}, "unknown key 'hiden'. Did you mean 'hidden'?"),
    ],
)
def test_an_impossible_structure_is_refused(table, message):
    with pytest.raises(ConfigError) as error:
        NarxConfig.parse(table)
    assert str(error.value) == message


@pytest.mark.parametrize("taps", [[], [-1], [2, 2], [3, 1]])
def test_delays_have_to_increase_from_zero(taps):
    with pytest.raises(ConfigError, match="has to list increasing delays"):
        NarxConfig.parse({"taps": taps})


def test_with_linear_feedback_past_outputs_reach_the_linear_path_alone():
    net = NarxNet(NarxConfig(lags=2, taps=(0,), hidden=3, linear_feedback=True), 4, 2)
    assert not net.hidden.weight[:, :4].any()
    assert net.hidden.weight[:, 4:].all()
    with torch.no_grad():
        for parameter in net.parameters():
            parameter.fill_(1.0)
    free = net.get_theta()[net.trained() == 0.0]
    assert len(free) == 3 * 4
    assert NarxNet(NarxConfig(lags=2, taps=(0,), hidden=3), 4, 2).trained().all()
