"""Statistics of estimates against closed forms and slow sums."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import norm

from training.papers.likelihood_statistics import (
    autocovariance,
    coloured_covariance,
    combine,
    compare,
    information,
    propagate,
    whiteness,
)


def test_the_coloured_covariance_is_the_double_sum_over_samples():
    rng = np.random.default_rng(0)
    slopes = [rng.normal(size=(80, 2, 3)), rng.normal(size=(60, 2, 3))]
    residuals = [rng.normal(size=(80, 2)).cumsum(0) * 0.2, rng.normal(size=(60, 2))]
    sigma = np.array([0.7, 1.3])
    m = sum(np.einsum("kop,koq,o->pq", s, s, sigma**-2) for s in slopes)
    inverse = np.linalg.inv(m)
    middle = np.zeros((3, 3))
    for o in range(2):
        r = autocovariance([v[:, o] for v in residuals])
        for s in slopes:
            for i in range(len(s)):
                for j in range(len(s)):
                    if abs(i - j) < len(r):
                        middle += np.outer(s[i, o], s[j, o]) * r[abs(i - j)] / sigma[o] ** 4
    found = coloured_covariance(inverse, slopes, residuals, sigma)
    np.testing.assert_allclose(found, inverse @ middle @ inverse, rtol=1e-9)


@given(seed=st.integers(0, 10_000), points=st.integers(20, 200))
def test_the_coloured_covariance_has_no_negative_variance(seed, points):
    rng = np.random.default_rng(seed)
    slopes, residuals = [rng.normal(size=(points, 1, 3))], [rng.normal(size=(points, 1))]
    found = coloured_covariance(np.eye(3), slopes, residuals, np.ones(1))
    assert np.linalg.eigvalsh(found).min() > -1e-9 * np.trace(found)


def test_lags_grow_with_the_correlation_up_to_a_fifth_of_the_record():
    rng = np.random.default_rng(1)
    white, walk = rng.normal(size=1000), rng.normal(size=1000).cumsum()
    assert len(autocovariance([white])) < 20
    assert len(autocovariance([walk])) == 200


def test_whiteness_tells_white_from_coloured_and_is_uniform_on_white():
    rng = np.random.default_rng(2)
    p = [whiteness([rng.normal(size=(400, 1))]) for _ in range(300)]
    assert np.mean(np.array(p) < 0.1) == pytest.approx(0.1, abs=0.06)
    smooth = np.convolve(rng.normal(size=402), np.ones(3) / 3, "valid")[:, None]
    assert whiteness([smooth]) < 1e-6


def test_information_leaves_the_known_directions_of_a_singular_matrix():
    basis = np.array([[1.0, 1.0, 0.0], [0.0, 0.0, 2.0]])  # only a + b and c are seen
    found = information(basis.T @ basis, ["a", "b", "c"])
    assert found.rank == 2
    assert found.unidentifiable == ("a (+1.00), b (-1.00)",)
    np.testing.assert_array_equal(found.sd, [np.inf, np.inf, 0.5])


def test_information_does_not_depend_on_units():
    rng = np.random.default_rng(3)
    root = rng.normal(size=(20, 3))
    scale = np.array([1e-6, 1.0, 1e6])
    plain = information(root.T @ root, ["a", "b", "c"])
    scaled = information((root * scale).T @ (root * scale), ["a", "b", "c"])
    np.testing.assert_allclose(scaled.sd * scale, plain.sd)
    np.testing.assert_allclose(
        scaled.covariance * np.outer(scale, scale), plain.covariance, rtol=1e-6
    )


def test_a_mean_of_equal_runs_and_its_birge_ratio():
    one = combine([1.0, 3.0], [1.0, 1.0])
    assert (one.value, one.sd) == (2.0, pytest.approx(np.sqrt(0.5)))
    assert one.birge == pytest.approx(np.sqrt(2.0))


def test_a_run_that_determines_nothing_has_no_weight():
    assert combine([1.0, 7.0], [0.5, np.inf]).value == 1.0
    assert combine([1.0, 7.0], [np.inf, np.inf]).sd == np.inf


def test_holms_procedure_on_a_worked_example():
    z = {"a": 2.9, "b": 2.5, "c": 2.2, "d": 0.1}
    p = {name: 2 * norm.sf(value) for name, value in z.items()}
    rows = compare(dict.fromkeys(z, (0.0, 0.0)), {name: (value, 1.0) for name, value in z.items()})
    adjusted = {row.name: row.p_holm for row in rows}
    assert adjusted["a"] == pytest.approx(4 * p["a"])
    assert adjusted["b"] == pytest.approx(3 * p["b"])
    assert adjusted["c"] == pytest.approx(2 * p["c"])
    assert adjusted["d"] == pytest.approx(p["d"])
    assert [row.significant for row in rows] == [True, True, False, False]


def test_holm_keeps_the_family_wise_level():
    rng = np.random.default_rng(4)
    draws = rng.normal(size=(2000, 12))
    false = [
        any(
            row.significant
            for row in compare(
                {str(k): (0.0, 0.0) for k in range(12)},
                {str(k): (float(x), 1.0) for k, x in enumerate(draw)},
            )
        )
        for draw in draws
    ]
    assert np.mean(false) == pytest.approx(0.05, abs=0.015)


def test_what_cannot_be_compared_is_left_out():
    left = {"fixed": (1.0, 0.0), "open": (1.0, np.inf), "alone": (1.0, 1.0), "both": (2.0, 0.3)}
    right = {"fixed": (2.0, 0.0), "open": (1.0, 1.0), "both": (3.0, 0.4)}
    (row,) = compare(left, right)
    assert (row.name, row.percent, row.z) == ("both", 50.0, pytest.approx(2.0))
    assert compare({}, {}) == []


def test_errors_propagate_to_a_ratio_with_their_correlation():
    covariance = np.array([[0.04, 0.01], [0.01, 0.09]])
    value, sd = propagate(lambda v: v["a"] / v["b"], {"a": 2.0, "b": 4.0}, covariance)
    relative = 0.04 / 4.0 + 0.09 / 16.0 - 2 * 0.01 / 8.0
    assert value == 0.5
    assert sd == pytest.approx(0.5 * np.sqrt(relative))
