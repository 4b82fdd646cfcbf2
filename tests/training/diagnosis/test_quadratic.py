"""Fits from inner products: within bounds, and without a unit as if it had never been there."""

import numpy as np
import pytest
from scipy.optimize import lsq_linear

from training.diagnosis.fit import Columns, Grams, least, solve

UNITS, K, M = 3, 4, 60


def problem(units, seed=0):
    """Nuisances, a response with two slopes, and a gap: whitened rows of each unit."""
    random = np.random.default_rng(seed)
    n, r, d = (random.normal(size=(UNITS, rows, M))[units] for rows in (K, 3, 1))
    gap = d[:, 0] + 2.0 * r[:, 1]
    grams = Grams(
        n @ n.swapaxes(1, 2),
        np.einsum("ukm,um->uk", n, gap),
        (gap**2).sum(axis=1),
        np.full(len(units), 0.5 * M),
        np.full(K, 3.0),
        25.0 * len(units),
    )
    columns = Columns(
        r @ r.swapaxes(1, 2),
        r @ n.swapaxes(1, 2),
        np.einsum("ukm,um->uk", r, gap),
        np.array([[-9.0, 9.0], [-9.0, 9.0]]),
        np.zeros(K, dtype=bool),
    )
    return grams, columns


def test_a_unit_left_out_is_a_refit_without_it():
    left_out = solve(*problem([0, 1, 2]), without=2)
    anew = solve(*problem([0, 1]))
    assert left_out.x == pytest.approx(anew.x, rel=1e-9)
    assert left_out.nu == pytest.approx(anew.nu, rel=1e-9)
    assert left_out.rss[:2] == pytest.approx(anew.rss, rel=1e-9)
    assert left_out.tau == pytest.approx(anew.tau, rel=1e-9)


def test_a_planted_slope_is_found_within_its_interval():
    found = solve(*problem([0, 1, 2]))
    spread = np.sqrt(np.diag(found.covariance))
    assert abs(found.x[0] - 2.0) < 4.0 * spread[0]
    assert abs(found.x[1]) < 4.0 * spread[1]


def test_an_absent_nuisance_stays_out():
    grams, columns = problem([0, 1, 2])
    absent = np.array([True, False, False, False])
    found = solve(grams, Columns(*(getattr(columns, n) for n in ("rr", "rn", "rd", "box")), absent))
    assert found.nu[0] == 0.0
    assert found.nu[1:].all()


@pytest.mark.parametrize("bound", [0.05, 0.3, 50.0])
def test_the_least_within_bounds_is_that_of_bounded_least_squares(bound):
    random = np.random.default_rng(5)
    rows, target = random.normal(size=(40, 6)), random.normal(size=40)
    low, high = np.full(6, -bound), np.full(6, bound)
    expected = lsq_linear(rows, target, (low, high), method="bvls").x
    assert least(rows.T @ rows, rows.T @ target, low, high) == pytest.approx(expected, abs=1e-5)
