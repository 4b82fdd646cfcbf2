"""What is expected of other flights follows from what the effects do there, and is honest."""

from dataclasses import replace

import numpy as np
import pytest

from eval.diagnosis.expected import (
    Other,
    Sums,
    expected,
    held_out,
    seen,
    squares,
    taken_off,
    unseen,
)
from tests.eval.diagnosis.conftest import weighed

SAMPLES = 1000.0


def flights_of(change, rest):
    """Flights in which an effect of full size explains `change` of the gap and leaves `rest`."""
    change, rest = np.asarray(change, dtype=float), np.asarray(rest, dtype=float)
    return Sums(change + rest, rest, change, np.full(len(change), SAMPLES))


def others_of(*change):
    return Other(np.array(change, dtype=float), np.full(len(change), SAMPLES))


def test_the_expectation_holds_on_other_flights(make_data, probe):
    wrong = {"sensor_lag:EGT_C": {"tau_s": 0.6}}
    data = make_data(probe, flights=6)
    other = held_out(wrong, make_data(probe, flights=9), None)
    here = seen(data, held_out(wrong, data, None).after, None)
    for found in (expected(here), expected(here, unseen(other.data, other.after))):
        assert found.low < other.share < found.high
        assert found.value == pytest.approx(other.share, abs=0.04)


def test_flights_in_which_an_effect_does_more_have_more_of_its_gap():
    found = flights_of([10.0, 80.0, 30.0, 5.0, 60.0], [50.0, 52.0, 49.0, 51.0, 48.0])
    assert expected(found).value == pytest.approx(185.0 / 435.0)
    assert expected(found, others_of(150.0, 150.0)).value == pytest.approx(0.75, abs=0.02)
    assert expected(found, others_of(0.0, 0.0)).value == pytest.approx(0.0, abs=0.02)


def test_misfit_that_grows_with_the_effect_leaves_the_share_as_it_is():
    change = np.array([10.0, 80.0, 30.0, 5.0, 60.0])
    found = flights_of(change, change * [1.0, 1.1, 0.9, 1.05, 0.95])
    assert expected(found, others_of(300.0, 300.0)).value == pytest.approx(0.5, abs=0.02)


def test_an_effect_that_does_nothing_there_may_be_told_by_no_flight():
    found = flights_of([0.0, 0.0, 40.0, 0.0], [50.0, 50.0, 50.0, 50.0])
    assert expected(found, others_of(0.0, 0.0)).value == pytest.approx(0.0, abs=0.05)


@pytest.mark.parametrize("scatter", [0.2, 0.8])
@pytest.mark.parametrize("count", [3, 6])
def test_nine_of_ten_intervals_hold_what_comes(scatter, count):
    random = np.random.default_rng(count)
    inside = []
    for _ in range(400):
        change, rest = random.lognormal(4.0, 0.5, count + 2), random.lognormal(4.0, scatter, 50)
        every = flights_of(change, rest[: count + 2])
        new = every.of(range(count, count + 2))
        found = expected(every.of(range(count)), Other(new.change, new.samples))
        inside.append(found.low <= 1.0 - new.left.sum() / new.before.sum() <= found.high)
    assert 0.84 <= np.mean(inside) <= 0.99


def test_an_effect_takes_something_off_however_unlike_flights_are(make_data, probe):
    """By its own size in each flight; one that opposes half of the flights takes nothing off."""
    data = make_data(probe, flights=4)
    whole = held_out({"sensor_lag:EGT_C": {"tau_s": 1.0}}, data, None).after - data.flights.y
    flown = np.array([1.0, 0.05, 0.6, 0.02])[:, None, None]
    part = replace(data, real=data.real - (1.0 - flown) * whole)
    taken = taken_off(weighed(part).frame, flown * whole)
    assert 0.85 < taken.low < taken.value < 1.02
    frame = weighed(data).frame
    assert taken_off(frame, np.array([1.0, -1.0, 1.0, -1.0])[:, None, None] * whole).low < 0.0
    assert taken_off(frame, 0.5 * whole).value == pytest.approx(0.75, abs=0.03)


def test_an_effect_of_a_small_part_of_the_gap_takes_something_off(make_data, probe):
    """Of a gap that is a steady shift of a hundred times its energy for the rest."""
    data = make_data(probe, flights=4)
    whole = held_out({"sensor_lag:EGT_C": {"tau_s": 1.0}}, data, None).after - data.flights.y
    shifted = replace(data, real=data.real + np.array([0.0, 1.0, 0.0]) * data.span)
    taken = taken_off(weighed(shifted).frame, whole)
    assert 0.0 < taken.low < taken.high < 0.01


def test_ends_are_shares_whatever_is_left():
    nearly = expected(flights_of([100.0] * 4, [0.1, 0.2, 0.0, 0.3]))
    assert 0.99 < nearly.low < nearly.value < nearly.high == 1.0
    worse = expected(Sums(np.ones(3), np.array([3.0, 9.0, 2.0]), np.ones(3), np.ones(3)))
    assert (worse.low, worse.value) == pytest.approx((-1.0, -1.0))


def test_of_flights_in_which_nearly_all_is_explained_one_does_not_widen_it_beyond_them():
    """A flight that leaves a tenth, and two that leave next to nothing, say no more than that."""
    found = expected(flights_of([998.0, 999.0, 910.0], [2.0, 1.0, 90.0]), others_of(900.0, 900.0))
    assert found.value == pytest.approx(0.97, abs=0.01)
    assert 0.7 < found.low < 0.9
    assert found.high == 1.0


def test_flights_that_are_all_alike_leave_no_doubt():
    found = expected(flights_of([30.0] * 4, [10.0] * 4), others_of(30.0, 30.0))
    assert (found.low, found.value, found.high) == pytest.approx((0.75, 0.75, 0.75))


def test_one_flight_expects_with_no_certainty():
    found = expected(flights_of([30.0], [10.0]), others_of(30.0))
    assert (found.low, found.value, found.high) == (-1.0, 0.75, 1.0)


def test_of_flights_unseen_nothing_recorded_is_looked_at(make_data, probe):
    data = make_data(probe, flights=2)
    after = data.flights.y + 0.5
    known = unseen(data, after)
    again = unseen(replace(data, real=data.real + 100.0), after)
    np.testing.assert_array_equal(known.change, again.change)
    np.testing.assert_array_equal(known.samples, np.isfinite(data.real).sum(axis=(1, 2)))


def test_a_flight_counts_as_if_it_had_taken_no_part(make_data, probe):
    data = make_data(probe, flights=3)
    after = held_out({"sensor_lag:EGT_C": {"tau_s": 1.0}}, data, None).after
    by_others = np.zeros_like(after)
    by_others[1] = 2.0
    plain, found = seen(data, after, None), seen(data, after, by_others)
    np.testing.assert_allclose(found.left, squares(data, after + by_others)[1])
    assert found.left[1] > plain.left[1]
    assert found.left[[0, 2]] == pytest.approx(plain.left[[0, 2]])
    np.testing.assert_array_equal(found.change, plain.change)
