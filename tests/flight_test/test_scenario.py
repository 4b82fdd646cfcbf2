"""The configuration of a virtual flight test: seeds, plans, windows, lever truth, refusals."""

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from narxcal.flight_test.fly import LeverMove, build, flown_engine, lever_moves
from narxcal.flight_test.plan import FlightPlan
from narxcal.flight_test.scenario import FlightScenario
from narxcal.support.errors import ConfigError
from narxcal.turbofan import VirtualEngine

SLOW = {"duration_s": 480.0, "rate_hz": 4.0}
SWITCH = {"id": "unlogged_switch", "parameters": {"bleed": 0.03}}
LAG = {"id": "sensor_lag", "channel": "EGT_C", "parameters": {"tau_s": 1.0}}


def scenario(**table):
    return FlightScenario.parse({"plan": SLOW, **table})


def same(one, other):
    return one.keys() == other.keys() and all((one[name] == other[name]).all() for name in one)


# Seeds


def test_a_flight_is_its_own_whatever_else_is_flown():
    few, many = scenario(flights=2), scenario(flights=9, engine="single_aisle", effects=[LAG])
    plain = many.model_copy(update={"engine": "business_jet"})
    for flight in (1, 2):
        assert same(few.planned(flight)["left"], plain.planned(flight)["left"])
    assert not same(few.planned(1)["left"], few.planned(2)["left"])
    assert not same(few.planned(1)["left"], scenario(seed=1).planned(1)["left"])


def test_streams_of_flights_and_purposes_are_all_different():
    states = {
        tuple(scenario(seed=seed).stream(flight, purpose).generate_state(4).tolist())
        for seed in range(3)
        for flight in range(4)
        for purpose in ("plan", "unlogged_switch", "build left")
    }
    assert len(states) == 36


def test_an_engine_keeps_its_build_and_the_two_differ():
    given = scenario()
    left, right = build(given, "left"), build(given, "right")
    assert left == build(scenario(flights=2, effects=[LAG]), "left")
    assert left != right
    assert left != build(scenario(seed=1), "left")
    assert all(abs(value - 1.0) < 0.05 for value in (*left, *right))
    exact = build(scenario(build_scatter_pct=0.0), "left")
    assert set(exact) == {1.0}


# Plans


def test_the_aircraft_is_the_engines_unless_it_is_named():
    assert scenario(engine="single_aisle").flight_plan().aircraft == "single_aisle"
    named = scenario(engine="single_aisle", plan={**SLOW, "aircraft": "business_jet"})
    assert named.flight_plan() == FlightPlan(aircraft="business_jet", **SLOW)


def test_a_plan_has_both_engines_on_its_raster():
    plans = scenario().planned(1)
    assert list(plans) == ["left", "right"]
    for channels in plans.values():
        np.testing.assert_array_equal(channels["time_s"], np.arange(480 * 4) / 4.0)


@pytest.mark.parametrize(
    ("records", "flights"), [("fast_push", 5), ("throttle_rate", 5), ("take_off_approach", 5)]
)
def test_records_are_flown_whole_and_numbered_as_in_the_paper(records, flights):
    given = scenario(records=records)
    assert given.flight_count == flights
    for flight in range(1, flights + 1):
        assert set(given.planned(flight)) == {"left", "right"}
    assert given.log_name(1, "left") == "data_set_01"
    assert given.log_name(flights, "right") == f"data_set_{2 * flights:02d}"
    assert same(given.planned(2)["left"], scenario(records=records, flights=2).planned(2)["left"])


@pytest.mark.parametrize("rate_hz", [8.0, 32.0])
def test_records_that_touch_the_envelope_do_not_leave_it_by_rounding(rate_hz):
    given = scenario(records="fast_push", plan={"rate_hz": rate_hz})
    engine = VirtualEngine()
    for flight in range(1, 6):
        for channels in given.planned(flight).values():
            inputs = np.column_stack([channels[name] for name in engine.input_names])
            assert engine.inside(inputs).all()


def test_logs_are_named_by_flight_and_engine():
    assert scenario().log_name(3, "right") == "flight_03_right"
    assert scenario().log_name(120, "left") == "flight_120_left"
    assert scenario().flight_count == 6


# Engines


def test_the_engine_has_the_effects_of_its_side_and_no_others():
    given = scenario(effects=[{"id": "spool_lag", "parameters": {"factor": 1.5}}, LAG])
    effects = given.effects_on(1, "left", 480.0)
    plain, slow = flown_engine(given, "left"), flown_engine(given, "left", effects)
    assert isinstance(slow, VirtualEngine)
    assert slow.settings.body.inertia2_J == pytest.approx(1.5 * plain.settings.body.inertia2_J)
    assert slow.settings.health == plain.settings.health


# Effects in time


def test_an_unlogged_switch_draws_windows_that_both_engines_share():
    given = scenario(effects=[SWITCH, LAG])
    (left, lag), (right, _) = (given.effects_on(1, side, 480.0) for side in ("left", "right"))
    assert left.windows_s == right.windows_s
    assert left.windows_s
    assert lag.windows_s == ()
    (other, _) = given.effects_on(2, "left", 480.0)
    assert other.windows_s != left.windows_s


def test_windows_that_are_given_stay():
    spans = [[10.0, 60.0]]
    (effect,) = scenario(effects=[{**SWITCH, "windows_s": spans}]).effects_on(1, "left", 480.0)
    assert effect.windows_s == ((10.0, 60.0),)


@given(seed=st.integers(0, 999), end_s=st.floats(60.0, 9000.0))
def test_drawn_windows_lie_apart_inside_the_flight(seed, end_s):
    (effect,) = scenario(seed=seed, effects=[SWITCH]).effects_on(1, "left", end_s)
    edges = np.ravel(effect.windows_s)
    assert (np.diff(edges) > 0.0).all()
    assert edges[0] >= 0.0
    assert edges[-1] <= end_s
    on = sum(stop - start for start, stop in effect.windows_s)
    assert 0.15 < on / end_s < 0.55


def test_an_effect_of_one_engine_and_flight_acts_there_alone():
    given = scenario(effects=[{**LAG, "flights": [2], "engines": ["right"]}])
    acting = [
        (flight, side)
        for flight in range(1, 7)
        for side in ("left", "right")
        if given.effects_on(flight, side, 480.0)
    ]
    assert acting == [(2, "right")]


# The truth about the lever


def test_lever_moves_are_found_to_the_sample():
    time_s = np.arange(0, 20, 0.25)
    corners = [0, 2, 3, 8, 8.5, 9.5, 12, 16, 20], [10, 10, 40, 40, 40, 20, 20, 20.4, 20.4]
    moves = lever_moves(time_s, np.interp(time_s, *corners))
    assert moves == [LeverMove(2.0, 3.0, 10.0, 40.0), LeverMove(8.5, 9.5, 40.0, 20.0)]
    assert [move.kind for move in moves] == ["push", "pull"]
    assert moves[0].row() == {
        "kind": "push", "start_s": 2.0, "stop_s": 3.0, "from_deg": 10.0, "to_deg": 40.0
    }  # fmt: skip


def test_a_reversal_is_two_moves_and_a_still_lever_none():
    time_s = np.arange(0, 10, 0.25)
    back = lever_moves(time_s, np.interp(time_s, [0, 2, 4, 6, 10], [10, 10, 30, 10, 10]))
    assert [(move.start_s, move.kind) for move in back] == [(2.0, "push"), (4.0, "pull")]
    assert lever_moves(time_s, np.full(len(time_s), 30.0)) == []
    assert lever_moves(time_s, 30.0 + 0.02 * np.sin(time_s)) == []


def test_moves_lead_from_the_first_angle_to_the_last():
    channels = scenario().planned(1)["left"]
    moves = lever_moves(channels["time_s"], channels["TRA_deg"])
    assert len(moves) > 10
    assert all(a.stop_s <= b.start_s for a, b in itertools.pairwise(moves))
    travelled = sum(move.to_deg - move.from_deg for move in moves)
    net = channels["TRA_deg"][-1] - channels["TRA_deg"][0]
    assert travelled == pytest.approx(net, abs=0.5 * len(moves))


# Refusals


@pytest.mark.parametrize(
    ("table", "message"),
    [
        (
            {"engine": "jt15d"},
            "key 'engine': Input should be 'business_jet' or 'single_aisle', found 'jt15d'",
        ),
        ({"sead": 1}, "unknown key 'sead'. Did you mean 'seed'?"),
        ({"seed": -1}, "key 'seed': Input should be greater than or equal to 0, found -1"),
        (
            {"flights": 0},
            "key 'flights': Input should be greater than or equal to 1, found 0",
        ),
        (
            {"records": "fast_push", "flights": 6},
            "there are 5 flights of 'fast_push' records, found flights = 6",
        ),
        (
            {"outputs": ["N1_pct", "Mach"]},
            (
                "outputs names 'Mach', which is no output of an engine. "
                "Outputs are N1_pct, N2_pct, EGT_C, FF_kgph, FN_kN, FPR, EPR"
            ),
        ),
        ({"outputs": ["N3_pct"]}, "unknown channel 'N3_pct'. Did you mean 'N2_pct'?"),
        (
            {"plan": {"style": "airshow"}},
            "key 'plan.style': Input should be 'line' or 'enriched', found 'airshow'",
        ),
        (
            {"effects": [{**LAG, "flights": [7]}]},
            "effect 'sensor_lag@EGT_C' names flight 7, and there are 6",
        ),
        (
            {"effects": [LAG, LAG]},
            "effect 'sensor_lag@EGT_C' is given twice. Give its parameters at one place",
        ),
        (
            {"effects": [{"id": "sensor_lagg", "channel": "EGT_C"}]},
            "unknown effect 'sensor_lagg'. Did you mean 'sensor_lag'?",
        ),
        (
            {"sensors": {"channels": {"EGT": {}}}},
            "unknown channel 'EGT'. Did you mean 'EGT_C'?",
        ),
    ],
)
def test_a_scenario_that_cannot_be_is_refused(table, message):
    with pytest.raises(ConfigError) as error:
        FlightScenario.parse({"schema": "narxcal.fly/1", **table}, "fly.toml")
    assert str(error.value) == f"fly.toml: {message}"
