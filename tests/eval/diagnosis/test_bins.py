"""Every sample has one direction, one phase and one level of each regime."""

import numpy as np

from data_prep.events import Event
from eval.diagnosis.flights import MOVES, events_of, moves_of, regimes_of
from tests.eval.diagnosis.conftest import batch


def test_phases_of_a_lag_are_those_of_its_closed_form(make_data):
    data = make_data(flights=1)
    # 10 % of a first-order lag of 1.5 s is reached after 0.158 s, 90 % after 3.454 s.
    dt_s, y = data.flights.signals.dt_s, data.flights.y
    n = len(y[0])
    event = Event("f", 158, 318, 0, "fast", 158 * dt_s, 0.0, 1.0, settled=True, interrupted=False)
    time = np.arange(n) * dt_s
    y[0, :, 0] = np.where(time < 20.0, 30.0, 90.0 - 60.0 * np.exp(-(time - 20.0) / 1.5))
    move = moves_of(data, ((event,),))[0]
    phases = [MOVES[k] for k in move]
    assert phases[158] == ("steady", "steady")
    assert phases[159:162] == [("push", "initiation")] * 3
    transit = [k for k, phase in enumerate(phases) if phase == ("push", "transit")]
    assert transit[0] == 162  # 20.25 s, 15 % of the way
    assert transit[-1] == 188  # 23.5 s, the first sample beyond 90 %
    assert phases[189:318] == [("push", "settling")] * 129
    assert phases[318] == ("steady", "steady")


def test_a_move_too_small_to_read_is_all_settling(make_data):
    data = make_data(flights=1)
    event = Event("f", 100, 150, 1, "small", 12.5, 1.0, 0.9, settled=True, interrupted=False)
    data.flights.y[0, 90:160, 0] = 60.0
    move = moves_of(data, ((event,),))[0]
    assert {MOVES[k] for k in move[101:150]} == {("pull", "settling")}


def test_beyond_its_end_a_flight_has_no_samples(pair):
    data = batch([pair(0, duration_s=60.0), pair(1, duration_s=90.0)])
    move = moves_of(data, events_of(data))
    assert (move[0, 480:] == -1).all()
    assert (move[0, :480] >= 0).all()


def test_regimes_are_levels_of_altitude_mach_power_and_bleed(make_data):
    data = make_data(flights=2)
    regimes = regimes_of(data)
    assert set(regimes) == {"power", "altitude", "Mach", "bleed"}
    levels, index = regimes["altitude"]
    altitude = data.flights.u[..., data.flights.signals.u("ALT_ft")]
    assert levels[index[1, 0]] == "low"
    assert ((altitude > 10e3) == (index == 1)).all()
    assert regimes["bleed"][0] == ("off", "NAI")
    assert (regimes["Mach"][1] == 1).all()
