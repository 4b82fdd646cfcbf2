"""Changes of series over flights: against covariances written out, and against known changes."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import binomtest

from eval.fleets.drift import (
    KINDS,
    Change,
    Prior,
    Series,
    _level,
    _Smoothed,
    candidate,
    detect,
    learn,
)

KIND = ("EGT_C", "offset")


def drawn(rng, n=40, sigma=1.0, walk=0.0, error=0.3):
    hours = np.cumsum(rng.uniform(1.0, 3.0, n))
    level = np.cumsum(rng.normal(0.0, np.sqrt(walk * np.diff(hours, prepend=hours[0]))))
    y = 5.0 + level + rng.normal(0.0, np.hypot(sigma, error), n)
    return Series(hours, y, np.full(n, error))


def projection(series, prior, changes):
    """M of the module's formulas, by matrices."""
    since = series.hours - series.hours[0]
    covariance = prior.walk * np.minimum.outer(since, since)
    covariance += np.diag(series.errors**2 + prior.variance)
    inverse = np.linalg.inv(covariance)
    columns = [np.ones(len(since)), *(series.column(one.kind, one.at) for one in changes)]
    x = np.column_stack(columns)
    return inverse - inverse @ x @ np.linalg.solve(x.T @ inverse @ x, x.T @ inverse)


@given(
    seed=st.integers(0, 10**6),
    variance=st.sampled_from([0.8, 1e-9]),
    walk=st.sampled_from([0.0, 0.01, 1.0]),
    changes=st.sampled_from([(), (("step", 7),), (("outlier", 0), ("trend", 0))]),
)
def test_statistics_of_all_positions_are_those_of_the_likelihood_with_each(
    seed, variance, walk, changes
):
    rng = np.random.default_rng(seed)
    series, prior = drawn(rng, 15), Prior(variance, walk, 7.0)
    found = [Change(kind, at, at, at) for kind, at in changes]
    m, smoothed = projection(series, prior, found), _Smoothed(series, prior, found)
    for kind in KINDS:
        tau = smoothed.statistics(kind)
        for at, value in enumerate(tau):
            column = series.column(kind, at)
            weight = column @ m @ column
            known = weight > 1e-6 and (kind, at) not in changes
            exact = column @ m @ series.y / np.sqrt(weight) if known else 0.0
            # A change that is there keeps its size over the prior's spread: below 10 / sqrt(1e6).
            assert value == pytest.approx(exact, abs=1e-2)


def test_the_likeliest_step_is_that_of_a_search_over_all_flights():
    rng = np.random.default_rng(3)
    series, prior = drawn(rng), Prior(1.0, 0.0, 50.0)
    series.y[23:] += 4.0
    m = projection(series, prior, [])
    columns = [series.column("step", at) for at in range(1, 40)]
    gain = [(x @ m @ series.y) ** 2 / (x @ m @ x) for x in columns]
    best = candidate(series, prior)
    assert (best.kind, best.at) == ("step", 1 + int(np.argmax(gain)))
    x = columns[best.at - 1]
    assert best.size == pytest.approx(x @ m @ series.y / (x @ m @ x), rel=1e-5)
    assert best.first <= 23 <= best.last


def test_p_values_of_series_without_a_change_are_seldom_small():
    rng = np.random.default_rng(4)
    nu = 6.0
    values = []
    for _ in range(400):
        scale = np.sqrt(nu / rng.chisquare(nu))
        series = drawn(rng, 8, sigma=scale, error=0.0)
        smoothed = _Smoothed(series, Prior(1.0, 0.0, nu), [])
        (tau,) = smoothed.statistics("trend")
        values.append(smoothed.p(tau, "trend") / len(KINDS))
    for level in (0.02, 0.1, 0.3):
        below = int(np.sum(np.array(values) < level))
        assert binomtest(below, len(values), level, alternative="greater").pvalue > 0.01
        assert below > 0.3 * level * len(values)


def test_what_the_fleet_was_drawn_from_is_learned():
    rng = np.random.default_rng(5)
    nu = 8.0
    fleet = []
    for _ in range(60):
        scale = np.sqrt(nu / rng.chisquare(nu))
        fleet.append(drawn(rng, 40, sigma=2.0 * scale, walk=0.05 * scale**2, error=0.0))
    prior = learn(fleet, [()] * len(fleet))
    assert prior.variance == pytest.approx(4.0, rel=0.15)
    assert prior.walk == pytest.approx(0.05, rel=0.6)
    assert 0.5 * nu < prior.freedom < 2.5 * nu


def test_steps_of_a_sixth_of_the_series_do_not_teach_that_levels_wander():
    rng = np.random.default_rng(9)
    fleet = [drawn(rng) for _ in range(30)]
    for one in fleet[:5]:
        one.y[20:] += 4.0
    assert learn(fleet, [()] * 30).walk < 0.001  # of a variance of 1, and 2 h between flights


def test_series_that_all_wear_do_not_teach_that_levels_wander():
    rng = np.random.default_rng(6)
    fleet = [drawn(rng) for _ in range(10)]
    for one in fleet:
        one.y[:] += 0.1 * one.hours
    assert learn(fleet, [()] * 10).walk < 0.005  # 0.02 is (0.1 per h)^2 2 h
    found, _ = detect(fleet, [KIND] * 10)
    assert [[change.kind for change in one.changes] for one in found] == [["trend"]] * 10
    sizes = np.array([(c.size - 0.1) / c.error for one in found for c in one.changes])
    assert abs(sizes).max() < 4.0


@pytest.mark.parametrize("kind", ["step", "outlier"])
def test_a_change_of_one_engine_is_found_where_it_is(kind):
    rng = np.random.default_rng(7)
    fleet = [drawn(rng) for _ in range(12)]
    fleet[4].y[:] += 7.0 * fleet[4].column(kind, 30)
    found, _ = detect(fleet, [KIND] * 12)
    changed = {k: [(c.kind, c.at) for c in one.changes] for k, one in enumerate(found)}
    assert {k: own for k, own in changed.items() if own} == {4: [(kind, 30)]}
    (change,) = found[4].changes
    assert abs(change.size - 7.0) < 3.0 * change.error
    assert change.adjusted < 1e-3
    if kind == "outlier":  # the level does not follow it
        assert abs(found[4].level[30] - found[4].level[29]) < 0.1


def test_two_changes_of_one_series_are_both_found():
    rng = np.random.default_rng(8)
    fleet = [drawn(rng, 60) for _ in range(10)]
    fleet[0].y[:] += 6.0 * fleet[0].column("step", 20) + 12.0 * fleet[0].column("outlier", 45)
    found, _ = detect(fleet, [KIND] * 10)
    assert {(c.kind, c.at) for c in found[0].changes} == {("step", 20), ("outlier", 45)}


def test_the_level_of_a_series_that_does_not_wander_is_the_weighted_mean():
    rng = np.random.default_rng(9)
    errors = rng.uniform(0.1, 3.0, 20)
    series = Series(np.arange(20.0), 5.0 + rng.normal(0.0, np.hypot(1.0, errors)), errors)
    found = _level(series, Prior(1.0, 0.0, 1e4), ())
    weight = 1.0 / (errors**2 + 1.0)
    assert found.level == pytest.approx(np.full(20, weight @ series.y / weight.sum()), abs=1e-5)
    assert found.level_error == pytest.approx(np.full(20, weight.sum() ** -0.5), rel=0.01)


def test_stationary_fleets_seldom_have_an_alarm():
    fleets = 0
    for seed in range(10):
        rng = np.random.default_rng([10, seed])
        fleet = [drawn(rng, 12) for _ in range(4)]
        found, _ = detect(fleet, [KIND] * 4)
        fleets += any(one.changes for one in found)
    assert fleets <= 2  # of 5 % of 10 fleets: P(more) = 0.01


@pytest.mark.parametrize("n", [4, 6])
def test_short_series_are_judged_by_the_scatter_of_the_others(n):
    rng = np.random.default_rng(11)
    fleet = [drawn(rng, n) for _ in range(20)]
    fleet[2].y[-1] += 15.0
    found, _ = detect(fleet, [KIND] * 20)
    assert [k for k, one in enumerate(found) if one.changes] == [2]


def test_values_that_do_not_change_at_all_have_no_changes():
    fleet = [Series(np.arange(1.0, 9.0), np.full(8, 0.2), np.zeros(8)) for _ in range(3)]
    found, _ = detect(fleet, [KIND] * 3)
    assert all(one.changes == () for one in found)
    assert found[0].level == pytest.approx(np.full(8, 0.2))
