"""Optimisers on problems whose answers are known, against those of scipy and torch."""

from dataclasses import dataclass
from itertools import islice

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import least_squares

from training.dynamics.optimisers import Damping, adam, minimise


@dataclass
class Point:
    loss: float
    gradient: np.ndarray
    hessian: np.ndarray


class LeastSquares:
    """Half the sum of squares of `residual`, with the Jacobian by complex steps."""

    def __init__(self, residual):
        self.residual = residual

    def loss(self, theta):
        return 0.5 * float((self.residual(theta) ** 2).sum())

    def normal_equations(self, theta):
        units = np.eye(len(theta))
        columns = [self.residual(theta + 1e-30j * unit).imag / 1e-30 for unit in units]
        jacobian, error = np.stack(columns, axis=1), self.residual(theta)
        return Point(self.loss(theta), jacobian.T @ error, jacobian.T @ jacobian)


def linear_problem(seed=0):
    rng = np.random.default_rng(seed)
    matrix, target = rng.normal(size=(40, 5)), rng.normal(size=40)
    return LeastSquares(lambda theta: matrix @ theta - target), matrix, target


def rosenbrock(theta):
    return np.array([10.0 * (theta[1] - theta[0] ** 2), 1.0 - theta[0]])


def decay_curve(theta):
    time = np.linspace(0.0, 4.0, 60)
    target = 2.0 * np.exp(-1.3 * time) + 0.5 + 0.05 * np.sin(40.0 * time)
    return theta[0] * np.exp(-theta[1] * time) + theta[2] - target


def test_a_linear_problem_is_solved_in_few_steps():
    problem, matrix, target = linear_problem()
    steps = list(islice(minimise(problem, np.zeros(5)), 6))
    exact = np.linalg.lstsq(matrix, target, rcond=None)[0]
    np.testing.assert_allclose(steps[-1].theta, exact, rtol=1e-8)


@pytest.mark.parametrize("start", [(-1.2, 1.0), (3.0, -5.0), (0.0, 0.0)])
def test_the_curved_valley_of_rosenbrock_is_followed_to_its_end(start):
    steps = list(islice(minimise(LeastSquares(rosenbrock), np.array(start)), 100))
    np.testing.assert_allclose(steps[-1].theta, [1.0, 1.0], atol=1e-6)


def test_the_optimum_is_that_of_scipy():
    start = np.array([1.0, 0.5, 0.0])
    *_, last = islice(minimise(LeastSquares(decay_curve), start), 60)
    theirs = least_squares(decay_curve, start, method="lm", xtol=1e-14, ftol=1e-14)
    np.testing.assert_allclose(last.theta, theirs.x, rtol=1e-6)
    assert last.loss == pytest.approx(theirs.cost, rel=1e-9)


def test_decay_is_a_ridge():
    problem, matrix, target = linear_problem()
    *_, last = islice(minimise(problem, np.ones(5), decay=3.0), 12)
    exact = np.linalg.solve(matrix.T @ matrix + 3.0 * np.eye(5), matrix.T @ target)
    np.testing.assert_allclose(last.theta, exact, rtol=1e-7)


@given(start=st.tuples(st.floats(-3, 3), st.floats(-3, 3)), decay=st.sampled_from([0.0, 1e-3, 0.3]))
def test_every_step_goes_downhill(start, decay):
    theta, problem = np.array(start), LeastSquares(rosenbrock)
    before = problem.loss(theta) + 0.5 * decay * float(theta @ theta)
    for step in islice(minimise(problem, theta, decay), 30):
        assert step.loss < before
        before = step.loss


@settings(max_examples=12)
@given(stop=st.integers(1, 9))
def test_stopping_anywhere_and_going_on_is_the_same_path(stop):
    problem, start = LeastSquares(decay_curve), np.array([5.0, 4.0, -3.0])
    whole = list(islice(minimise(problem, start), 10))
    stop = min(stop, len(whole))
    kept = whole[stop - 1]
    rest = islice(minimise(problem, kept.theta, damping=kept.damping), len(whole) - stop)
    for one, other in zip(whole[stop:], rest, strict=True):
        assert np.array_equal(one.theta, other.theta)
        assert one.loss == other.loss
        assert one.damping == other.damping


def test_at_the_bottom_it_ends_by_itself():
    assert list(minimise(LeastSquares(lambda theta: theta), np.zeros(3))) == []


def test_a_weight_without_influence_is_left_alone():
    problem = LeastSquares(lambda theta: np.array([theta[0] - 4.0, 0.0 * theta[1]]))
    *_, last = islice(minimise(problem, np.array([0.0, 7.0])), 20)
    assert last.theta == pytest.approx([4.0, 7.0])


def test_a_step_into_nonsense_is_not_taken():
    def residual(theta):
        return np.where(np.real(theta) > 1.0, np.nan, theta - 3.0)

    path = list(islice(minimise(LeastSquares(residual), np.zeros(1)), 200))
    assert path
    assert all(np.isfinite(step.loss) and step.theta[0] <= 1.0 for step in path)


def test_there_is_no_step_from_where_a_run_diverges():
    diverging = LeastSquares(lambda theta: np.array([1e200 * theta[0], theta[1]]))
    with np.errstate(over="ignore"):
        assert list(islice(minimise(diverging, np.ones(2)), 3)) == []


def test_damping_follows_nielsens_rule():
    assert Damping(1.0).worse().worse() == Damping(8.0, 8.0)
    assert Damping(1.0, 8.0).better(1.0) == Damping(1.0 / 3.0)
    assert Damping(1.0).better(0.5) == Damping(1.0)
    assert Damping(1.0).better(0.0) == Damping(2.0)
    assert Damping(1e-12).better(1.0).value == 1e-12


# Adam.
BEGIN = np.array([-1.2, 1.0, 0.3])


def by_torch(theta):
    return (10.0 * (theta[1] - theta[0] ** 2)) ** 2 + (1.0 - theta[0]) ** 2 + torch.cosh(theta[2])


class Smooth:
    def gradient(self, theta):
        at = torch.tensor(theta, requires_grad=True)
        loss = by_torch(at)
        loss.backward()
        return loss.item(), at.grad.numpy()


@pytest.mark.parametrize("decay", [0.0, 0.2])
def test_the_path_of_adam_is_that_of_torch(decay):
    theta = torch.nn.Parameter(torch.from_numpy(BEGIN.copy()))
    optimiser = torch.optim.Adam([theta], lr=0.05)
    for step in islice(adam(Smooth(), BEGIN, 0.05, decay), 50):
        optimiser.zero_grad()
        loss = by_torch(theta) + 0.5 * decay * (theta**2).sum()
        assert step.loss == pytest.approx(loss.item(), rel=1e-12)
        loss.backward()
        optimiser.step()
        np.testing.assert_allclose(step.theta, theta.detach().numpy(), rtol=1e-12)


def test_adam_goes_downhill():
    losses = [step.loss for step in islice(adam(Smooth(), BEGIN, 0.02), 400)]
    assert losses[-1] < 0.2 * losses[0]


@settings(max_examples=15)
@given(stop=st.integers(1, 19))
def test_adam_stopped_anywhere_goes_on_as_if_it_had_not(stop):
    whole = list(islice(adam(Smooth(), BEGIN, 0.05), 20))
    first = list(islice(adam(Smooth(), BEGIN, 0.05), stop))
    kept = first[-1]
    rest = islice(adam(Smooth(), kept.theta, 0.05, moments=kept.moments), 20 - stop)
    for one, other in zip(whole, [*first, *rest], strict=True):
        assert np.array_equal(one.theta, other.theta)
        assert one.loss == other.loss
        assert np.array_equal(one.moments.second, other.moments.second)


def test_steps_of_adam_do_not_change_afterwards():
    first, *rest = islice(adam(Smooth(), BEGIN, 0.05), 5)
    again = next(adam(Smooth(), BEGIN, 0.05))
    assert np.array_equal(first.theta, again.theta)
    assert np.array_equal(first.moments.first, again.moments.first)
    assert [step.moments.steps for step in (first, *rest)] == [1, 2, 3, 4, 5]
    assert np.array_equal(BEGIN, [-1.2, 1.0, 0.3])
