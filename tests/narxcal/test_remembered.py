"""Answers to whole logs are remembered, and no others."""

import numpy as np
import pytest

from narxcal.steady.function import Cached


def counted(most_rows=1000):
    """A function that doubles, what remembers it, and how many rows it was asked for each time."""
    asked = []

    def double(inputs):
        asked.append(len(inputs))
        return 2.0 * inputs

    return Cached(double, most_rows), asked


def log(first, rows=300):
    return first + np.arange(2.0 * rows).reshape(rows, 2)


def test_the_same_log_is_asked_once():
    remembered, asked = counted()
    for _ in range(3):
        np.testing.assert_array_equal(remembered(log(0.0)), 2.0 * log(0.0))
        np.testing.assert_array_equal(remembered(log(1.0)), 2.0 * log(1.0))
    assert asked == [300, 300]


def test_logs_of_the_same_numbers_in_another_order_are_others():
    remembered, asked = counted()
    columns = np.asfortranarray(log(0.0))
    np.testing.assert_array_equal(remembered(columns), 2.0 * columns)
    np.testing.assert_array_equal(remembered(columns[::-1]), 2.0 * columns[::-1])
    np.testing.assert_array_equal(remembered(log(0.0)), 2.0 * log(0.0))
    assert asked == [300, 300]


@pytest.mark.parametrize("rows", [1, 99, 1001])
def test_samples_of_a_stream_and_logs_too_long_are_not_kept(rows):
    remembered, asked = counted()
    for _ in range(2):
        remembered(log(0.0, rows))
    assert asked == [rows, rows]


def test_the_one_not_used_for_longest_is_forgotten():
    remembered, asked = counted()
    for first in (0.0, 1.0, 2.0, 0.0, 3.0, 0.0, 1.0):  # three logs fit in
        remembered(log(first))
    assert asked == [300] * 5


def test_an_answer_cannot_be_changed():
    remembered, _ = counted()
    answer = remembered(log(0.0))
    with pytest.raises(ValueError, match="read-only"):
        answer += 1.0


def test_an_error_is_raised_each_time():
    def fails(inputs):
        raise RuntimeError(f"{len(inputs)} rows")

    remembered = Cached(fails)
    for _ in range(2):
        with pytest.raises(RuntimeError, match="300 rows"):
            remembered(log(0.0))
