"""Shapley values: they add up, and for fixed components they are known in closed form."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from training.budget.shares import additive, shapley


@given(st.integers(1, 4), st.integers(0, 2**32 - 1))
def test_shares_add_up_to_what_all_take(causes, seed):
    random, known = np.random.default_rng(seed), {frozenset(): np.zeros(2)}

    def worth(chosen):
        return known.setdefault(chosen, random.normal(size=2))

    split = shapley(causes, worth)
    assert split.shares.sum(axis=0) == pytest.approx(worth(frozenset(range(causes))))


def test_fixed_components_take_their_product_with_twice_the_gap_less_all():
    random = np.random.default_rng(3)
    gap, parts = random.normal(size=50), random.normal(size=(3, 50))

    def worth(chosen):
        left = gap - sum((parts[k] for k in chosen), np.zeros(50))
        return np.array((gap**2).sum() - (left**2).sum())

    expected = additive(gap, list(parts)).sum(axis=1)
    assert shapley(3, worth).shares == pytest.approx(expected)


def test_alone_and_last_are_the_ends_of_two_orders():
    gap, parts = np.array([1.0, 0.0]), np.array([[1.0, 0.0], [0.5, 0.0]])

    def worth(chosen):
        left = gap - sum((parts[k] for k in chosen), np.zeros(2))
        return np.array(1.0 - (left**2).sum())

    split = shapley(2, worth)
    assert split.first.tolist() == [1.0, 0.75]
    assert split.last.tolist() == [0.0, -0.25]
    assert split.shares.tolist() == [0.5, 0.25]
