"""A long flight alone is cut into parts that together are the flight."""

import numpy as np

from eval.gap.parts import enough


def test_three_flights_are_left_alone(pair):
    pairs = [pair(seed, duration_s=60.0) for seed in range(3)]
    assert enough(pairs) == pairs


def test_one_long_flight_becomes_parts_cut_where_the_lever_rests(pair):
    whole = pair(0, duration_s=1500.0, rate_hz=8.0)
    parts = enough([whole])
    assert [part.name for part in parts] == [f"flight_0#{k}" for k in range(1, 6)]
    np.testing.assert_array_equal(
        np.concatenate([part.real["N1_pct"] for part in parts]), whole.real["N1_pct"]
    )
    for part in parts:
        assert len(part.time_s) * part.dt_s > 200.0
        assert abs(np.diff(part.inputs["TRA_deg"][:8])).max() == 0.0
    assert parts[1].counts == {}


def test_a_short_flight_stays_whole(pair):
    short = pair(0, duration_s=120.0)
    assert enough([short]) == [short]
