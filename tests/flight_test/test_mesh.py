"""The Citation X mesh: altitudes, angles, disturbances and roles."""

import math

import numpy as np
import pytest

from narxcal.atmosphere import mach_of_cas
from narxcal.flight_test.mesh import (
    AFTER_S,
    RAMP_S,
    TOP_FT,
    TRA_PER_TLA,
    dynamic_mesh,
    mach_range,
    static_mesh,
)
from narxcal.flight_test.route import CEILING_FT, CHANNEL_NAMES
from narxcal.support.errors import ConfigError
from narxcal.turbofan.engine import INPUT_NAMES, VirtualEngine

ALL = (*static_mesh(), *dynamic_mesh(decelerations=True))


def region(cases, name):
    return [case for case in cases if case.region == name]


def test_the_mesh_spans_what_the_paper_tells():
    low, high = region(static_mesh(), "low"), region(static_mesh(), "high")
    assert min(case.alt_ft for case in low) == 5000.0
    assert max(case.tla_deg for case in low if case.alt_ft == 5000.0) == 50.0
    assert min(case.tla_deg for case in low) == 25.0
    assert max(case.alt_ft for case in high) == 45_000.0
    assert min(case.tla_deg for case in high) == 35.0
    assert max(case.alt_ft for case in low) < min(case.alt_ft for case in high)


def test_every_altitude_meets_every_angle_once():
    for name, count in (("low", 36), ("high", 24)):
        points = [(case.alt_ft, case.tla_deg) for case in region(static_mesh(), name)]
        assert len(points) == len(set(points)) == count


def test_dynamic_cases_are_steps_impulses_and_ramps_from_the_least_angle():
    cases = dynamic_mesh()
    assert {case.kind for case in cases} == {"step", "impulse", "ramp"}
    assert {case.tla_deg for case in region(cases, "low")} == {25.0}
    assert {case.tla_deg for case in region(cases, "high")} == {35.0}
    assert {case.amplitude_deg for case in region(cases, "low")} == {5.0, 10.0, 15.0, 20.0, 25.0}
    assert {case.amplitude_deg for case in region(cases, "high")} == {5.0, 10.0, 15.0}


@pytest.mark.parametrize(
    "cases",
    [static_mesh(), dynamic_mesh(), static_mesh(40_000.0), dynamic_mesh(40_000.0)],
    ids=["static", "dynamic", "static-cut", "dynamic-cut"],
)
def test_identification_holds_the_corners_and_validation_lies_between(cases):
    for name in ("low", "high"):
        here = region(cases, name)
        altitudes = {case.alt_ft for case in here}
        levels = {case.tla_deg + case.amplitude_deg for case in here}
        for case in here:
            corner = case.alt_ft in (min(altitudes), max(altitudes)) and (
                case.tla_deg + case.amplitude_deg in (min(levels), max(levels))
            )
            assert case.role == "identification" or not corner
        validation = [case for case in here if case.role == "validation"]
        assert 0.3 <= len(validation) / len(here) <= 0.5
        # Every row and every column of the mesh is seen in identification.
        seen = [case for case in here if case.role == "identification"]
        assert {case.alt_ft for case in seen} == altitudes
        assert {case.tla_deg + case.amplitude_deg for case in seen} == levels


def test_names_are_unique_and_say_what_is_flown():
    assert len({case.name for case in ALL}) == len(ALL)
    assert static_mesh()[0].name == "static_05000ft_tla25"
    assert dynamic_mesh()[0].name == "step_05000ft_tla25+5"


@pytest.mark.parametrize("case", ALL[:: len(ALL) // 40], ids=lambda case: case.name)
def test_channels_hold_everything_but_the_lever_and_the_speed(case):
    channels = case.channels()
    assert tuple(channels) == CHANNEL_NAMES
    assert np.unique(channels["ALT_ft"]).tolist() == [case.alt_ft]
    for name in ("dT_C", "WOW", "Approach", "NAI", "WAI"):
        assert not channels[name].any()
    assert channels["ECS"].all()
    assert channels["TRA_deg"][0] == pytest.approx(TRA_PER_TLA * case.tla_deg)
    assert 0.0 <= channels["TRA_deg"].min() <= channels["TRA_deg"].max() <= 85.0
    assert channels["Mach"].max() <= 0.85


def lever_moves(case):
    channels = case.channels()
    moved = (channels["TRA_deg"] - channels["TRA_deg"][0]) / TRA_PER_TLA
    return channels["time_s"], moved


@pytest.mark.parametrize("case", dynamic_mesh(decelerations=True)[::17], ids=lambda c: c.name)
def test_disturbances_are_the_papers_equations(case):
    time_s, moved = lever_moves(case)
    expected = {
        "step": np.where(time_s >= AFTER_S, 1.0, 0.0),
        "impulse": np.where((time_s >= AFTER_S) & (time_s < AFTER_S + 1 / 32), 1.0, 0.0),
        "ramp": np.clip((time_s - AFTER_S) / RAMP_S, 0.0, 1.0),
    }[case.kind]
    np.testing.assert_allclose(moved, case.amplitude_deg * expected, atol=1e-9)


def test_an_impulse_is_one_sample_wide_at_any_rate():
    (case, *_) = (case for case in dynamic_mesh() if case.kind == "impulse")
    for rate_hz in (8.0, 32.0, 50.0):
        lever = case.channels(rate_hz)["TRA_deg"]
        assert np.count_nonzero(lever != lever[0]) == 1


def test_decelerations_are_the_ways_back():
    there = dynamic_mesh()
    back = dynamic_mesh(decelerations=True)[len(there) :]
    assert len(back) == len(there)
    for one, other in zip(there, back, strict=True):
        assert other.tla_deg == one.tla_deg + one.amplitude_deg
        assert other.amplitude_deg == -one.amplitude_deg


def test_static_cases_accelerate_at_constant_lever_and_altitude():
    for case in static_mesh():
        channels = case.channels(8.0)
        slow, held = mach_range(case.alt_ft, case.tla_deg)
        assert channels["Mach"][0] == pytest.approx(slow)
        assert (np.diff(channels["Mach"]) > 0.0).all()
        # Within a tenth of what the lever holds, and never faster.
        assert slow + 0.9 * (held - slow) < channels["Mach"][-1] < held
        assert np.ptp(channels["TRA_deg"]) == 0.0


def test_dynamic_cases_keep_the_trimmed_speed():
    for case in dynamic_mesh()[::7]:
        assert np.ptp(case.channels(8.0)["Mach"]) == 0.0


def test_more_lever_holds_more_speed_within_the_limits():
    for altitude_ft in (5000.0, 30_000.0, 45_000.0):
        helds = [mach_range(altitude_ft, tla)[1] for tla in (35.0, 40.0, 45.0, 50.0)]
        assert helds == sorted(helds)
        assert helds[0] > mach_of_cas(200.0, altitude_ft)
        assert helds[-1] == pytest.approx(min(0.85, mach_of_cas(330.0, altitude_ft)))


def test_a_ceiling_cuts_the_mesh():
    cases = static_mesh(CEILING_FT)
    assert max(case.alt_ft for case in cases) == 37_500.0
    for mesh in (static_mesh, dynamic_mesh):
        assert {case.name for case in mesh(CEILING_FT)} < {case.name for case in mesh()}


@pytest.mark.parametrize("mesh", [static_mesh, dynamic_mesh])
@pytest.mark.parametrize("ceiling_ft", [60_000.0, 1000.0, math.nan])
def test_a_ceiling_outside_the_mesh_is_refused(mesh, ceiling_ft):
    message = f"the mesh goes from 5000 to {TOP_FT:g} ft, and its ceiling should be"
    with pytest.raises(ConfigError, match=message):
        mesh(ceiling_ft)


def test_an_engine_can_fly_a_case():
    channels = dynamic_mesh()[0].channels()
    outputs = VirtualEngine().simulate({name: channels[name] for name in INPUT_NAMES}, 1 / 32)
    assert outputs["N1_pct"][-1] > outputs["N1_pct"][0] + 1.0


def test_a_raster_too_slow_is_refused():
    with pytest.raises(ConfigError, match=r"rate_hz has to lie in 4 \.\. 256, got 0"):
        static_mesh()[0].channels(0.0)
