"""What counts in training: motion and its beginning, low power more than high."""

import numpy as np
import pytest

from narxcal.record import Record
from training.records import largest, motion_weight, rest_records

DT_S = 0.1


def slam(level=50.0, top=100.0, steps=600, at=300):
    """Outputs that jump at once: steady state and engine alike."""
    return np.where(np.arange(steps)[:, None] < at, level, top) * np.ones((1, 2))


def test_motion_counts_more_than_rest_and_its_beginning_most():
    one = slam()
    weight = motion_weight(one, one, largest([one]), DT_S)
    rest, onset, settling = weight[100] * 0.5, weight[305] * 1.0, weight[400] * 1.0
    assert onset == pytest.approx(4.0)
    assert settling == pytest.approx(1.0)
    assert rest == pytest.approx(0.4)
    # One second before the move counts as motion, and twelve behind it.
    assert weight[292] * 0.5 >= 1.0
    assert weight[280] * 0.5 == pytest.approx(0.4)
    assert weight[440] == pytest.approx(0.4)


def test_what_follows_another_move_at_once_is_no_beginning():
    one = slam()
    one[320:] = 60.0
    weight = motion_weight(one, one, largest([one]), DT_S)
    assert weight[322] * 0.6 == pytest.approx(1.0)


def test_low_power_counts_by_what_a_share_of_it_is_but_not_without_end():
    low, high = slam(20.0, 30.0), slam(90.0, 100.0)
    scale = largest([low, high])
    assert motion_weight(high, high, scale, DT_S)[400] == pytest.approx(1.0)
    assert motion_weight(low, low, scale, DT_S)[400] == pytest.approx(1.0 / 0.3)


def test_an_output_that_is_not_known_counts_as_its_steady_state():
    one = slam()
    holed = np.where(np.arange(600)[:, None] % 7 == 0, np.nan, one)
    scale = largest([one])
    known = motion_weight(one, one, scale, DT_S)
    np.testing.assert_allclose(motion_weight(one, holed, scale, DT_S), known)


def test_an_engine_that_never_moves_is_at_rest_throughout():
    one = np.full((50, 2), 80.0)
    np.testing.assert_allclose(motion_weight(one, one, largest([one]), DT_S), 0.4)


def test_far_rest_records_begin_at_large_deviations_and_are_scored_for_half():
    deviation = np.where(np.arange(1000) % 100 == 0, 5.0, 0.01)[:, None]
    record = Record(np.zeros((1000, 2)), deviation)
    near, far = (rest_records([record], 1, 40, seed=3, far=far) for far in (False, True))
    assert len(far) == 300
    share = np.mean([abs(rest.y[0, 0]) > 1.0 for rest in far])
    assert share > 0.7
    assert share > 5.0 * np.mean([abs(rest.y[0, 0]) > 1.0 for rest in near])
    assert all(np.isnan(rest.y[1:20]).all() and (rest.y[20:] == 0.0).all() for rest in far)
