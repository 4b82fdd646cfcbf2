"""The stand-in engine behaves like the kind of engine that narxcal has to identify."""

import re

import numpy as np
import pytest

from narxcal.atmosphere import air_state
from narxcal.channels import CHANNELS
from narxcal.errors import ConfigError
from narxcal.standin import INPUT_NAMES, OUTPUT_NAMES, StandInEngine, maker_model
from narxcal.standin_pilot import NOISE, fly

DT_S = 1.0 / 32.0
SLAM_S = 5.0


def lever_step(before, after, *, altitude_ft=0.0, mach=0.25, seconds=60.0):
    """Settle at `before`, slam to `after` within half a second: (time after the slam, outputs)."""
    time_s = np.arange(0.0, seconds, DT_S)
    inputs = {name: np.zeros_like(time_s) for name in INPUT_NAMES}
    inputs["TRA_deg"] = np.interp(time_s, [SLAM_S, SLAM_S + 0.5], [before, after])
    inputs["ALT_ft"] += altitude_ft
    inputs["Mach"] += mach
    return time_s - SLAM_S, StandInEngine().simulate(inputs, DT_S), inputs


def crossing_s(time_s, values, share):
    response = (values - values[0]) / (values[-1] - values[0])
    return time_s[np.argmax(response > share)]


def open_loop_tau_s(n, altitude_factor):
    """Slowest eigenvalue of the spools at constant fuel, by a central difference."""
    engine, step = StandInEngine(), 1e-6
    fuel = float(engine._fuel(n))
    state = np.array([n, float(engine._core(n))])
    columns = []
    for axis in np.eye(2):
        low, high = state - step * axis, state + step * axis
        columns.append(
            (
                np.array(engine._rates((*high, fuel), n, altitude_factor)[:2])
                - np.array(engine._rates((*low, fuel), n, altitude_factor)[:2])
            )
            / (2 * step)
        )
    return float(np.max(-1.0 / np.real(np.linalg.eigvals(np.array(columns)))))


@pytest.mark.parametrize("altitude_ft", [0.0, 20_000.0, 39_000.0])
@pytest.mark.parametrize("levers", [(0.0, 85.0), (85.0, 0.0), (30.0, 38.0)])
def test_a_held_lever_settles_on_the_makers_model(altitude_ft, levers):
    _, outputs, inputs = lever_step(*levers, altitude_ft=altitude_ft, seconds=90.0)
    settled = StandInEngine().steady_state(np.column_stack([inputs[name] for name in INPUT_NAMES]))
    for column, name in enumerate(OUTPUT_NAMES):
        assert outputs[name][0] == pytest.approx(settled[0, column], rel=1e-9)
        assert outputs[name][-1] == pytest.approx(settled[-1, column], rel=1e-6)


def test_a_slam_takes_seconds_at_sea_level_and_about_twice_as_long_at_altitude():
    low_s, low, _ = lever_step(0.0, 85.0)
    high_s, high, _ = lever_step(0.0, 85.0, altitude_ft=35_000.0, mach=0.78)
    sea_level = crossing_s(low_s, low["N1_pct"], 0.95)
    assert 4.0 < sea_level < 7.0
    assert 1.8 < crossing_s(high_s, high["N1_pct"], 0.95) / sea_level < 2.8


def test_open_loop_lags_shrink_with_power_and_grow_with_altitude():
    idle, top = StandInEngine().idle_ground, 1.0
    assert open_loop_tau_s(idle, 1.0) / open_loop_tau_s(top, 1.0) == pytest.approx(2.5, rel=0.05)
    air = air_state(35_000.0, 0.78)
    factor = float(np.sqrt(air.theta2) / air.delta2)
    for n, low, high in ((idle, 1.7, 2.5), (top, 3.0, 4.0)):
        assert low < open_loop_tau_s(n, factor) / open_loop_tau_s(n, 1.0) < high


def test_acceleration_and_deceleration_are_not_mirror_images():
    up_s, up, _ = lever_step(20.0, 80.0)
    down_s, down, _ = lever_step(80.0, 20.0)
    rise, fall = crossing_s(up_s, up["N1_pct"], 0.5), crossing_s(down_s, down["N1_pct"], 0.5)
    assert rise > 1.3 * fall


def test_core_leads_the_fan_and_a_small_push_overshoots_in_temperature():
    time_s, outputs, _ = lever_step(40.0, 48.0)
    assert crossing_s(time_s, outputs["N2_pct"], 0.5) < crossing_s(time_s, outputs["N1_pct"], 0.5)
    egt = outputs["EGT_C"]
    assert egt.max() - egt[0] > 1.15 * (egt[-1] - egt[0])
    assert outputs["N2_pct"].max() > outputs["N2_pct"][-1] + 0.1


def test_anti_ice_heats_the_exhaust_and_lowers_n1():
    condition = np.array([70.0, 5000.0, 0.4, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0])
    iced = condition.copy()
    iced[INPUT_NAMES.index("NAI")] = 1.0
    n1, _, egt = maker_model(iced) - maker_model(condition)
    assert -0.8 < n1 < -0.4
    assert egt > 0.0


def test_the_same_seed_gives_the_same_flight_and_another_seed_another():
    first, again, other = fly(3, 200.0), fly(3, 200.0), fly(4, 200.0)
    assert all(np.array_equal(first[name], again[name]) for name in first)
    assert not np.array_equal(first["TRA_deg"], other["TRA_deg"])


@pytest.mark.parametrize("seed", range(8))
def test_a_flight_stays_within_the_canonical_ranges(seed):
    flight = fly(seed)
    assert len(flight["time_s"]) == 480 * 32
    for name, values in flight.items():
        channel = CHANNELS[name]
        assert np.all(np.isfinite(values))
        assert channel.low <= values.min()
        assert values.max() <= channel.high


@pytest.mark.parametrize("seed", range(6))
def test_a_flight_has_pushes_and_pulls_fast_and_slow(seed):
    lever = fly(seed)["TRA_deg"]
    travel = lever[32:] - lever[:-32]
    assert np.sum(np.diff((travel > 8.0).astype(int)) == 1) >= 4
    assert np.sum(np.diff((travel < -8.0).astype(int)) == 1) >= 4
    slow = lever[3 * 32 :] - lever[: -3 * 32]
    assert np.any((np.abs(slow) > 8.0) & (np.abs(slow) < 30.0))


def test_sensor_noise_has_the_level_it_claims():
    flight = fly(0)
    for name in ("N1_pct", "N2_pct", "EGT_C"):
        # Second differences remove the signal; white noise leaves them sqrt(6) times its own.
        curvature = np.diff(flight[name][:1500], 2)
        spread = 1.4826 * np.median(np.abs(curvature)) / np.sqrt(6.0)
        assert spread == pytest.approx(NOISE[name], rel=0.15)


def test_a_flight_too_short_for_its_phases_is_refused():
    message = "a stand-in flight lasts at least 120 s, got 60 s"
    with pytest.raises(ConfigError, match=f"^{re.escape(message)}$"):
        fly(0, 60.0)
