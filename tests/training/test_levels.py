"""Level and lag of a free run, and what held-out logs allow of them."""

import numpy as np
import pytest
from scipy.stats import t as student

from narxcal.calibration.run_record import MixtureChannel
from training.screening.levels import PRIOR_LOGS, checks, lag_of, level_of, prior_scatter

DT_S = 0.1
TIME_S = DT_S * np.arange(6000)
MEASURED = np.column_stack(
    [
        70.0 + 20.0 * np.sin(TIME_S / 17.0) * np.sin(TIME_S / 5.0),
        500.0 + 90.0 * np.sin(TIME_S / 23.0) * np.cos(TIME_S / 7.0),
    ]
)
NAMES = ("N1_pct", "EGT_C")


def late(seconds):
    return np.column_stack([np.interp(TIME_S - seconds, TIME_S, each) for each in MEASURED.T])


def checked(model, levels, lags=(0.0, 0.0, 0.0)):
    stored = {name: MixtureChannel(held_out_level=levels, held_out_lag_s=lags) for name in NAMES}
    return checks(stored, NAMES, (model, MEASURED), DT_S)


def test_level_is_the_median_error_and_lag_the_delay():
    wild = MEASURED + np.array([1.5, -20.0])
    wild[:200] += 1e3
    known = np.where(np.arange(6000)[:, None] % 7 == 0, np.nan, MEASURED)
    assert level_of(wild, known) == pytest.approx([1.5, -20.0])
    assert lag_of(late(1.3), MEASURED, DT_S) == pytest.approx([1.3, 1.3], abs=0.05)
    assert lag_of(late(-0.7), MEASURED, DT_S) == pytest.approx([-0.7, -0.7], abs=0.05)
    empty = np.full_like(MEASURED, np.nan)
    assert np.isnan(level_of(wild, empty)).all()
    assert np.isnan(lag_of(wild, empty, DT_S)).all()


def test_what_is_allowed_is_students_interval_of_held_out_levels_and_the_prior():
    found = checked(MEASURED, [0.5, -0.4, 0.3])[0]
    prior = prior_scatter("N1_pct", float(np.median(MEASURED[:, 0])))
    square = (PRIOR_LOGS * prior**2 + 0.5) / (PRIOR_LOGS + 3)
    tail = student.ppf(1.0 - 0.05 / 4.0, PRIOR_LOGS + 2)
    assert found.allowed == pytest.approx(tail * np.sqrt(square))
    assert (found.ok, found.held_out_logs, found.late) == (True, 3, False)


def test_a_level_beyond_the_spread_fails_and_more_logs_narrow_it():
    wrong = MEASURED * [1.1, 1.0] + [0.0, 5.0]
    n1, egt = checked(wrong, [0.5, -0.4, 0.3])
    assert (n1.ok, egt.ok) == (False, True)
    assert n1.row()["ok"] is False
    assert n1.error == pytest.approx(0.1 * np.median(MEASURED[:, 0]), rel=0.01)
    many = checked(MEASURED, [0.5, -0.4, 0.3] * 5)[0]
    assert many.allowed < checked(MEASURED, [0.5, -0.4, 0.3])[0].allowed


def test_a_lag_beyond_the_spread_is_told():
    assert [each.late for each in checked(late(2.0), [0.1] * 4, [0.05] * 4)] == [True, True]
    assert [each.late for each in checked(late(0.1), [0.1] * 4, [0.05] * 4)] == [False, False]


@pytest.mark.parametrize("levels", [[], [0.1, 0.2]])
def test_fewer_than_three_logs_judge_nothing(levels):
    found = checked(1.5 * MEASURED, levels, levels)
    assert [(each.ok, each.allowed, each.late) for each in found] == [(None, None, False)] * 2


def test_false_alarms_are_as_rare_as_promised():
    draw, alarms = np.random.default_rng(4), 0
    scatter = prior_scatter("N1_pct", 70.0), prior_scatter("EGT_C", 500.0)
    for _ in range(150):
        own, *held = draw.standard_normal((5, 2)) * scatter
        stored = {
            name: MixtureChannel(held_out_level=tuple(each[k] for each in held))
            for k, name in enumerate(NAMES)
        }
        part = MEASURED[::50]
        found = checks(stored, NAMES, (part + own, part), 50 * DT_S)
        alarms += any(each.ok is False for each in found)
    assert alarms <= 15
