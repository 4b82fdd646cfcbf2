"""Adam against torch.optim.Adam with autograd, and against itself when stopped."""

from itertools import islice

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from training.adam import minimise

START = np.array([-1.2, 1.0, 0.3])


def by_torch(theta):
    return (10.0 * (theta[1] - theta[0] ** 2)) ** 2 + (1.0 - theta[0]) ** 2 + torch.cosh(theta[2])


class Problem:
    def gradient(self, theta):
        at = torch.tensor(theta, requires_grad=True)
        loss = by_torch(at)
        loss.backward()
        return loss.item(), at.grad.numpy()


@pytest.mark.parametrize("decay", [0.0, 0.2])
def test_the_path_is_that_of_torch(decay):
    theta = torch.nn.Parameter(torch.from_numpy(START.copy()))
    optimiser = torch.optim.Adam([theta], lr=0.05)
    for step in islice(minimise(Problem(), START, 0.05, decay), 50):
        optimiser.zero_grad()
        loss = by_torch(theta) + 0.5 * decay * (theta**2).sum()
        assert step.loss == pytest.approx(loss.item(), rel=1e-12)
        loss.backward()
        optimiser.step()
        np.testing.assert_allclose(step.theta, theta.detach().numpy(), rtol=1e-12)


def test_it_goes_downhill():
    losses = [step.loss for step in islice(minimise(Problem(), START, 0.02), 400)]
    assert losses[-1] < 0.2 * losses[0]


@settings(max_examples=15, deadline=None)
@given(stop=st.integers(1, 19))
def test_stopping_anywhere_and_going_on_is_the_same_path(stop):
    whole = list(islice(minimise(Problem(), START, 0.05), 20))
    first = list(islice(minimise(Problem(), START, 0.05), stop))
    kept = first[-1]
    rest = islice(minimise(Problem(), kept.theta, 0.05, moments=kept.moments), 20 - stop)
    for one, other in zip(whole, [*first, *rest], strict=True):
        assert np.array_equal(one.theta, other.theta)
        assert one.loss == other.loss
        assert np.array_equal(one.moments.second, other.moments.second)


def test_steps_taken_before_do_not_change_afterwards():
    first, *rest = islice(minimise(Problem(), START, 0.05), 5)
    again = next(minimise(Problem(), START, 0.05))
    assert np.array_equal(first.theta, again.theta)
    assert np.array_equal(first.moments.first, again.moments.first)
    assert [step.moments.steps for step in (first, *rest)] == [1, 2, 3, 4, 5]
    assert np.array_equal(START, [-1.2, 1.0, 0.3])
