"""Particle swarm: minima found, seeds, draws of the paper, constants."""

import numpy as np
import pytest

from training.papers.swarm import CHI, INFLUENCE, swarm

LOW, HIGH = np.full(4, -5.0), np.full(4, 5.0)
CENTRE = np.array([1.0, -2.0, 0.5, 3.0])


def sphere(x):
    return np.sum((x - CENTRE) ** 2, axis=1)


def rastrigin(x):
    return np.sum(x**2 - 10.0 * np.cos(2.0 * np.pi * x) + 10.0, axis=1)


def test_constants_of_the_standard_and_bounded_second_moments():
    assert pytest.approx(0.72984, abs=5e-6) == CHI
    assert INFLUENCE["uniform"] == pytest.approx(1.49618, abs=5e-6)
    assert INFLUENCE["uniform"] < 12.0 * (1.0 - CHI**2) / (7.0 - 5.0 * CHI)
    assert INFLUENCE["binary"] < 4.0 * (1.0 - CHI**2) / (3.0 - CHI) < INFLUENCE["uniform"]


@pytest.mark.parametrize("draws", INFLUENCE)
def test_the_minimum_of_a_bowl_is_found(draws):
    found = swarm(sphere, LOW, HIGH, 1, draws)
    np.testing.assert_allclose(found.best, CENTRE, atol=1e-4)
    assert found.status == "converged"


def test_the_best_of_several_seeds_finds_the_lowest_of_many_minima():
    assert min(swarm(rastrigin, LOW, HIGH, seed).cost for seed in range(5)) < 1e-6


def test_a_minimum_on_the_bound():
    found = swarm(lambda x: np.sum(x, axis=1), LOW, HIGH, 0)
    np.testing.assert_allclose(found.best, LOW, atol=1e-6)


@pytest.mark.parametrize("draws", INFLUENCE)
def test_a_seed_decides_the_path_which_stays_in_the_box(draws):
    def path(seed):
        seen = []
        swarm(lambda x: seen.append(x.copy()) or sphere(x), LOW, HIGH, seed, draws)
        return np.concatenate(seen)

    one, same, other = (path(seed) for seed in (4, 4, 5))
    np.testing.assert_array_equal(one, same)
    assert not np.array_equal(one, other)
    assert np.all((one >= LOW) & (one <= HIGH))


def test_a_cost_without_a_value_is_never_the_best():
    found = swarm(lambda x: np.where(x[:, 0] < 1.0, np.nan, sphere(x)), LOW, HIGH, 2)
    assert np.isfinite(found.cost)
    assert found.best[0] >= 1.0


def test_a_swarm_that_has_not_contracted_says_so():
    found = swarm(lambda x: np.zeros(len(x)), LOW, HIGH, 0, "binary")
    assert found.status.startswith("not converged: spread ")
