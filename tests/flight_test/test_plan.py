"""Whole flights: what holds for every seed, in both styles, at any length."""

import itertools
import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from data_prep.events import EventsConfig, find_events
from data_prep.log import Log
from narxcal.atmosphere import air_state, isa, mach_of_cas
from narxcal.channels import CHANNELS
from narxcal.flight_test.manoeuvres import HAND_DEG_S
from narxcal.flight_test.moves import FlightCard, course
from narxcal.flight_test.pilot import SIDES, rate_limited
from narxcal.flight_test.plan import FlightPlan, _draw_day, plan_card, plan_flight, seeded
from narxcal.flight_test.route import (
    AIRCRAFT,
    CEILING_FT,
    CHANNEL_NAMES,
    DT_HIGH_C,
    DT_LOW_C,
    LEAST_S,
    SHORTEST_S,
    SWITCH_NAMES,
    plan_legs,
)
from narxcal.support.errors import ConfigError

STYLES = ("line", "enriched")
seeds = st.integers(0, 2**31)
styles = st.sampled_from(STYLES)
aircrafts = st.sampled_from(sorted(AIRCRAFT))
lengths = st.floats(SHORTEST_S, 900.0)
many = settings(max_examples=12)
plans = st.builds(
    FlightPlan,
    style=styles,
    aircraft=aircrafts,
    duration_s=lengths,
    top_ft=st.none() | st.floats(15_000.0, 39_000.0),
    cruise_mach=st.none() | st.floats(0.55, 0.82),
    dT_C=st.none() | st.floats(DT_LOW_C, DT_HIGH_C),
    field_ft=st.none() | st.floats(0.0, 6000.0),
)


@pytest.fixture(scope="module", params=STYLES)
def natural(request):
    """A flight of natural length, left engine, and its legs."""
    plan = FlightPlan(style=request.param)
    day = _draw_day(plan, AIRCRAFT[plan.aircraft], seeded(3))
    legs = plan_legs(day, AIRCRAFT[plan.aircraft], None)
    return plan_flight(plan, 3)["left"], legs


@pytest.fixture(scope="module")
def both():
    """An enriched flight of natural length, both engines."""
    return plan_flight(FlightPlan(style="enriched"), 3)


@pytest.fixture
def enriched(both):
    return both["left"]


def rate(values, time_s):
    return np.diff(values) / np.diff(time_s)


@many
@given(plans, seeds)
def test_the_same_plan_and_seed_give_the_same_numbers(plan, seed):
    first, again = plan_flight(plan, seed), plan_flight(plan, seed)
    for engine in SIDES:
        assert tuple(first[engine]) == CHANNEL_NAMES
        for name in CHANNEL_NAMES:
            np.testing.assert_array_equal(first[engine][name], again[engine][name])
    other = plan_flight(plan, seed + 1)
    assert not np.array_equal(first["left"]["TRA_deg"], other["left"]["TRA_deg"])


@many
@given(plans, seeds)
def test_every_channel_stays_in_its_range_and_in_the_envelope(plan, seed):
    limits = AIRCRAFT[plan.aircraft]
    for flight in plan_flight(plan, seed).values():
        for name, values in flight.items():
            assert np.isfinite(values).all()
            assert values.min() >= CHANNELS[name].low
            assert values.max() <= CHANNELS[name].high
        assert 0.0 <= flight["TRA_deg"].min() <= flight["TRA_deg"].max() <= 85.0
        assert -1e-6 <= flight["ALT_ft"].min() <= flight["ALT_ft"].max() <= limits.ceiling_ft + 1e-6
        assert -1e-9 <= flight["Mach"].min() <= flight["Mach"].max() <= limits.mach_max
        assert DT_LOW_C <= flight["dT_C"].min() <= flight["dT_C"].max() <= DT_HIGH_C
        for name in SWITCH_NAMES:
            assert set(np.unique(flight[name])) <= {0.0, 1.0}
        np.testing.assert_allclose(np.diff(flight["time_s"]), 1 / 32, atol=1e-9)
        assert flight["time_s"][-1] == pytest.approx(plan.duration_s, abs=0.1)


@many
@given(plans, seeds)
def test_levers_are_continuous_and_no_hand_is_asked_too_much(plan, seed):
    for flight in plan_flight(plan, seed).values():
        lever, most = flight["TRA_deg"], HAND_DEG_S / 32
        assert np.abs(np.diff(lever)).max() <= most
        np.testing.assert_array_equal(rate_limited(lever, most), lever)


@many
@given(plans, seeds)
def test_weight_is_on_the_wheels_only_on_the_ground(plan, seed):
    flight = plan_flight(plan, seed)["left"]
    ground = flight["WOW"] == 1.0
    field = flight["ALT_ft"][0]
    assert ground[0]
    assert ground[-1]
    np.testing.assert_array_equal(flight["ALT_ft"][ground], field)
    # At most a take-off speed of 145 kt, and below the field never.
    assert flight["Mach"][ground].max() < mach_of_cas(145.0, field)
    assert flight["ALT_ft"].min() >= field - 1e-6
    # One take-off and one landing; the go-around touches nothing.
    assert np.count_nonzero(np.diff(flight["WOW"])) == 2
    assert flight["Mach"][~ground].min() > 0.15


@many
@given(plans, seeds)
def test_aircraft_take_off_under_power_and_touch_down_at_idle(plan, seed):
    for flight in plan_flight(plan, seed).values():
        lift_off, touch_down = np.flatnonzero(np.diff(flight["WOW"]))
        assert flight["TRA_deg"][lift_off] > 54.0
        assert flight["TRA_deg"][touch_down] == 0.0


@many
@given(plans, seeds)
def test_approach_idle_is_selected_on_approach_only(plan, seed):
    flight = plan_flight(plan, seed)["left"]
    approach = flight["Approach"] == 1.0
    assert not (approach & (flight["WOW"] == 1.0)).any()
    assert flight["ALT_ft"][approach].max() <= flight["ALT_ft"][0] + 3600.0
    assert flight["Mach"][approach].max() < mach_of_cas(240.0, flight["ALT_ft"][0] + 3600.0)
    # Two approaches, with the go-around between them.
    assert np.count_nonzero(np.diff(flight["Approach"]) > 0) == 2


@many
@given(plans, seeds)
def test_anti_ice_is_on_in_the_cold_only(plan, seed):
    for flight in plan_flight(plan, seed).values():
        air = air_state(flight["ALT_ft"], flight["Mach"], flight["dT_C"])
        on = (flight["NAI"] == 1.0) | (flight["WAI"] == 1.0)
        assert (air.T2_K[on] - 273.15 <= 10.0).all()
        assert not (on & (flight["WOW"] == 1.0)).any()


def test_wing_anti_ice_of_line_operation_comes_with_the_nacelles_and_no_dry_cold():
    used = 0
    for seed in range(12):
        flight = plan_flight(FlightPlan(style="line", duration_s=600.0), seed)["left"]
        assert (flight["WAI"] <= flight["NAI"]).all()
        cold = isa(flight["ALT_ft"])[0] + flight["dT_C"] - 273.15
        assert (cold[flight["NAI"] == 1.0] >= -40.0).all()
        used += flight["NAI"].any()
    assert used >= 6


def test_some_take_offs_are_flown_with_the_packs_off():
    flights = [
        plan_flight(FlightPlan(style="line", duration_s=480.0), s)["left"] for s in range(12)
    ]
    off = [flight["ALT_ft"][flight["ECS"] == 0.0] for flight in flights]
    assert 2 <= sum(len(heights) > 0 for heights in off) <= 10
    for flight, heights in zip(flights, off, strict=True):
        assert not len(heights) or heights.max() <= flight["ALT_ft"][0] + 1500.0


@many
@given(plans, seeds)
def test_both_engines_fly_on_one_aircraft_on_one_day(plan, seed):
    left, right = plan_flight(plan, seed).values()
    for name in ("time_s", "ALT_ft", "Mach", "dT_C", "WOW", "Approach"):
        np.testing.assert_array_equal(left[name], right[name])
        assert left[name] is not right[name]
    assert not np.array_equal(left["TRA_deg"], right["TRA_deg"])


@pytest.mark.parametrize("style", STYLES)
def test_levers_are_moved_a_little_apart_in_time_and_angle(style):
    """Take-off is set 0.1 to 0.6 s apart; on the ground, at rest, there is a degree at most."""
    apart = []
    for seed in range(10):
        left, right = plan_flight(FlightPlan(style=style, duration_s=480.0), seed).values()
        starts = [first_move_s(flight, 20.0) for flight in (left, right)]
        apart.append(abs(starts[0] - starts[1]))
        still = at_rest(left["TRA_deg"]) & at_rest(right["TRA_deg"])
        runway = still & (left["WOW"] == 1.0)
        assert np.abs(left["TRA_deg"] - right["TRA_deg"])[runway].max() <= 1.0
    assert min(apart) >= 0.1 - 1 / 32
    assert max(apart) <= 0.6 + 1 / 32
    assert np.ptp(apart) > 0.1


def first_move_s(flight, after_s):
    moving = np.flatnonzero((flight["time_s"][1:] > after_s) & (np.diff(flight["TRA_deg"]) != 0.0))
    return flight["time_s"][moving[0]]


def at_rest(values, samples=8):
    moved = np.concatenate(([0.0], np.abs(np.diff(values))))
    return np.convolve(moved, np.ones(2 * samples + 1), "same") == 0.0


def test_sometimes_only_one_engine_is_moved(both):
    left, right = both.values()
    alone = {"left": 0, "right": 0}
    for engine, mine, other in (("left", left, right), ("right", right, left)):
        for event in find_events(log_of(mine), EventsConfig(response=())):
            around = slice(max(0, event.start - 40), event.start + 120)
            alone[engine] += np.ptp(other["TRA_deg"][around]) < 1e-9
    assert min(alone.values()) >= 1


def log_of(flight):
    return Log("flight", flight["time_s"], flight)


def test_a_natural_flight_moves_as_aircraft_do(natural):
    flight, _ = natural
    time_s = flight["time_s"]
    assert 75 * 60 < time_s[-1] < 140 * 60
    climb_fpm = 60 * rate(flight["ALT_ft"], time_s)
    assert -2600 < climb_fpm.min() < -1500
    assert 2000 < climb_fpm.max() < 4000
    # Vertical acceleration below half a g, longitudinal below 0.35 g.
    bend = np.diff(climb_fpm) * 0.3048 / 60 * 32
    assert np.abs(bend).max() < 0.5 * 9.81
    assert np.abs(rate(flight["Mach"], time_s)).max() * 340 < 0.35 * 9.81


def test_mach_and_altitude_belong_together(natural):
    """Below 10 000 ft nobody flies faster than 300 kt, and up high nobody slower than 200."""
    flight, _ = natural
    low = flight["ALT_ft"] < 9000.0
    assert (flight["Mach"][low] < mach_of_cas(300.0, flight["ALT_ft"][low])).all()
    high = flight["ALT_ft"] > 20_000.0
    assert (flight["Mach"][high] > mach_of_cas(200.0, flight["ALT_ft"][high])).all()


def test_every_leg_gets_its_time(natural):
    _, legs = natural
    assert [leg.name for leg in legs] == list(LEAST_S)
    for leg in legs:
        assert leg.stop_s - leg.start_s >= LEAST_S[leg.name]


@pytest.mark.parametrize("duration_s", [480.0, 900.0, 3000.0, 20_000.0])
def test_a_flight_is_as_long_as_asked_for(duration_s):
    flight = plan_flight(FlightPlan(style="line", duration_s=duration_s, rate_hz=4.0), 1)["left"]
    assert flight["time_s"][-1] == pytest.approx(duration_s, abs=0.5)


def test_a_longer_flight_spends_the_time_in_cruise():
    plan = FlightPlan(style="line", rate_hz=4.0)
    day, aircraft = _draw_day(plan, AIRCRAFT["business_jet"], seeded(1)), AIRCRAFT["business_jet"]
    natural, longer = plan_legs(day, aircraft, None), plan_legs(day, aircraft, 20_000.0)
    for before, after in zip(natural, longer, strict=True):
        grown = (after.stop_s - after.start_s) - (before.stop_s - before.start_s)
        assert (grown > 100.0) == (before.name in ("cruise", "high_cruise"))


def test_enriched_flights_push_and_pull_in_every_leg(natural):
    flight, legs = natural
    every = find_events(log_of(flight), EventsConfig(response=(), condition=""))
    moves = [event for event in every if event.speed == "fast"]
    if len(moves) < 100:  # the flight of line operation
        assert len(moves) < 15
        return
    for leg in legs:
        if leg.name in ("flare", "roll_out", "taxi_in", "taxi_out"):
            continue
        began = [move for move in every if leg.start_s <= move.start_s < leg.stop_s]
        assert any(move.speed != "small" for move in began), leg.name
    for names in (("initial_climb", "climb"), ("approach", "go_around", "circuit", "final")):
        spans = [(leg.start_s, leg.stop_s) for leg in legs if leg.name in names]
        labels = {m.label for m in moves if any(a <= m.start_s < b for a, b in spans)}
        assert labels == {0, 1}, names


def test_enriched_flights_vary_the_rate_of_the_throttle_from_slow_to_slam(enriched):
    flight = enriched
    events = find_events(log_of(flight), EventsConfig(response=(), condition=""))
    moves = [event for event in events if event.speed != "small"]
    peaks = [
        np.abs(np.diff(flight["TRA_deg"][move.start : move.stop])).max() * 32 for move in moves
    ]
    assert min(peaks) < 15.0
    assert max(peaks) > 100.0


def test_enriched_flights_hold_for_minutes_after_a_large_step_low_and_high(enriched):
    flight = enriched
    # Levers part only while they move, so a hold is a run of equal angles.
    edges = np.flatnonzero(np.diff(flight["TRA_deg"]) != 0.0)
    long = [(a, b) for a, b in itertools.pairwise(edges) if b - a > 180 * 32]
    heights = [flight["ALT_ft"][a] for a, _ in long if flight["TRA_deg"][a + 1] > 60.0]
    assert min(heights) < 15_000.0
    assert max(heights) > 25_000.0


def test_line_flights_move_little_and_gently():
    flight = plan_flight(FlightPlan(style="line"), 5)["left"]
    assert np.abs(rate(flight["TRA_deg"], flight["time_s"])).max() < 20.0


def test_the_flights_of_many_seeds_cover_the_envelope():
    flights = [plan_flight(FlightPlan(duration_s=480.0, rate_hz=8.0), s)["left"] for s in range(40)]
    low = {n: min(flight[n].min() for flight in flights) for n in ("ALT_ft", "Mach", "dT_C")}
    high = {n: max(flight[n].max() for flight in flights) for n in ("ALT_ft", "Mach", "dT_C")}
    assert low["ALT_ft"] < 300.0
    assert high["ALT_ft"] > 0.97 * CEILING_FT
    assert high["Mach"] > 0.82
    assert low["dT_C"] < -25.0
    assert high["dT_C"] > 15.0


def test_what_the_plan_says_is_what_is_flown():
    plan = FlightPlan(duration_s=600.0, top_ft=30_000.0, cruise_mach=0.6, dT_C=20.0, field_ft=900.0)
    flight = plan_flight(plan, 0)["left"]
    assert flight["ALT_ft"][0] == 900.0
    assert flight["ALT_ft"].max() == pytest.approx(30_000.0)
    assert flight["dT_C"].max() == flight["dT_C"].min() == 20.0
    assert flight["Mach"].max() < 0.68


def test_at_its_highest_mach_an_aircraft_gets_slower_at_most():
    flight = plan_flight(FlightPlan(duration_s=900.0, cruise_mach=0.85), 0)["left"]
    assert 0.84 < flight["Mach"].max() <= 0.85


def test_a_choice_in_the_plan_changes_nothing_else():
    drawn = plan_flight(FlightPlan(duration_s=600.0), 4)["left"]
    chosen = plan_flight(FlightPlan(duration_s=600.0, cruise_mach=0.7), 4)["left"]
    np.testing.assert_array_equal(drawn["TRA_deg"], chosen["TRA_deg"])
    np.testing.assert_allclose(drawn["ALT_ft"], chosen["ALT_ft"])


def test_lever_moves_change_the_speed_in_flight(enriched):
    """After a long pull in cruise the aircraft is slower than before, after a push faster."""
    flight = enriched
    high = flight["ALT_ft"] > 0.95 * flight["ALT_ft"].max()
    lever, mach = flight["TRA_deg"][high], flight["Mach"][high]
    slow = np.convolve(lever, np.ones(960) / 960, "valid")
    assert np.corrcoef(slow, mach[959:])[0, 1] > 0.5


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"style": "wild"}, "'style': Input should be 'line' or 'enriched', found 'wild'"),
        ({"aircraft": "glider"}, "should be 'business_jet' or 'single_aisle', found 'glider'"),
        ({"duration_s": 300.0}, "should be greater than or equal to 480, found 300.0"),
        ({"top_ft": 45_000.0}, "top_ft has to lie in 15000 .. 39370.1, got 45000"),
        (
            {"aircraft": "single_aisle", "top_ft": 39_300.0},
            "top_ft has to lie in 15000 .. 39000, got 39300",
        ),
        ({"cruise_mach": 0.9}, "cruise_mach has to lie in 0.55 .. 0.85, got 0.9"),
        ({"dT_C": -40.0}, "'dT_C': Input should be greater than or equal to -30, found -40.0"),
        ({"field_ft": 7e3}, "'field_ft': Input should be less than or equal to 6000, found 7000.0"),
        ({"rate_hz": 1.0}, "'rate_hz': Input should be greater than or equal to 4, found 1.0"),
        ({"durations_s": 600.0}, "unknown key 'durations_s'. Did you mean 'duration_s'?"),
    ],
)
def test_a_flight_that_cannot_be_is_refused(wrong, message):
    with pytest.raises(ConfigError, match=re.escape(message)):
        FlightPlan.parse(wrong)


AIR = {"altitude_ft": (5000.0, 15_000.0), "mach": (0.4, 0.6), "climb_ft_min": 3000.0}
CARD = {
    "schema": "narxcal.card/1",
    "lever": "TRA_deg",
    "limits": {"lever": (5.0, 80.0), "lever_per_s": 60.0, "inputs": {"ECS": 1.0}, **AIR},
    "steps": [
        {"name": "slam", "altitude_ft": 5000.0, "Mach": 0.4, "settle_s": 30.0,
         "corners": [[0.0, 5.0], [1.25, 80.0], [20.0, 80.0]]},
        {"name": "level", "altitude_ft": 15_000.0, "Mach": 0.6, "settle_s": 30.0,
         "corners": [[0.0, 40.0], [15.0, 40.0]]},
    ],
}  # fmt: skip


def test_a_card_is_flown_within_the_tolerances_of_a_pilot():
    card = FlightCard.parse(CARD)
    ideal = course(card.limits, card.steps, 0.125)
    levers = []
    for seed in range(5):
        flown = plan_card(card, FlightPlan(rate_hz=8.0), seed)
        late_s = (len(flown["left"]["time_s"]) - len(ideal["lever"])) / 8.0
        assert -1.0 < late_s < 2 * 2.0 + 2.0  # two steps; a climb differs by up to 100 ft twice
        for channels in flown.values():
            assert tuple(channels) == CHANNEL_NAMES
            assert channels["ALT_ft"][[0, -1]] == pytest.approx([5000.0, 15_000.0], abs=100.0)
            assert channels["TRA_deg"].min() >= 4.5
            assert channels["TRA_deg"].max() == pytest.approx(80.0, abs=0.5)
            assert channels["TRA_deg"][-1] == pytest.approx(40.0, abs=0.5)
            assert set(channels["ECS"]) == {1.0}
            assert set(channels["NAI"]) == {0.0}
            slammed = np.flatnonzero(channels["TRA_deg"] > 40.0)[0] / 8.0
            assert 30.0 < slammed < 33.5
        levers.append(flown["left"]["TRA_deg"])
        assert not np.array_equal(flown["left"]["TRA_deg"], flown["right"]["TRA_deg"])
        assert np.ptp(flown["left"]["Mach"][: 20 * 8]) < 0.01
        assert flown["left"]["Mach"].max() > 0.6  # the slam has made it faster
    assert len({each.tobytes() for each in levers}) == 5


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (
            {"lever": "FF_kgph"},
            (
                "the virtual engines have the lever TRA_deg and the switches WOW, Approach, ECS, "
                "NAI, WAI; the card is for FF_kgph, ECS. Make the card from a run or diagnosis "
                "with these inputs"
            ),
        ),
        (
            {"steps": [{**CARD["steps"][1], "corners": [[0.0, 40.0], [9.0, 90.0]]}]},
            "the card's lever has to lie in 0 .. 85, got 90",
        ),
        (
            {"steps": [{**CARD["steps"][1], "altitude_ft": 45_000.0}]},
            "the card's altitude has to lie in 0 .. 39370.1, got 45000",
        ),
        (
            {"limits": {**CARD["limits"], "mach": (0.4, 0.9)}},
            "the card's Mach number has to lie in 0 .. 0.85, got 0.9",
        ),
    ],
)
def test_a_card_that_the_aircraft_cannot_fly_is_refused(change, words):
    with pytest.raises(ConfigError) as refused:
        plan_card(FlightCard.parse(CARD | change), FlightPlan(), 0)
    assert str(refused.value) == words
