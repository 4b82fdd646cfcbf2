"""Each effect's own equation, in closed form or in a loop written out."""

from dataclasses import replace

import numpy as np
import pytest

from narxcal.atmosphere import air_state
from narxcal.effects import Flights, effect, respond
from narxcal.effects.base import Run, as_simulated, together
from narxcal.effects.operators import lag, smooth_delay, smooth_lag

DT = 0.125
SPEEDS = ("N1_pct", "N2_pct")


def told(name, theta, flights, u):
    """What arrives of the levers (batch, time)."""
    rows = np.repeat(flights.u[:1, :1], u.shape[1], axis=1).repeat(len(u), axis=0)
    rows[..., 0] = u
    of = Run(flights.signals, np.atleast_2d(theta).repeat(len(u), axis=0), rows)
    found = effect(name).on_input(of, rows)
    np.testing.assert_array_equal(found[..., 1:], rows[..., 1:])
    return found[..., 0]


def paced(name, signals, *theta):
    """What is not as simulated in the pace of an effect: field -> value."""
    found = effect(name).pace(np.array([theta]), signals)
    usual = as_simulated(1)
    return {
        field: float(value[0])
        for field, value, same in zip(found._fields, found, usual, strict=True)
        if value[0] != same[0]
    }


def added(acting, flights, **amplitudes):
    """What an effect on outputs adds, with all amplitudes zero but these."""
    theta = [amplitudes.get(p.name, p.neutral) for p in acting.parameters(flights.signals)]
    return respond([(acting, np.array([theta]))], flights, None)[0] - flights.y


def test_backlash_in_a_lever_is_half_its_width_behind_either_way(flights):
    lever = np.concatenate([np.linspace(10, 30, 41), np.linspace(30, 10, 41)])[None]
    arrived = told("throttle_backlash", [4.0], flights, lever)[0]
    np.testing.assert_allclose(arrived[4:41], lever[0, 4:41] - 2.0)
    np.testing.assert_allclose(arrived[50:], lever[0, 50:] + 2.0)


def test_a_delay_and_a_limit_and_a_bias_of_the_lever(flights):
    t = DT * np.arange(60)
    ramp = 20.0 + 4.0 * t[None]
    np.testing.assert_allclose(
        told("throttle_delay", [0.45], flights, ramp)[0, 4:], ramp[0, 4:] - 4.0 * 0.45
    )
    np.testing.assert_allclose(told("throttle_rate_limit", [2.5], flights, ramp)[0], 20.0 + 2.5 * t)
    np.testing.assert_allclose(told("throttle_bias", [-1.5], flights, ramp), ramp - 1.5)


CLIMB = 5000.0 + 25.0 * DT * np.arange(400)


def frozen(start, stop):
    """The climb with a record that stands still from one sample to before another."""
    return np.where((np.arange(400) >= start) & (np.arange(400) < stop), CLIMB[start], CLIMB)


@pytest.mark.parametrize(
    ("name", "theta", "recorded", "true"),
    [
        ("air_data_bias:ALT_ft", 300.0, CLIMB + 300.0, CLIMB),
        ("air_data_delay:ALT_ft", 2.0, CLIMB - 50.0, np.minimum(CLIMB, CLIMB[-1] - 50.0)),
        ("air_data_frozen:ALT_ft", 1.0, frozen(100, 220), CLIMB),
        ("air_data_frozen:ALT_ft", 0.5, frozen(100, 220), 0.5 * (CLIMB + frozen(100, 220))),
        ("air_data_frozen:ALT_ft", 1.0, frozen(100, 160), frozen(100, 160)),  # too short
        ("air_data_frozen:ALT_ft", 1.0, frozen(100, 400), frozen(100, 400)),  # nobody knows
    ],
)
def test_an_engine_flies_the_air_data_that_are_meant(name, theta, recorded, true, flights):
    rows = np.repeat(flights.u[:1, :1], 400, axis=1)
    rows[..., 1] = recorded
    found = effect(name).on_input(Run(flights.signals, np.array([[theta]]), rows, "ALT_ft"), rows)
    np.testing.assert_allclose(found[0, :, 1], true)
    np.testing.assert_array_equal(np.delete(found, 1, axis=2), np.delete(rows, 1, axis=2))


@pytest.mark.parametrize(
    ("name", "theta", "changed"),
    [
        ("spool_lag", [2.0], dict.fromkeys(("fan_up", "fan_down", "core_up", "core_down"), 0.5)),
        ("spool_coupling", [2.0], {"fan_up": 0.5, "fan_down": 0.5}),
        ("accel_decel_asymmetry", [2.0, 0.0], {"fan_up": 0.5, "core_up": 0.5}),
        ("accel_decel_asymmetry", [2.0, 1.0], {"fall": 2.0}),
        ("accel_limit", [0.4, 30.0], {"limit": 0.4}),
        ("accel_limit", [1.0, 3.0], {"most": 3.0}),
        ("altitude_lag", [0.8], {"thin_air": 0.8}),
        ("actuator_lag", [0.6, 2.0, 0.0], {"valve_s": 0.6, "core_s": 2.0}),
        ("actuator_lag", [0.6, 2.0, 1.0], {"core_s": 2.0}),
    ],
)
def test_what_an_effect_says_of_the_pace(name, theta, changed, flights):
    assert paced(name, flights.signals, *theta) == changed


def test_heat_that_metal_takes_is_acceleration_that_the_core_lacks(flights):
    """`loss` %/s where the metal trails by the temperature's whole range; none, none at all."""
    theta = [40.0, 2.0, 0.0, -0.3, 0.1, 6.0]
    width = flights.signals.width("EGT_C")
    changed = {"loss": pytest.approx(6.0 / width), "metal_s": 40.0, "rise_s": 2.0}
    assert paced("heat_soak", flights.signals, *theta) == changed
    assert paced("heat_soak", flights.signals, *theta[:-1], 0.0) == {}


def test_where_fuel_drives_the_shares_of_the_speeds_say_what_metal_takes(flights):
    s = flights.signals
    signals = replace(s, inputs=("FF_kgph", *s.inputs[1:]), driver="FF_kgph")
    names = [p.name for p in effect("heat_soak").parameters(signals)]
    assert "loss" not in names
    assert "share_N1_pct" in names
    assert paced("heat_soak", signals, *[5.0] * len(names)) == {}


def test_metal_follows_the_exhaust_or_what_comes_last(flights):
    assert flights.signals.hot == 2
    without = replace(flights.signals, outputs=("N1_pct", "N2_pct", "FF_kgph", "P3_bar"))
    assert without.hot == 3


@pytest.mark.parametrize(
    ("driver", "theta", "lag_s"),
    [
        ("TRA_deg", [0.6, 2.0, 0.0], 0.0),
        ("TRA_deg", [0.6, 2.0, 1.0], 0.6),
        ("FF_kgph", [0.6], 0.6),
    ],
)
def test_outside_any_loop_a_slow_valve_is_one_lag_of_all_outputs(driver, theta, lag_s, flights):
    s = flights.signals
    s, y = replace(s, inputs=(driver, *s.inputs[1:]), driver=driver, outputs=SPEEDS), flights.y
    valve = effect("actuator_lag")
    assert len(valve.parameters(s)) == len(theta)
    found = valve.on_output(Run(s, np.repeat([theta], len(y), axis=0), flights.u), y[..., :2])
    for j in range(2):
        lagged = lag(y[..., j], np.full(len(y), lag_s), DT)
        np.testing.assert_array_equal(found[..., j], lagged)
    if driver == "FF_kgph":
        assert paced("actuator_lag", s, 0.6) == {}


def test_effects_on_the_pace_add_up(flights):
    paces = [effect(n).pace(np.array([t]), flights.signals) for n, t in PACES]
    found = together(paces)
    np.testing.assert_allclose(found.fan_up, 1.0 / (2.0 * 1.5))
    np.testing.assert_allclose(found.core_up, 1.0 / 2.0)
    np.testing.assert_allclose(found.limit, 0.4 * 0.5)
    np.testing.assert_allclose(found.thin_air, 0.3)
    np.testing.assert_allclose(found.valve_s, 0.6)


PACES = [
    ("spool_lag", [2.0]),
    ("spool_coupling", [1.5]),
    ("accel_limit", [0.4, 30.0]),
    ("accel_limit", [0.5, 30.0]),
    ("altitude_lag", [0.3]),
    ("actuator_lag", [0.6, 1.0, 0.0]),
]


def test_the_air_is_that_of_the_intake(flights):
    u = flights.u[:, :3]
    air = air_state(u[..., 1], u[..., 2], u[..., 3])
    expected = air.P2_Pa / 101325.0 / np.sqrt(air.T2_K / 288.15)
    np.testing.assert_allclose(flights.signals.thin_air(u), expected)


def test_a_time_constant_that_is_scaled_is_that_of_the_run(flights, fly, engine):
    """N2 answers a step of the steady state as 1 - exp(-t / (factor tau))."""
    u = np.repeat(flights.u[:1, :1], 200, axis=1)
    u[:, 1:, 0] += 8.0
    of, factor = fly(u), 1.6
    found = respond([(effect("spool_lag"), np.array([[factor]]))], of, engine)[0, 0, :, 1]
    rate = np.exp(-u[0, 0, 1] / 40000.0) / 0.8 / factor
    expected = found[-1] + (found[1] - found[-1]) * (1.0 - rate * DT) ** np.arange(199)
    np.testing.assert_allclose(found[1:], expected, atol=2e-3)


def test_shapes_that_follow_switches_settle_at_them(flights):
    found = added(effect("unlogged_switch"), flights, on_EGT_C=7.0)
    on = flights.u[..., flights.signals.u("unlogged")]
    since = np.diff(on, axis=1, prepend=on[:, :1])
    last = np.flatnonzero(since[0])[0]
    assert found[0, last - 1, 2] == pytest.approx(7.0 * on[0, 0], abs=1e-9)
    t = DT * np.arange(1, 60)
    gone = np.abs(found[0, last + 1 : last + 60, 2] - 7.0 * on[0, last])
    np.testing.assert_allclose(gone, gone[0] * np.exp(-(t - DT)), rtol=1e-6)
    np.testing.assert_array_equal(found[..., [0, 1, 3]], 0.0)


def test_deterioration_is_a_line_over_power(flights):
    found = added(effect("deterioration"), flights, base_EGT_C=3.0, power_EGT_C=9.0)
    s, n1 = flights.signals, flights.y[..., 0]
    expected = 3.0 + 9.0 * (n1 - s.low[0]) / (s.high[0] - s.low[0])
    np.testing.assert_allclose(found[..., 2], expected)


def test_a_hot_day_in_tens_of_degrees(flights):
    found = added(effect("temperature_effect"), flights, per_10K_N1_pct=0.5)
    np.testing.assert_allclose(found[..., 0], 0.05 * flights.u[..., 3], atol=1e-12)


def test_metal_that_warms_up_has_its_time_constant(flights, fly):
    u = np.repeat(flights.u[:1, :1], 1600, axis=1)
    u[:, 1:, 0] += 30.0
    of = fly(u)
    theta = [{"tau_s": 30.0, "share_N2_pct": 0.01}.get(p.name, 0.0)
             for p in effect("heat_soak").parameters(of.signals)]  # fmt: skip
    found = respond([(effect("heat_soak"), np.array([theta]))], of, None)[0, 0] - of.y[0]
    late = found[200:, 1]
    rise = of.y[0, -1, 2] - of.y[0, 0, 2]
    assert late[0] == pytest.approx(0.01 * rise * np.exp(-24.0 / 30.0), rel=0.05)
    np.testing.assert_allclose(late / late[0], np.exp(-DT * np.arange(1400) / 30.0), rtol=1e-3)


def test_offsets_superpose(flights):
    one, two = effect("deterioration"), effect("bleed_extraction")
    first = added(one, flights, base_EGT_C=4.0)
    second = added(two, flights, NAI_N2_pct=1.0, ECS_EGT_C=3.0)
    thetas = []
    for acting, sizes in ((one, {"base_EGT_C": 4.0}), (two, {"NAI_N2_pct": 1.0, "ECS_EGT_C": 3.0})):
        names = [p.name for p in acting.parameters(flights.signals)]
        thetas.append(np.array([[sizes.get(name, 0.0) for name in names]]))
    both = respond([(one, thetas[0]), (two, thetas[1])], flights, None)[0] - flights.y
    np.testing.assert_allclose(both, first + second, atol=1e-9)


def test_a_sensor_may_be_biased_or_drift(flights):
    bias = added(effect("sensor_bias:N2_pct"), flights, bias=-0.4)
    np.testing.assert_allclose(bias[..., 1], -0.4)
    drift = added(effect("sensor_drift:EGT_C"), flights, rate_per_h=720.0)
    np.testing.assert_allclose(drift[..., 2], np.tile(0.2 * DT * np.arange(240), (3, 1)))


def test_a_channel_recorded_late_is_the_channel_earlier(flights):
    found = added(effect("time_skew:N1_pct"), flights, skew_s=4 * DT) + flights.y
    np.testing.assert_allclose(found[:, 4:, 0], flights.y[:, :-4, 0])
    part = added(effect("time_skew:N1_pct"), flights, skew_s=0.3) + flights.y
    late = smooth_delay(flights.y[..., 0], np.full(3, 0.3), DT)
    np.testing.assert_allclose(part[..., 0], late)


def test_a_lagging_probe_lags_its_channel(flights):
    found = added(effect("sensor_lag:EGT_C"), flights, tau_s=1.7) + flights.y
    np.testing.assert_allclose(found[..., 2], smooth_lag(flights.y[..., 2], np.full(3, 1.7), DT))


def test_a_slower_probe_takes_the_place_of_the_one_in_the_simulator(flights):
    own, tau, signals = 0.8, 1.5, flights.signals
    value = flights.y[..., 2]
    y = flights.y.copy()
    y[..., 2] = lag(value, np.full(3, own), DT)
    of = Flights(signals, flights.u, y, flights.lengths)
    found = respond([(effect("sensor_lag:EGT_C"), np.array([[tau, own]]))], of, None)[0, ..., 2]
    slower = lag(value, np.full(3, own + tau), DT)
    np.testing.assert_allclose(found, slower, atol=0.01 * np.ptp(value))


def test_a_flowmeter_lags_as_any_sensor(flights):
    meter = added(effect("flowmeter_dynamics:FF_kgph"), flights, tau_s=0.9)
    sensor = added(effect("sensor_lag:FF_kgph"), flights, tau_s=0.9)
    np.testing.assert_array_equal(meter, sensor)
