"""Least squares within bounds against a general minimiser."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import minimize

from narxcal.effects.base import Parameter
from training.gap.bounded import least_within, room, without


@given(seed=st.integers(0, 10_000), width=st.floats(0.01, 3.0))
def test_least_squares_within_bounds_is_what_a_general_minimiser_finds(seed, width):
    random = np.random.default_rng(seed)
    root = random.normal(size=(9, 4))
    hessian, toward = root.T @ root, random.normal(size=4) * 5.0
    bounds = np.stack([-width * np.ones(4), width * random.uniform(0.0, 2.0, 4)], axis=1)
    found = least_within(hessian, toward, bounds)
    value = lambda x: x @ hessian @ x - 2.0 * x @ toward  # noqa: E731 - the formula itself
    best = minimize(value, np.zeros(4), bounds=bounds, method="L-BFGS-B", tol=1e-14)
    assert value(found) <= best.fun + 1e-3 * (1.0 + abs(best.fun))
    assert (found >= bounds[:, 0] - 1e-6).all()
    assert (found <= bounds[:, 1] + 1e-6).all()


def test_a_parameter_without_any_room_stays_and_the_others_make_up_for_it():
    hessian, toward = np.array([[1.0, 0.9], [0.9, 1.0]]), np.array([1.0, 1.0])
    found = least_within(hessian, toward, np.array([[0.0, 0.0], [-5.0, 5.0]]))
    np.testing.assert_allclose(found, [0.0, 1.0], atol=1e-5)


def test_what_changes_nothing_is_left_where_it_is():
    found = least_within(np.diag([2.0, 0.0]), np.array([1.0, 0.0]), np.array([[-9.0, 9.0]] * 2))
    np.testing.assert_allclose(found, [0.5, 0.0], atol=1e-5)


def test_the_room_of_a_parameter_is_what_its_bounds_leave():
    parameters = [Parameter("a", "s", 0.0, 3.0, 0.0, (1.0,)), Parameter("b", "-", -1.0, 1.0, 0.0)]
    np.testing.assert_allclose(room(np.array([0.5, 1.0]), parameters), [[-0.5, 2.5], [-2.0, 0.0]])


@given(seed=st.integers(0, 10_000))
def test_without_a_flight_the_others_are_what_is_left(seed):
    """Where all of them tell of a parameter, to a thousandth of what they say."""
    random = np.random.default_rng(seed)
    roots = random.normal(size=(4, 30, 3))
    hessian = np.einsum("fkp,fkq->fpq", roots, roots)
    toward = random.normal(size=(4, 3)) * 10.0
    wide = np.array([[-1e3, 1e3]] * 3)
    found = least_within(*without((hessian, toward), 1), wide)
    exact = np.linalg.solve(hessian[[0, 2, 3]].sum(axis=0), toward[[0, 2, 3]].sum(axis=0))
    np.testing.assert_allclose(found, exact, atol=0.01 * (1.0 + np.abs(exact).max()))
    narrow = least_within(*without((hessian, toward), 1, 3), wide)
    np.testing.assert_allclose(narrow, exact, atol=1e-4 * (1.0 + np.abs(exact).max()))


def test_what_one_flight_alone_tells_stays_where_it_is_without_it():
    """The others' noise says that it is 1000 times as large."""
    hessian = np.zeros((3, 2, 2))
    hessian[:, 0, 0], hessian[:, 1, 1] = 5.0, (50.0, 1e-7, 1e-7)
    toward = np.array([[1.0, 3.0], [1.0, 1e-4], [1.0, 1e-4]])
    wide = np.array([[-1e6, 1e6]] * 2)
    found = least_within(*without((hessian, toward), 0), wide)
    np.testing.assert_allclose(found, [0.2, 0.0], atol=0.01)
    assert least_within(*without((hessian, toward), 0, 2), wide)[1] > 900.0


@pytest.mark.parametrize("nothing", [0.0, -1e-11, 1e-25])
def test_a_direction_in_which_nothing_moves_is_not_gone(nothing):
    """Rounding leaves more off its diagonal than on it, and something to go toward."""
    hessian = np.array([[4.0, 1e-9, 1.0], [1e-9, nothing, 1e-9], [1.0, 1e-9, 9.0]])
    wide = np.array([[-9.0, 9.0]] * 3)
    found = least_within(hessian, np.array([4.0, 1e-12, 9.0]), wide)
    others = np.linalg.solve(hessian[::2, ::2], [4.0, 9.0])
    assert found[::2] == pytest.approx(others, rel=1e-4)
    if nothing <= 0.0:
        assert found[1] == 0.0
    assert np.all(np.abs(found) <= 9.0)
