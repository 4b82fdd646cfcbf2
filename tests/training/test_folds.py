"""Recordings left out in turn, and what is left over."""

import numpy as np
import pytest

from training.folds import geometric_rms, held_out_folds, surely_below


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
