"""Candidate moves of a flight card: limits are kept, whatever they are."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from narxcal.flight_test.moves import Limits, course, moves
from narxcal.support.errors import ConfigError

TABLE = {
    "schema": "narxcal.limits/1",
    "altitude_ft": (5000.0, 25_000.0),
    "mach": (0.3, 0.6),
    "climb_ft_min": 2000.0,
    "lever": (5.0, 80.0),
    "lever_per_s": 40.0,
}


@given(
    low=st.floats(-20.0, 500.0),
    span=st.floats(1.0, 2000.0),
    way_s=st.floats(0.3, 30.0),
    hold_s=st.floats(5.0, 60.0),
)
def test_positions_rates_and_altitudes_are_those_permitted(low, span, way_s, hold_s):
    lever = (low, low + span)
    given_ = {"lever": lever, "lever_per_s": span / way_s, "hold_s": hold_s}
    limits = Limits.parse(TABLE | given_)
    every = moves(limits)
    assert {one.altitude_ft for one in every} == {5000.0, 15_000.0, 25_000.0}
    for one in every:
        time, position = np.array(one.corners).T
        assert (position >= lever[0] - 1e-9 * span).all()
        assert (position <= lever[1] + 1e-9 * span).all()
        assert all(rate <= limits.lever_per_s * (1.0 + 1e-6) for _, rate, _ in one.steps)
        assert time[0] == 0.0
        assert (np.diff(time) >= 0.0).all()


def test_a_course_flies_the_moves_one_after_another():
    limits = Limits.parse(TABLE)
    some = [next(one for one in moves(limits) if one.name == name and one.altitude_ft == height)
            for name, height in (("slam", 5000.0), ("chop", 15_000.0))]  # fmt: skip
    flown = course(limits, some, 0.1)
    minutes = sum(one.minutes for one in some) + 10_000.0 / 2000.0
    assert len(flown["lever"]) * 0.1 / 60.0 == pytest.approx(minutes, abs=0.01)
    assert np.abs(np.diff(flown["lever"])).max() <= 40.0 * 0.1 + 1e-9
    assert np.abs(np.diff(flown["ALT_ft"])).max() * 600.0 == pytest.approx(2000.0)
    assert flown["Mach"][[0, -1]] == pytest.approx([0.3, 0.45])


def test_a_switch_is_on_from_before_its_move_settles_to_its_end():
    limits = Limits.parse(TABLE | {"switches": ["NAI", "WAI"]})
    every = moves(limits)
    alike = [[one for one in every if one.switch == name] for name in ("", "NAI", "WAI")]
    assert len({len(each) for each in alike}) == 1
    slam, slam_on = (next(one for one in each if one.name == "slam") for each in alike[:2])
    flown = course(limits, [slam, slam_on, slam], 0.1)
    on = np.flatnonzero(flown["NAI"])
    minutes = np.array([on[0], on[-1] + 1]) * 0.1 / 60.0
    assert minutes == pytest.approx([slam.minutes, 2.0 * slam.minutes], abs=0.005)
    assert set(flown["NAI"][on[0] : on[-1]]) == {1.0}
    assert not flown["WAI"].any()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (
            {"altitude_ft": (9000.0, 2000.0)},
            "altitude_ft: expected a lowest and a higher value, found 9000, 2000",
        ),
        ({"lever": (50.0, 50.0)}, "lever: expected a lowest and a higher value, found 50, 50"),
        ({"mach": (0.3, 1.4)}, "mach: expected values from 0 to 1, found [0.3, 1.4]"),
        (
            {"lever_per_s": 1.0},
            "limits that admit no move: at 1 per s the lever takes 75 s from 5 to 80",
        ),
        ({"hold_s": 2.0}, "key 'hold_s': Input should be greater than or equal to 5, found 2.0"),
        (
            {"switches": ["NAI"], "inputs": {"NAI": 1.0}},
            "'NAI' is both in switches and in [inputs]. A switch is off until its moves; leave it",
        ),
        ({"levers": 2.0}, "unknown key 'levers'. Did you mean 'lever'?"),
    ],
)
def test_limits_that_make_no_sense_are_refused(change, words):
    with pytest.raises(ConfigError) as refused:
        Limits.parse(TABLE | change)
    assert str(refused.value).startswith(words)
