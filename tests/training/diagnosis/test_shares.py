"""Shares of the squared gap: they add up, and are the Shapley values of fixed components."""

from itertools import permutations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from training.diagnosis.budget import split


def taken(gap, parts, causes):
    return (gap**2).sum() - ((gap - parts[list(causes)].sum(axis=0)) ** 2).sum()


@given(st.integers(1, 4), st.integers(0, 2**32 - 1))
def test_shares_are_means_over_all_orders_of_entering(causes, seed):
    random = np.random.default_rng(seed)
    gap, parts = random.normal(size=20), random.normal(size=(causes, 20))
    found = split(gap, list(parts))
    orders = list(permutations(range(causes)))
    for k in range(causes):
        added = [
            taken(gap, parts, [*order[: order.index(k)], k])
            - taken(gap, parts, order[: order.index(k)])
            for order in orders
        ]
        assert found.shares[k].sum() == pytest.approx(np.mean(added), abs=1e-9)
    assert found.shares.sum() == pytest.approx(taken(gap, parts, range(causes)), abs=1e-9)


def test_first_and_last_are_the_ends_of_two_orders():
    gap, parts = np.array([1.0, 0.0]), [np.array([1.0, 0.0]), np.array([0.5, 0.0])]
    found = split(gap, parts)
    assert found.first.sum(axis=1).tolist() == [1.0, 0.75]
    assert found.last.sum(axis=1).tolist() == [0.0, -0.25]
    assert found.shares.sum(axis=1).tolist() == [0.5, 0.25]
