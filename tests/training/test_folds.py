"""Recordings left out in turn, and what is left over."""

import numpy as np
import pytest

from data_prep.log import Log, Source
from training.folds import (
    clearly_less,
    clustered,
    geometric_rms,
    held_out_folds,
    log_folds,
    surely_below,
)


def test_each_recording_is_judged_once_and_stays_whole():
    recordings = ["a", "a", "b", "c", "c", "d"]
    found = held_out_folds(recordings, 3)
    assert [turn.judged for turn in found] == [[0, 1, 5], [2], [3, 4]]
    for turn in found:
        assert sorted(turn.fitted + turn.judged) == list(range(6))
    assert found[1].of("ABCDEF") == (list("ABDEF"), ["C"])


def test_fewer_recordings_than_turns_take_a_turn_each():
    assert [turn.judged for turn in held_out_folds(["a", "b"], 5)] == [[0], [1]]


def test_outputs_of_different_size_count_alike():
    errors = np.array([[3.0, 0.5], [-4.0, np.nan]])
    expected = np.sqrt(np.sqrt(12.5) * 0.5)
    assert geometric_rms([errors[:1], errors[1:]]) == pytest.approx(expected)
    assert geometric_rms([errors * [1.0, 10.0]]) == pytest.approx(np.sqrt(10.0) * expected)


@pytest.mark.parametrize("errors", [[], [np.full((3, 2), np.nan)], [np.array([[1.0, np.nan]])]])
def test_without_a_number_there_is_no_judgement(errors):
    assert geometric_rms(errors) == np.inf


@pytest.mark.parametrize("count", [2, 3, 6, 40])
def test_equal_ones_are_found_better_in_sixteen_percent_of_draws(count):
    ratios = np.random.default_rng(1).normal(size=(count, 20_000))
    assert surely_below(ratios).mean() == pytest.approx(0.1587, abs=0.01)


def test_what_is_better_everywhere_is_better_and_one_fold_says_nothing():
    ratios = np.array([[-0.1, 0.1, -0.1], [-0.1, 0.1, np.nan]])
    assert surely_below(ratios).tolist() == [True, False, False]
    assert not surely_below(ratios[:1]).any()


def test_a_margin_has_to_be_reached_as_well():
    ratios = np.array([[-0.1, -0.01], [-0.1, -0.01]])
    assert surely_below(ratios, 0.02).tolist() == [True, False]


def flight(name, samples=1800, altitude=True):
    """A climb, a cruise at altitude, a descent; power falls in three steps."""
    time_s = np.arange(float(samples))
    channels = {"N1_pct": np.repeat([90.0, 70.0, 30.0], samples // 3)}
    if altitude:
        channels["ALT_ft"] = np.interp(time_s / samples, [0, 0.4, 0.6, 1], [0, 3e4, 3e4, 0])
    return Log(name, time_s, channels, source=Source(name))


def power(log):
    return log["N1_pct"]


def test_a_single_recording_is_held_out_by_regions():
    found = {fold.name: fold for fold in log_folds([flight("a")], power)}
    assert list(found) == ["highest altitude", "lowest power", "last third"]
    for fold in found.values():
        assert sum(map(len, fold.judged)) == pytest.approx(600, abs=80)
        assert sum(map(len, fold.judged + fold.fitted)) == 1800
        assert {fold.piece(log) for log in fold.judged} == {fold.name}
    high = found["highest altitude"]
    lowest = min(part["ALT_ft"].min() for part in high.judged)
    assert lowest > 0.6 * max(part["ALT_ft"].max() for part in high.fitted)
    assert max(part["N1_pct"].max() for part in found["lowest power"].judged) == 30.0


def test_without_altitude_there_are_power_and_time():
    names = [fold.name for fold in log_folds([flight("a", altitude=False)], power)]
    assert names == ["lowest power", "last third"]


def test_two_recordings_are_held_out_whole_as_well():
    found = log_folds([flight("a"), flight("b")], power)
    assert [fold.name for fold in found[3:]] == ["a", "b"]
    assert [fold.whole for fold in found] == [False, False, False, True, True]


def test_three_recordings_are_held_out_whole():
    found = log_folds([flight(name) for name in "abcd"], power)
    assert [fold.name for fold in found] == ["a, d", "b", "c"]
    assert [found[0].piece(log) for log in found[0].judged] == ["a", "d"]


def test_a_log_of_few_samples_has_no_regions_that_hold_everything():
    for fold in log_folds([flight("a", 3)], power):
        assert fold.fitted
        assert fold.judged


def test_the_error_of_a_mean_takes_flights_as_units():
    rng = np.random.default_rng(0)
    alike = [np.full(10, each) for each in rng.normal(size=6)]  # as one transient a flight
    mean, error, pieces = clustered(alike)
    values = np.array([each[0] for each in alike])
    assert (mean, pieces) == (pytest.approx(values.mean()), 6)
    assert error == pytest.approx(values.std(ddof=1) / np.sqrt(6))
    apart = [np.array([x]) for x in rng.normal(size=40)]
    assert clustered(apart)[1] == pytest.approx(np.std(apart, ddof=1) / np.sqrt(40))
    holed = [np.array([1.0, np.nan]), np.array([np.nan]), np.array([3.0])]
    assert clustered(holed)[::2] == (2.0, 2)
    assert clustered([np.array([np.nan])])[1:] == (np.inf, 0)


def test_a_piece_alone_decides_nothing_and_noise_seldom():
    assert not clearly_less([np.full(100, -1.0)])
    rng = np.random.default_rng(1)
    draws = [
        clearly_less([rng.normal(rng.normal(), 1.0, int(rng.integers(3, 9))) for _ in range(5)])
        for _ in range(2000)
    ]
    assert np.mean(draws) == pytest.approx(0.16, abs=0.04)  # one standard error
    assert clearly_less([rng.normal(-3.0, 1.0, 8) for _ in range(5)])
