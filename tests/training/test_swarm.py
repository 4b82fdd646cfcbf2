"""Particle swarm: minima found, seeds, draws of the paper, divergence with usual constants."""

import numpy as np
import pytest

from narxcal.support.errors import ConfigError
from training.swarm import CHI, PAPER, STANDARD, SwarmSettings, swarm

LOW, HIGH = np.full(4, -5.0), np.full(4, 5.0)
CENTRE = np.array([1.0, -2.0, 0.5, 3.0])


def sphere(x):
    return np.sum((x - CENTRE) ** 2, axis=1)


def rastrigin(x):
    return np.sum(x**2 - 10.0 * np.cos(2.0 * np.pi * x) + 10.0, axis=1)


def test_constriction_constants():
    assert pytest.approx(0.72984, abs=5e-6) == CHI
    assert STANDARD.local == pytest.approx(1.49618, abs=5e-6)


@pytest.mark.parametrize("settings", [STANDARD, PAPER])
def test_the_minimum_of_a_bowl_is_found(settings):
    found = swarm(sphere, LOW, HIGH, 1, settings)
    np.testing.assert_allclose(found.best, CENTRE, atol=1e-4)
    assert found.converged
    assert np.all(np.diff(found.costs) <= 0.0)


def test_many_local_minima():
    settings = SwarmSettings(particles=100, steps=500)
    found = [swarm(rastrigin, LOW, HIGH, seed, settings).cost < 1e-6 for seed in range(5)]
    assert sum(found) >= 4


def test_a_minimum_on_the_bound():
    found = swarm(lambda x: np.sum(x, axis=1), LOW, HIGH, 0)
    np.testing.assert_allclose(found.best, LOW, atol=1e-6)


def test_the_same_seed_gives_the_same_path_and_another_seed_another():
    one, same, other = (swarm(sphere, LOW, HIGH, seed) for seed in (4, 4, 5))
    np.testing.assert_array_equal(one.costs, same.costs)
    assert not np.array_equal(one.costs, other.costs)


# The second moment is bounded below P = 1.67 for uniform draws and 0.82 for draws of 0 or 1.
@pytest.mark.parametrize(
    ("draws", "P", "stable"),
    [("uniform", 1.49618, True), ("uniform", 1.70, False),
     ("binary", 0.75, True), ("binary", 0.85, False), ("binary", 1.49618, False)],
)  # fmt: skip
def test_which_constants_are_stable(draws, P, stable):
    assert SwarmSettings(draws=draws, local=P, leader=P).stable is stable


def test_draws_of_zero_or_one_diverge_with_the_usual_constants():
    def run(draws, P, seed):
        settings = SwarmSettings(
            draws=draws, local=P, leader=P, confine=False, steps=400, particles=30
        )
        return swarm(sphere, LOW, HIGH, seed, settings)

    for seed in range(3):
        usual = run("binary", 2.05 * CHI, seed)
        assert usual.spread[-1] > 1e6 * usual.spread[0]
        assert usual.status.startswith("diverged: lower the influences")
        assert run("binary", 0.75, seed).converged
        assert run("uniform", 2.05 * CHI, seed).converged


def test_a_confined_swarm_stays_in_its_box():
    seen = []

    def watched(x):
        seen.append(x.copy())
        return sphere(x)

    settings = SwarmSettings(draws="binary", local=1.5, leader=1.5, steps=100)
    swarm(watched, LOW, HIGH, 0, settings)
    rows = np.concatenate(seen)
    assert np.all((rows >= LOW) & (rows <= HIGH))


def test_a_cost_without_a_value_is_never_the_best():
    found = swarm(lambda x: np.where(x[:, 0] < 1.0, np.nan, sphere(x)), LOW, HIGH, 2)
    assert np.isfinite(found.cost)
    assert found.best[0] >= 1.0


def test_a_swarm_that_has_not_contracted_says_so():
    found = swarm(rastrigin, LOW, HIGH, 0, SwarmSettings(steps=5))
    assert found.status.startswith("not converged: spread ")
    assert not found.converged


def test_impossible_settings_are_refused():
    message = (
        "^swarm: expected particles >= ring >= 1 and steps >= 1, found 2 particles, a ring of 3 "
        "and 300 steps$"
    )
    with pytest.raises(ConfigError, match=message):
        SwarmSettings(particles=2)
