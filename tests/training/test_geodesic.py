"""Bent steps: the same optimum as straight ones, reached in fewer steps where valleys bend."""

from itertools import islice

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.training.test_levenberg_marquardt import (
    LeastSquares,
    decay_curve,
    linear_problem,
    rosenbrock,
)
from training.levenberg_marquardt import Damping, minimise, minimise_geodesic


class Curved(LeastSquares):
    """Least squares that tells how the residuals bend, by central differences."""

    def curvature(self, theta, step):
        ahead, here, behind = (self.residual(theta + s * step) for s in (1e-3, 0.0, -1e-3))
        bend = (ahead - 2.0 * here + behind) / 1e-6
        columns = [self.residual(theta + 1e-30j * unit).imag / 1e-30 for unit in np.eye(len(theta))]
        return np.stack(columns) @ bend


def steps_to_the_end(descend, start):
    path = islice(descend(Curved(rosenbrock), np.array(start)), 200)
    return next(k for k, step in enumerate(path, 1) if step.loss < 1e-12)


def test_rosenbrocks_valley_is_followed_in_fewer_steps_than_straight_ones_take():
    start = (-1.2, 1.0)
    straight = steps_to_the_end(minimise, start)
    assert steps_to_the_end(minimise_geodesic, start) < 0.7 * straight


def test_where_nothing_bends_the_step_is_straight():
    problem, matrix, target = linear_problem()
    curved = Curved(problem.residual)
    curved.curvature = lambda theta, _: np.zeros_like(theta)
    *_, last = islice(minimise_geodesic(curved, np.ones(5), decay=3.0), 12)
    exact = np.linalg.solve(matrix.T @ matrix + 3.0 * np.eye(5), matrix.T @ target)
    np.testing.assert_allclose(last.theta, exact, rtol=1e-7)


def test_the_optimum_is_that_of_straight_steps():
    start = np.array([1.0, 0.5, 0.0])
    *_, bent = islice(minimise_geodesic(Curved(decay_curve), start), 40)
    *_, straight = islice(minimise(Curved(decay_curve), start), 60)
    np.testing.assert_allclose(bent.theta, straight.theta, rtol=1e-6)


@settings(max_examples=20, deadline=None)
@given(start=st.tuples(st.floats(-3, 3), st.floats(-3, 3)), decay=st.sampled_from([0.0, 1e-3, 0.3]))
def test_every_step_goes_downhill(start, decay):
    theta = np.array(start)
    before = LeastSquares(rosenbrock).loss(theta) + 0.5 * decay * float(theta @ theta)
    for step in islice(minimise_geodesic(Curved(rosenbrock), theta, decay), 30):
        assert step.loss < before
        before = step.loss


def test_stopping_and_going_on_is_the_same_path():
    problem, start = Curved(decay_curve), np.array([5.0, 4.0, -3.0])
    whole = list(islice(minimise_geodesic(problem, start), 10))
    kept = whole[3]
    rest = islice(minimise_geodesic(problem, kept.theta, damping=kept.damping), 6)
    for one, other in zip(whole[4:], rest, strict=True):
        assert np.array_equal(one.theta, other.theta)
        assert one.damping == other.damping


@pytest.mark.parametrize("bend", [1e3, np.nan])
def test_a_step_that_bends_too_much_is_not_taken_before_it_is_short(bend):
    problem = Curved(rosenbrock)
    asked = []

    def curvature(theta, step):
        asked.append(float(step @ step))
        return np.full(2, bend) if len(asked) < 4 else np.zeros(2)

    problem.curvature = curvature
    first = next(minimise_geodesic(problem, np.array([-1.2, 1.0]), damping=Damping(1.0)))
    assert len(asked) >= 4
    assert asked == sorted(asked, reverse=True)
    assert first.loss < problem.loss(np.array([-1.2, 1.0]))
