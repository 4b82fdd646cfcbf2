"""Shrinkage is the plain share of squares above the noise."""

import numpy as np
import pytest

from eval.diagnosis.expected import (
    channel_shrink,
    held_out,
    pooled_share,
    squares,
    time_errors,
    time_shrink,
)
from eval.diagnosis.flights import events_of
from training.diagnosis.metric import TOLERANCE

VALUES = {"sensor_lag:EGT_C": {"tau_s": 1.0}}


def test_squares_are_those_that_anybody_forms_from_the_logs(make_data, probe):
    data = make_data(probe, flights=2)
    after = data.flights.y + 0.5
    before, left = squares(data, after)
    for f in range(2):
        sums = [0.0, 0.0]
        for k in range(3):
            variance = data.noise[k] ** 2 + (TOLERANCE * data.span[k]) ** 2
            for total, model in enumerate((data.flights.y, after)):
                gap = data.real[f, :, k] - model[f, :, k]
                sums[total] += np.sum(gap**2 - data.noise[k] ** 2) / variance
        assert (before[f], left[f]) == pytest.approx(tuple(sums))


def test_the_true_effect_takes_all_and_none_takes_nothing(make_data, probe):
    data = make_data(probe)
    assert held_out(VALUES, data, None).share == pytest.approx(1.0, abs=0.01)
    assert held_out({}, data, None).share == 0.0
    assert pooled_share(np.array([-1.0]), np.array([0.0])) == 0.0


def test_rms_and_times_shrink_on_the_channel_of_the_effect(make_data, probe):
    data = make_data(probe)
    after = held_out(VALUES, data, None).after
    rows = channel_shrink(data, after)
    assert rows["EGT_C"].after < 0.1 * rows["EGT_C"].before
    assert rows["N1_pct"].after == rows["N1_pct"].before
    events = events_of(data)
    before, then = (time_errors(data, y, events) for y in (data.flights.y, after))
    times = time_shrink(before, then)
    assert times["EGT_C"].events > 10
    assert times["EGT_C"].Tt_after_s < 0.2 * times["EGT_C"].Tt_before_s
    none = time_errors(data, after, ((), (), (), ()))
    assert np.isnan(time_shrink(none, none)["EGT_C"].Ti_after_s)


def test_no_more_than_all_of_a_gap_is_taken_away():
    assert pooled_share(np.array([5.0, 5.0]), np.array([-0.3, 0.1])) == 1.0
    assert pooled_share(np.array([-1.0]), np.array([0.0])) == 0.0
