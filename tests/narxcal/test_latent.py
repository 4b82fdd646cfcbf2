"""Latent-state models: the compiled run against its equations, sensitivities, start, storage."""

import numpy as np
import pytest

from narxcal.narx.forms import Ensemble, pack, unpack
from narxcal.narx.latent import (
    LatentModel,
    Shape,
    delayed,
    latent_jacobian,
    latent_run,
    unbounded,
)
from narxcal.narx.network import Scaling
from narxcal.support.errors import ModelError

SHAPE = Shape(states=2, inputs=2, outputs=2, hidden=3, delay=(0, 3))


def drawn(seed=0, shape=SHAPE):
    draw = np.random.default_rng(seed)
    theta = 0.3 * draw.standard_normal(shape.size)
    return theta, draw.standard_normal((40, shape.inputs)), draw.standard_normal(shape.states)


def slowly(theta, u, x, shape=SHAPE):
    linear, bent, slopes = shape.parts(theta)
    found = []
    for row in u:
        v = np.concatenate([x, row, [1.0]])
        both = linear @ v + bent @ np.tanh(slopes @ v)
        x = both[: shape.states]
        found.append(both[shape.states :])
    return np.array(found)


def test_the_compiled_run_is_its_equations():
    theta, u, x0 = drawn()
    y = latent_run(SHAPE.parts(theta), u, x0, unbounded(2))[2]
    np.testing.assert_allclose(y, slowly(theta, u, x0), rtol=1e-12, atol=1e-13)


def test_sensitivities_are_differences_and_the_same_in_blocks():
    theta, u, x0 = drawn(1)
    parts, root = SHAPE.parts(theta), np.full((len(u), 2), 2.0)
    root[5, 1] = 0.0
    states, active, _, _ = latent_run(parts, u, x0, unbounded(2))
    seed = np.zeros((2, SHAPE.size + 2))
    seed[:, -2:] = np.eye(2)
    sensitivity, rows = seed.copy(), []
    for part in (slice(0, 17), slice(17, 40)):
        run = (u[part], states[part], active[part])
        rows.append(latent_jacobian(parts, run, sensitivity, root[part], unbounded(2)))
    by_x0 = latent_jacobian(parts, (u, states, active), np.eye(2), root, unbounded(2))
    np.testing.assert_allclose(by_x0, np.concatenate(rows)[:, -2:], rtol=1e-12, atol=1e-14)
    both = np.concatenate([theta, x0])
    slopes = []
    for k in range(len(both)):
        step = np.zeros(len(both))
        step[k] = 1e-6
        ahead, behind = (slowly(z[:-2], u, z[-2:]) for z in (both + step, both - step))
        slopes.append((2.0 * (ahead - behind) / 2e-6)[root > 0.0])
    np.testing.assert_allclose(np.concatenate(rows), np.array(slopes).T, rtol=1e-5, atol=1e-7)


def test_states_stay_inside_their_bounds():
    theta, u, x0 = drawn(2)
    parts = SHAPE.parts(20.0 * theta)
    states = latent_run(parts, u, x0, (np.full(2, -5.0), np.full(2, 5.0)))[0]
    assert np.abs(states[1:]).max() <= 5.0


def test_dead_time_shifts_each_input_by_its_own():
    u = np.arange(10.0).reshape(5, 2)
    np.testing.assert_array_equal(delayed(u, (0, 2))[:, 1], [1.0, 1.0, 1.0, 3.0, 5.0])
    np.testing.assert_array_equal(delayed(u, (0, 2))[:, 0], u[:, 0])


def one_lag(pole=0.9, noise=0.01):
    """x+ = pole x + (1 - pole) u, y = x."""
    shape = Shape(1, 1, 1, 0, (0,))
    theta = np.array([pole, 1.0 - pole, 0.0, 1.0, 0.0, 0.0])
    one = Scaling(np.zeros(1), np.ones(1))
    return LatentModel(
        shape, theta, unbounded(1), one, one, np.array([noise]), np.array([0.5]), memory=40
    )


def test_a_free_run_starts_from_what_was_measured_and_from_equilibrium_without_it():
    model = one_lag()
    u = np.ones((60, 1))
    free = model.simulate(u, np.full((1, 1), 3.0))
    expected = 1.0 + 2.0 * 0.9 ** np.arange(60)
    np.testing.assert_allclose(free[:, 0], expected, atol=2e-3)
    np.testing.assert_allclose(model.equilibrium(np.ones(1)), [1.0 - 0.9**40], atol=1e-12)
    assert model.simulate(u, np.full((1, 1), 3.0)).shape == (60, 1)


def test_noise_of_the_start_is_averaged_over_its_window():
    model, draw = one_lag(noise=0.3), np.random.default_rng(0)
    u = np.zeros((80, 1))
    truth = 0.9 ** np.arange(80)
    start = truth[:30, None] + 0.3 * draw.standard_normal((30, 1))
    free = model.simulate(u, start)
    assert abs(free[30, 0] - truth[30]) < 0.05
    np.testing.assert_array_equal(free[:30], start)


def test_one_step_is_the_free_run_and_half_its_last_error():
    model = one_lag()
    u, y = np.zeros((50, 1)), np.zeros((50, 1))
    y[40] = 2.0
    steps = model.predict(u, y)
    assert np.isnan(steps[0, 0])
    np.testing.assert_allclose(steps[41, 0], 1.0, atol=1e-6)
    ahead = model.predict(u, y, 3)
    assert np.flatnonzero(np.isnan(ahead)).tolist() == [0, 1, 2]
    np.testing.assert_allclose(ahead[43, 0], 2.0 * 0.5**3, atol=1e-6)


@pytest.mark.parametrize("weights", [(), (0.25, 0.75)])
def test_any_form_is_stored_and_rebuilt(weights):
    model = Ensemble((one_lag(0.9), one_lag(0.5)), weights)
    meta, arrays = pack(model)
    again = unpack(meta, arrays)
    u, start = np.linspace(0.0, 1.0, 30)[:, None], np.zeros((2, 1))
    np.testing.assert_array_equal(again.simulate(u, start), model.simulate(u, start))
    with pytest.raises(ModelError, match=r"^array 'theta' has to be of shape \(6,\), found None$"):
        unpack(meta, {name: a for name, a in arrays.items() if name != "0.theta"})


def test_the_median_of_members_does_not_follow_one_that_leaves():
    u, start = np.ones((30, 1)), np.zeros((1, 1))
    models = [one_lag(pole) for pole in (0.5, 0.6, 0.999)]
    np.testing.assert_array_equal(
        Ensemble.median(models).simulate(u, start), models[1].simulate(u, start)
    )
