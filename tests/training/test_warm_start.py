"""A training starts from a linear model that a free run can bear."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from narxcal.narx.config import NarxConfig
from narxcal.record import Record
from training.free_run import FreeRunProblem, cut_windows
from training.network import net_of, new_model, start_linear

configs = st.builds(
    NarxConfig,
    lags=st.integers(1, 4),
    taps=st.sampled_from([(0,), (0, 1), (1, 2)]),
    hidden=st.integers(1, 4),
    moving=st.integers(0, 1),
)


def started(records, config, seed=0):
    model = new_model(records, config, seed)
    problem = FreeRunProblem(net_of(model), cut_windows(model, records, None))
    start_linear(model, records, problem)
    return model, problem


def test_a_linear_system_is_found_at_once():
    rng = np.random.default_rng(0)
    u = rng.normal(size=400)
    y = np.zeros(400)
    for k in range(1, 400):
        y[k] = 0.8 * y[k - 1] + 0.5 * u[k]
    model, _ = started([Record(u, y)], NarxConfig(lags=1, taps=(0,), hidden=2))
    np.testing.assert_allclose(model.simulate(u[:, None], y[:1]), y[:, None], atol=1e-3)


@settings(max_examples=25, deadline=None)
@given(config=configs, seed=st.integers(0, 99), drift=st.booleans())
def test_it_never_diverges(config, seed, drift):
    rng = np.random.default_rng(seed)
    u = rng.normal(size=(120, 2))
    y = np.cumsum(rng.normal(size=(120, 2)), axis=0) if drift else rng.normal(size=(120, 2))
    y[30:34, 0] = np.nan
    model, problem = started([Record(u, y)], config)
    free_run = model.simulate(10.0 * rng.normal(size=(5000, 2)), np.zeros(2))[1:]
    low, high = model.bounds
    assert (free_run >= low - 1e-9).all()
    assert (free_run <= high + 1e-9).all()
    # A model of the mean alone is among what it had to choose from, up to the ridge.
    variance = 0.5 * np.nanmean(model.output_scaling.down(y) ** 2)
    assert problem.loss(net_of(model).get_theta()) <= 1.1 * variance + 1e-9


def test_bounds_are_the_envelope_and_a_margin():
    y = np.linspace(-10.0, 30.0, 50)
    model = new_model([Record(y, y)], NarxConfig(margin=0.25), 0)
    np.testing.assert_allclose(np.ravel(model.bounds), [-20.0, 40.0])


def test_an_input_that_hardly_varies_is_scaled_as_if_it_varied_as_much_as_asked():
    u = np.column_stack([np.linspace(0.0, 1.0, 50), np.linspace(0.0, 300.0, 50)])
    record = Record(u, u[:, 0])
    plain = new_model([record], NarxConfig(), 0).input_scaling.scale
    asked = new_model([record], NarxConfig(), 0, np.array([0.0, 3000.0])).input_scaling.scale
    assert asked.tolist() == [plain[0], 3000.0]


def test_bounds_of_an_anchored_network_hold_its_rest():
    y = np.linspace(20.0, 30.0, 50)
    model = new_model([Record(y, y)], NarxConfig(margin=0.1, moving=1), 0)
    np.testing.assert_allclose(np.ravel(model.bounds), [-3.0, 33.0])
    assert model.output_scaling.centre == pytest.approx([0.0])
    assert model.input_scaling.centre == pytest.approx([0.0])


def test_an_anchored_start_rests_at_zero():
    rng = np.random.default_rng(0)
    u = np.column_stack([rng.normal(size=200), np.full(200, 3.0) + rng.normal(size=200)])
    y = np.convolve(u[:, 0], 0.5 ** np.arange(8))[:200] + 5.0
    model, _ = started([Record(u, y)], NarxConfig(moving=1))
    still = np.column_stack([np.zeros(50), np.full(50, 4.0)])
    np.testing.assert_allclose(model.simulate(still, [0.0]), 0.0, atol=1e-12)


def test_the_seed_draws_the_hidden_layer_and_nothing_else():
    record = Record(np.arange(30.0), np.arange(30.0) ** 2)
    one, same, other = (new_model([record], NarxConfig(), seed) for seed in (1, 1, 2))
    assert np.array_equal(net_of(one).get_theta(), net_of(same).get_theta())
    assert not np.array_equal(net_of(one).get_theta(), net_of(other).get_theta())
    assert not net_of(one).output.weight.any()
    assert not net_of(one).linear.weight.any()
