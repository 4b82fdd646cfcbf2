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
from narxcal.support.errors import ConfigError
from narxcal.turbofan.engine import INPUT_NAMES, VirtualEngine

PUSHES = 152
TEST_SETS = (5, 7, 8)
RANGED = ("TRA_deg", "ALT_ft", "Mach", "dT_C")


@pytest.fixture(scope="module", params=[0, 1, 7])
def sets(request):
    return fast_push_sets(request.param)


def events(data_set, condition="WOW"):
    """Cut the lever alone, everything else at its default."""
    log = Log("set", data_set.channels["time_s"], data_set.channels)
    return find_events(log, EventsConfig(response=(), condition=condition))


def fast(found, label):
    return [event for event in found if event.label == label and event.speed == "fast"]


def span(data_sets, name):
    return (
        min(one.channels[name].min() for one in data_sets),
        max(one.channels[name].max() for one in data_sets),
    )


def test_ten_sets_hold_exactly_152_fast_pushes(sets):
    assert [one.number for one in sets] == list(range(1, 11))
    assert sum(len(fast(events(one), PUSH)) for one in sets) == PUSHES
    assert sum(len(one.pushes) for one in sets) == 152


def test_every_push_is_found_where_it_was_flown(sets):
    for one in sets:
        found = fast(events(one), PUSH)
        assert len(found) == len(one.pushes)
        for event, push in zip(found, one.pushes, strict=True):
            assert event.start_s == pytest.approx(push.start_s, abs=2 / 32)
            assert event.lever_before == pytest.approx(push.before_deg, abs=1e-6)
            assert event.lever_after == pytest.approx(push.after_deg, abs=1e-6)


def test_nothing_but_those_pushes_goes_up(sets):
    for one in sets:
        found = events(one)
        assert len([event for event in found if event.label == PUSH]) == len(one.pushes)
        assert len([event for event in found if event.label == PULL]) >= len(one.pushes)
        assert not any(event.interrupted for event in found)


def test_each_set_has_pushes_in_climb_cruise_and_approach(sets):
    for one in sets:
        assert {push.phase for push in one.pushes} == {"climb", "cruise", "approach"}
        starts = [push.start_s for push in one.pushes]
        assert starts == sorted(starts)
        for push in one.pushes:
            at = np.searchsorted(one.channels["time_s"], push.start_s)
            assert one.channels["Approach"][at] == (push.phase == "approach")


def test_together_they_span_the_papers_envelope(sets):
    assert span(sets, "ALT_ft") == pytest.approx((0.0, CEILING_FT), abs=1e-6)
    assert span(sets, "Mach") == pytest.approx((0.30, 0.85), abs=1e-9)
    assert span(sets, "dT_C") == pytest.approx((-30.0, 20.0), abs=1e-9)
    assert span(sets, "TRA_deg")[1] - span(sets, "TRA_deg")[0] > 70.0


def test_the_ranges_of_the_test_sets_lie_inside_those_of_the_others(sets):
    tested = [one for one in sets if one.number in TEST_SETS]
    others = [one for one in sets if one.number not in TEST_SETS]
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
        # One engine sits a push out where the two counts differ.
        assert len(left.pushes) > len(right.pushes)


def test_levers_of_one_flight_are_moved_within_half_a_second_and_a_degree_or_two(sets):
    for left, right in zip(sets[::2], sets[1::2], strict=True):
        rights = {round(push.start_s, 0): push for push in right.pushes}
        offsets = []
        for push in left.pushes:
            near = [o for o in right.pushes if abs(o.start_s - push.start_s) < 1.0]
            offsets += [abs(near[0].start_s - push.start_s)] if near else []
        assert len(offsets) == len(rights)
        assert 0.05 < max(offsets) <= 0.5


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


def test_the_counts_of_the_records_add_up():
    assert sum(sum(record.pushes) for record in PAPER_RECORDS) == PUSHES
    for record in PAPER_RECORDS:
        assert sum(window.pushes for window in record.windows) == max(record.pushes)


@pytest.mark.parametrize("maker", [fast_push_sets, throttle_rate_sets, take_off_approach_sets])
def test_the_same_seed_gives_the_same_numbers(maker):
    first, again, other = maker(2), maker(2), maker(3)
    for one, same in zip(first, again, strict=True):
        assert one.pushes == same.pushes
        for name in CHANNEL_NAMES:
            np.testing.assert_array_equal(one.channels[name], same.channels[name])
    assert first[0].pushes != other[0].pushes


def test_throttle_rates_vary_from_slow_to_slam():
    sets = throttle_rate_sets(0)
    rates = np.array([push.rate_deg_s for one in sets for push in one.pushes])
    assert len(rates) == PUSHES
    for low, high in ((3.0, 7.0), (7.0, 20.0), (20.0, 50.0), (50.0, 120.0)):
        assert np.count_nonzero((rates >= low) & (rates <= high)) >= 20
    found = [event for one in sets for event in events(one) if event.label == PUSH]
    assert len(found) == PUSHES
    assert {event.speed for event in found} == {"fast", "slow"}
    assert not any(event.interrupted for event in found)


def test_take_offs_and_approaches_are_flown_from_the_ground_up():
    sets = take_off_approach_sets(0)
    assert [one.flight for one in sets] == [1, 1, 2, 2, 3, 3, 4, 4, 5, 5]
    for one in sets:
        phases = [push.phase for push in one.pushes]
        assert {phase: phases.count(phase) for phase in phases} == {
            "take-off": 4,
            "climb": 4,
            "downwind": 4,
            "approach": 8,
            "final": 8,
        }
        assert len(fast(events(one, condition=""), PUSH)) == 28
        # In the air the default condition leaves all but the take-offs.
        assert len(fast(events(one), PUSH)) == 24


def test_wheels_carry_weight_on_the_field_only():
    for one in take_off_approach_sets(1):
        ground = one.channels["WOW"] == 1.0
        field = one.channels["ALT_ft"][0]
        np.testing.assert_allclose(one.channels["ALT_ft"][ground], field, atol=1e-6)
        assert one.channels["ALT_ft"].min() >= field - 1e-6
        assert one.channels["Mach"][ground].max() < 0.25
        assert not (ground & (one.channels["Approach"] == 1.0)).any()
        assert np.count_nonzero(np.diff(one.channels["WOW"]) < 0) == 4


def test_an_engine_can_fly_a_set():
    channels = take_off_approach_sets(0)[0].channels
    short = {name: channels[name][: 700 * 32] for name in INPUT_NAMES}
    outputs = VirtualEngine().simulate(short, 1 / 32)
    assert all(np.isfinite(values).all() for values in outputs.values())


def test_a_negative_seed_is_refused():
    with pytest.raises(ConfigError, match="a seed is a whole number from 0 on, got -3"):
        fast_push_sets(-3)


def test_a_raster_too_slow_is_refused():
    with pytest.raises(ConfigError, match=r"rate_hz has to lie in 4 \.\. 256, got 1"):
        fast_push_sets(0, rate_hz=1.0)
