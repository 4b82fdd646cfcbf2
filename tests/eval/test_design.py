"""Optimal designs against published closed forms, and what the search never does."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from eval.cards.design import Candidates, d_optimal, design, exchanged, filled, i_optimal

NEARLY_NONE = 1e-9  # prior precision


def quadratic(points, copies):
    """Candidates of a quadratic regression on `points`, each `copies` times at a cost of one."""
    x = np.repeat(points, copies)
    f = np.stack([np.ones_like(x), x, x**2], axis=1)
    return x, Candidates(np.einsum("ni,nj->nij", f, f), np.ones(len(x)))


def test_the_d_optimal_quadratic_is_measured_a_third_each_at_both_ends_and_the_middle():
    """Smith, Biometrika 12 (1918); Fedorov 1972, section 2.3."""
    x, candidates = quadratic(np.linspace(-1.0, 1.0, 21), 4)
    chosen = design(candidates, 12.0, d_optimal(NEARLY_NONE * np.eye(3)))
    np.testing.assert_allclose(np.sort(x[chosen]), np.repeat([-1.0, 0.0, 1.0], 4), atol=1e-12)


def test_the_i_optimal_quadratic_is_measured_half_in_the_middle():
    """Weights 1/4, 1/2, 1/4 at -1, 0, 1: Studden, Annals of Statistics 5 (1977)."""
    x, candidates = quadratic(np.linspace(-1.0, 1.0, 21), 6)
    moments = np.array([[1.0, 0.0, 1 / 3], [0.0, 1 / 3, 0.0], [1 / 3, 0.0, 1 / 5]])
    chosen = design(candidates, 12.0, i_optimal(NEARLY_NONE * np.eye(3), moments))
    np.testing.assert_allclose(np.sort(x[chosen]), np.repeat([-1.0, 0.0, 1.0], [3, 6, 3]))


def test_a_decay_is_sampled_at_its_time_constant():
    """y = exp(-t / tau): Box and Lucas, Biometrika 46 (1959)."""
    tau_s, time_s = 1.7, np.linspace(0.1, 6.0, 60)
    slope = time_s / tau_s**2 * np.exp(-time_s / tau_s)
    candidates = Candidates((slope**2)[:, None, None], np.ones(len(time_s)))
    (chosen,) = design(candidates, 1.0, d_optimal(np.array([[NEARLY_NONE]])))
    assert time_s[chosen] == pytest.approx(tau_s)


def test_what_costs_too_much_is_left_out():
    candidates = Candidates(np.array([9.0, 1.0])[:, None, None], np.array([5.0, 1.0]))
    assert design(candidates, 4.0, d_optimal(np.eye(1))) == [1]
    assert design(candidates, 0.5, d_optimal(np.eye(1))) == []


def test_an_exchange_finds_what_gain_per_cost_misses():
    """Twice the information for twice the cost and a bit: greedy takes the small one first."""
    candidates = Candidates(np.array([10.0, 3.0])[:, None, None], np.array([3.0, 1.0]))
    value = d_optimal(np.eye(1))
    first = filled(candidates, 3.0, value, [])
    assert first == [1]
    assert exchanged(candidates, 3.0, value, first) == [0]


@given(seed=st.integers(0, 10_000), d=st.booleans())
def test_an_exchange_never_lowers_the_criterion_nor_passes_the_budget(seed, d):
    random = np.random.default_rng(seed)
    rows = random.normal(size=(12, 2, 4))
    candidates = Candidates(np.einsum("nki,nkj->nij", rows, rows), random.uniform(0.5, 2.0, 12))
    spread = np.cov(random.normal(size=(4, 9)))
    value = d_optimal(np.eye(4)) if d else i_optimal(np.eye(4), spread)
    begun = random.permutation(12)[:3].tolist()
    better = exchanged(candidates, 6.0, value, begun)
    assert value(candidates.total(better)) >= value(candidates.total(begun)) - 1e-12
    assert candidates.cost[better].sum() <= 6.0 + 1e-6
    assert len(set(better)) == len(better)
