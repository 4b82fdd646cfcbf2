"""Intervals: coverage of new logs, widening by few logs, storage, messages."""

import itertools
import json

import numpy as np
import pytest
from scipy.stats import norm
from scipy.stats import t as student

from narxcal.intervals import LEVELS, Conformal, HalfWidths, HeldErrors, joined
from narxcal.support.errors import DataError, ModelError


@pytest.mark.parametrize(("logs", "spread"), [(20, 0.0), (20, 0.5), (10, 0.5)])
def test_intervals_widen_with_the_horizon_and_cover_new_logs_to_their_share(logs, spread):
    """Errors grow with the horizon; logs differ in their level by a log-normal factor."""
    draw, horizon = np.random.default_rng(0), np.arange(1.0, 101.0)

    def runs(count):
        level = np.exp(spread * draw.standard_normal((count, 1)))
        return np.abs(level * np.sqrt(horizon) * draw.standard_normal((count, 100)))

    covered, piece = [], np.repeat(np.arange(logs), 100)
    for _ in range(20):  # fleets: the coverage of a single one hangs on its logs
        fleet = Conformal(np.tile(horizon, logs), runs(logs).reshape(-1, 1), piece)
        wide = fleet.half_width(100, 0.9)
        assert np.all(np.diff(wide[:, 0]) >= 0.0)
        covered.append(np.mean(runs(100) <= wide[:, 0]))
    assert 0.87 < np.mean(covered) < 0.93


@pytest.mark.parametrize("logs", [3, 4, 8, 12])
@pytest.mark.parametrize("shared", [0.0, 0.5, 0.9])
def test_new_logs_are_covered_however_much_of_the_error_is_an_offset_of_the_log(logs, shared):
    draw = np.random.default_rng(logs)

    def runs(count):
        offset = np.sqrt(shared) * draw.standard_normal((count, 1))
        return offset + np.sqrt(1.0 - shared) * draw.standard_normal((count, 100))

    covered = []
    for _ in range(60):
        fleet = joined(
            [
                HeldErrors(np.zeros((100, 1)), run[:, None], str(k))
                for k, run in enumerate(runs(logs))
            ],
            np.array([np.sqrt(shared)]),
        )
        covered.append(np.mean(np.abs(runs(100)) <= fleet.at(np.zeros((1, 1)), 0.9)))
    assert 0.86 < np.mean(covered) < 0.94 + 0.02 * (logs == 3)


@pytest.mark.parametrize("logs", [1, 2, 4, 8])
def test_logs_that_err_alike_widen_by_the_prior_alone(logs):
    """Closed form: the same errors in each log, so that only the prior scatters their squares."""
    errors = np.linspace(0.0, 1.0, 101)
    found = Conformal(
        np.ones(101 * logs), np.tile(errors, logs)[:, None], np.arange(101 * logs) // 101
    )
    freedom = 2.0 * logs * (1.5 + logs - 1.0) / (1.5 * 2.0)
    expected = 0.9 * student.ppf(0.95, freedom) / norm.ppf(0.95)
    assert found.half_width(1, 0.9)[0, 0] == pytest.approx(expected, rel=0.02)


def errors_far_from_steady_state():
    """Two outputs: the first errs by its distance from steady state, the second never knows."""
    draw, x = np.random.default_rng(3), np.tile(np.linspace(0.0, 4.0, 4000)[:, None], (1, 2))
    error = x * draw.uniform(-1.0, 1.0, x.shape)
    error[:, 1] = np.nan
    return [HeldErrors(x, error, f"log {k}") for k in range(3)]


def test_intervals_are_wider_away_from_steady_state_and_at_higher_levels():
    found = joined(errors_far_from_steady_state(), np.array([0.1, 0.1]))
    assert found.pieces == 3
    at = np.tile(np.linspace(0.0, 5.0, 50)[:, None], (1, 2))
    wide = [found.at(at, level)[:, 0] for level in (0.5, 0.87, 0.9, 0.99)]
    assert all((np.diff(one) >= 0.0).all() for one in wide)
    assert all((b >= a).all() for a, b in itertools.pairwise(wide))
    assert wide[2][-1] > 2.5 * wide[2][0]
    assert not found.at(at, 0.9)[:, 1].any()


def test_a_stored_interval_comes_back():
    found = joined(errors_far_from_steady_state(), np.array([0.1, 0.1]))
    loaded = HalfWidths.from_json(json.loads(json.dumps(found.to_json())), 2)
    at = np.random.default_rng(0).uniform(0.0, 5.0, (20, 2))
    np.testing.assert_array_equal(loaded.at(at, 0.8), found.at(at, 0.8))
    assert loaded.pieces == 3


def test_of_nothing_known_there_is_no_interval():
    nothing = HeldErrors(np.zeros((5, 1)), np.full((5, 1), np.nan), "a")
    assert joined([], np.ones(1)) is None
    assert joined([nothing], np.ones(1)) is None


def test_a_share_that_is_not_stored_is_refused():
    found = joined(errors_far_from_steady_state(), np.array([0.1, 0.1]))
    with pytest.raises(DataError, match=f"between {LEVELS[0]} and {LEVELS[-1]}, found 0.999"):
        found.at(np.zeros((1, 2)), 0.999)


@pytest.mark.parametrize(
    "damage",
    [
        lambda stored: stored.pop("outputs"),
        lambda stored: stored["outputs"].pop(),
        lambda stored: stored["outputs"][0].update(away=[3.0, 2.0, 1.0, 0.0, -1.0]),
        lambda stored: stored["outputs"][0]["half_width"].pop(),
        lambda stored: stored.update(levels=[0.9]),
        lambda stored: stored["outputs"][0].update(away="x"),
    ],
)
def test_a_damaged_interval_is_refused(damage):
    stored = joined(errors_far_from_steady_state(), np.array([0.1, 0.1])).to_json()
    damage(stored)
    with pytest.raises(ModelError, match="'interval'"):
        HalfWidths.from_json(stored, 2)


def test_of_one_recording_the_prior_alone_says_how_days_differ():
    """Closed form: parts without errors; h is t of two recordings times the prior of two."""
    part = HeldErrors(np.zeros((100, 1)), np.zeros((100, 1)), "last third", whole=False)
    found = joined([part], np.array([0.5]))
    assert found.between == pytest.approx([0.5 * np.sqrt(2.0)])
    expected = student.ppf(0.95, 2.0) * 0.5 * np.sqrt(2.0)
    assert found.at(np.zeros((1, 1)), 0.9)[0, 0] == pytest.approx(expected)


def test_offsets_of_recordings_replace_the_prior():
    """Closed form with three recordings offset by 1, -1 and 2 from models of the others."""
    held = [
        HeldErrors(np.zeros((100, 1)), np.full((100, 1), offset), str(offset))
        for offset in (1.0, -1.0, 2.0)
    ]
    found = joined(held, np.array([0.5]))
    variance = (2.0 * 0.5**2 + 6.0 * 2.0 / 3.0) / 5.0
    assert found.between == pytest.approx([np.sqrt(4.0 / 3.0 * variance)])
    expected = student.ppf(0.95, 5.0) * np.sqrt(4.0 / 3.0 * variance)
    assert found.at(np.zeros((1, 1)), 0.9)[0, 0] == pytest.approx(expected, rel=1e-6)
    assert HalfWidths.from_json(found.to_json(), 1).between == found.between
