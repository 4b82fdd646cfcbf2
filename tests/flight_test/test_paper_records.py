"""The calibration paper's data shape, found again by the product's own segmentation."""

import numpy as np
import pytest

from data_prep.events import PULL, PUSH, EventsConfig, find_events
from data_prep.log import Log
from narxcal.channels import CHANNELS
from narxcal.flight_test.manoeuvres import HAND_DEG_S
from narxcal.flight_test.paper_records import (
    PAPER_RECORDS,
    fast_push_sets,
    take_off_approach_sets,
    throttle_rate_sets,
)
from narxcal.flight_test.route import CEILING_FT, CHANNEL_NAMES

PUSHES = 152
TEST_SETS = (5, 7, 8)
RANGED = ("TRA_deg", "ALT_ft", "Mach", "dT_C")


@pytest.fixture(scope="module", params=[0, 1, 7])
def sets(request):
    return fast_push_sets(request.param, 32.0)


def events(data_set, condition="WOW"):
    """Cut the lever alone, everything else at its default."""
    log = Log("set", data_set.channels["time_s"], data_set.channels)
    return find_events(log, EventsConfig(response=(), condition=condition))


def fast(found, label):
    return [event for event in found if event.label == label and event.speed == "fast"]


def fastest(one, event):
    """Rate of the lever in deg/s within an event."""
    moved = np.diff(one.channels["TRA_deg"][max(event.start - 1, 0) : event.stop + 1])
    return np.abs(moved).max() * 32


def span(data_sets, name):
    return (
        min(one.channels[name].min() for one in data_sets),
        max(one.channels[name].max() for one in data_sets),
    )


def test_ten_sets_hold_exactly_152_fast_pushes_and_nothing_else_goes_up(sets):
    flown = [count for record in PAPER_RECORDS for count in record.pushes]
    assert sum(flown) == PUSHES
    for one, count in zip(sets, flown, strict=True):
        found = events(one)
        assert len(fast(found, PUSH)) == count
        assert len([event for event in found if event.label == PUSH]) == count
        assert len([event for event in found if event.label == PULL]) >= count
        assert not any(event.interrupted for event in found)


def test_each_set_has_pushes_in_climb_cruise_and_approach(sets):
    for one in sets:
        windows = PAPER_RECORDS[one.flight - 1].windows
        starts = [event.start_s for event in fast(events(one), PUSH)]
        for window in windows:
            within = [window.start_s <= start < window.stop_s for start in starts]
            assert any(within) == (window.pushes > 0)
        at = np.searchsorted(one.channels["time_s"], starts)
        assert (one.channels["Approach"][at] == (starts >= np.float64(windows[-1].start_s))).all()


def test_together_they_span_the_papers_envelope(sets):
    assert span(sets, "ALT_ft") == pytest.approx((0.0, CEILING_FT), abs=1e-6)
    assert span(sets, "Mach") == pytest.approx((0.30, 0.85), abs=1e-9)
    assert span(sets, "dT_C") == pytest.approx((-30.0, 20.0), abs=1e-9)
    assert span(sets, "TRA_deg")[1] - span(sets, "TRA_deg")[0] > 70.0


def test_the_ranges_of_the_test_sets_lie_inside_those_of_the_others(sets):
    tested = [sets[number - 1] for number in TEST_SETS]
    others = [one for k, one in enumerate(sets, 1) if k not in TEST_SETS]
    assert len(tested) == 3
    for name in RANGED:
        (low, high), (least, most) = span(tested, name), span(others, name)
        assert least < low < high < most, name


def test_left_and_right_engine_are_two_sets_of_one_flight(sets):
    for left, right in zip(sets[::2], sets[1::2], strict=True):
        assert left.flight == right.flight
        assert (left.engine, right.engine) == ("left", "right")
        both = min(len(left.channels["time_s"]), len(right.channels["time_s"]))
        for name in ("ALT_ft", "Mach", "dT_C"):
            np.testing.assert_allclose(
                left.channels[name][: both - 600], right.channels[name][: both - 600], atol=1e-6
            )
        assert not np.array_equal(left.channels["TRA_deg"][:both], right.channels["TRA_deg"][:both])


def test_levers_of_one_flight_are_moved_within_half_a_second_or_so(sets):
    for left, right in zip(sets[::2], sets[1::2], strict=True):
        lefts, rights = (
            np.array([event.start_s for event in fast(events(one), PUSH)]) for one in (left, right)
        )
        # One engine sits a push out where the two counts differ.
        offsets = np.abs(rights[:, None] - lefts).min(axis=1)
        assert 0.05 < offsets.max() <= 0.5 + 2 / 32
        assert len(lefts) > len(rights)


def test_the_length_of_every_set_differs(sets):
    lengths = [len(one.channels["time_s"]) for one in sets]
    assert len(set(lengths)) == 10


def test_channels_are_complete_airborne_and_continuous(sets):
    for one in sets:
        assert tuple(one.channels) == CHANNEL_NAMES
        assert not one.channels["WOW"].any()
        assert np.abs(np.diff(one.channels["TRA_deg"])).max() <= HAND_DEG_S / 32
        assert np.abs(np.diff(one.channels["ALT_ft"])).max() * 32 * 60 < 4000.0
        assert np.abs(np.diff(one.channels["Mach"])).max() * 32 * 300 < 2.0  # m/s2
        for name, values in one.channels.items():
            assert CHANNELS[name].low <= values.min() <= values.max() <= CHANNELS[name].high


@pytest.mark.parametrize("maker", [fast_push_sets, throttle_rate_sets, take_off_approach_sets])
def test_the_same_seed_gives_the_same_numbers(maker):
    first, again, other = (maker(seed, 32.0) for seed in (2, 2, 3))
    for one, same in zip(first, again, strict=True):
        for name in CHANNEL_NAMES:
            np.testing.assert_array_equal(one.channels[name], same.channels[name])
    lever, another = (one[0].channels["TRA_deg"] for one in (first, other))
    assert not np.array_equal(lever, another)


def test_throttle_rates_vary_from_slow_to_slam():
    sets = throttle_rate_sets(0, 32.0)
    found = [(one, event) for one in sets for event in events(one) if event.label == PUSH]
    rates = np.array([fastest(*each) for each in found])
    assert len(rates) == PUSHES
    for low, high in ((3.0, 7.0), (7.0, 20.0), (20.0, 50.0), (50.0, 120.0)):
        assert np.count_nonzero((rates >= low) & (rates <= high)) >= 20
    assert {event.speed for _, event in found} == {"fast", "slow"}
    assert not any(event.interrupted for _, event in found)


def test_take_offs_and_approaches_are_flown_from_the_ground_up():
    sets = take_off_approach_sets(0, 32.0)
    assert [one.flight for one in sets] == [1, 1, 2, 2, 3, 3, 4, 4, 5, 5]
    for one in sets:
        assert len(fast(events(one, condition=""), PUSH)) == 28
        # In the air the default condition leaves all but the take-offs.
        assert len(fast(events(one), PUSH)) == 24


def test_wheels_carry_weight_on_the_field_only():
    for one in take_off_approach_sets(1, 32.0):
        ground = one.channels["WOW"] == 1.0
        field = one.channels["ALT_ft"][0]
        np.testing.assert_allclose(one.channels["ALT_ft"][ground], field, atol=1e-6)
        assert one.channels["ALT_ft"].min() >= field - 1e-6
        assert one.channels["Mach"][ground].max() < 0.25
        assert not (ground & (one.channels["Approach"] == 1.0)).any()
        assert np.count_nonzero(np.diff(one.channels["WOW"]) < 0) == 4
