"""The measurement chain: closed forms of each step, their order, seeds, and what is refused."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from narxcal.atmosphere import isa
from narxcal.flight_test.sensors import (
    PARAMETERS,
    PRESETS,
    ChannelSensor,
    SensorConfig,
    SensorFault,
    Streams,
    channels_of,
    record,
)
from narxcal.flight_test.signals import (
    at_times,
    coloured,
    first_order,
    frozen,
    quantised,
    slots,
    turbine_meter,
    windows,
    within,
)
from narxcal.support.errors import ConfigError

DT = 1 / 32
TIME = np.arange(0, 20, DT)
HERE = Streams(seed=7, flight=1, engine=0)
PERFECT = SensorConfig(preset="perfect")


def one(values, name="EGT_C", *, sensor=None, faults=(), where=HERE):
    """One channel through the chain of a perfect sensor, but for what is given."""
    given = {} if sensor is None else {name: ChannelSensor(**sensor)}
    config = SensorConfig(preset="perfect", channels=given)
    found = record({name: np.asarray(values, dtype=float)}, DT, config, where, faults)
    return found.channels[name], found.drawn.get(name, {})


def fault(effect, channel="EGT_C", windows_s=(), **parameters):
    return SensorFault(effect, channel, parameters, windows_s)


# Lags


@given(tau_s=st.floats(0.001, 50.0), slope=st.floats(-5, 5))
def test_a_lag_follows_a_ramp_as_the_textbook_says(tau_s, slope):
    ramp = first_order(300.0 + slope * TIME, tau_s, DT)
    expected = 300.0 + slope * (TIME - tau_s * -np.expm1(-TIME / tau_s))
    np.testing.assert_allclose(ramp, expected, atol=1e-8)


def test_a_lag_answers_a_step_by_an_exponential_from_the_end_of_the_step():
    step = np.where(TIME > 5.0, 1.0, 0.0)
    tau_s, first = 0.7, int(np.argmax(step))
    after = first_order(step, tau_s, DT)[first:]
    # The step takes one sample: during it the input rises in a straight line.
    left = tau_s / DT * -math.expm1(-DT / tau_s)
    np.testing.assert_allclose(1 - after, left * np.exp(-(TIME[: len(after)]) / tau_s), atol=1e-12)


@given(value=st.floats(-1e4, 1e4), tau_s=st.floats(0, 10))
def test_a_signal_at_rest_stays_at_rest_to_the_last_bit(value, tau_s):
    rest = np.full(50, value)
    np.testing.assert_array_equal(first_order(rest, tau_s, DT), rest)


@given(taus=st.tuples(st.floats(0.05, 3), st.floats(0.05, 3)))
def test_two_lags_do_not_mind_their_order(taus):
    step = np.where(TIME > 5.0, 700.0, 500.0)
    one_way = first_order(first_order(step, taus[0], DT), taus[1], DT)
    other = first_order(first_order(step, taus[1], DT), taus[0], DT)
    np.testing.assert_allclose(one_way, other, rtol=1e-12)


def test_a_turbine_meter_is_a_lag_whose_constant_is_inverse_to_the_flow():
    for flow in (100.0, 400.0):
        step = np.where(TIME > 2.0, 1.001 * flow, flow)
        shown = turbine_meter(step, 0.2, 200.0, DT)
        np.testing.assert_allclose(
            shown, first_order(step, 0.2 * 200.0 / flow, DT), atol=2e-6 * flow
        )


def test_a_turbine_meter_without_a_reference_is_a_plain_lag_and_without_a_lag_nothing():
    flow = 300.0 + 200.0 * np.sin(TIME)
    np.testing.assert_array_equal(turbine_meter(flow, 0.3, 0.0, DT), first_order(flow, 0.3, DT))
    np.testing.assert_array_equal(turbine_meter(flow, 0.0, 200.0, DT), flow)


def test_a_turbine_meter_answers_a_fall_later_than_a_rise_and_survives_no_flow():
    rise = turbine_meter(np.where(TIME > 2.0, 800.0, 200.0), 0.5, 400.0, DT)
    fall = turbine_meter(np.where(TIME > 2.0, 200.0, 800.0), 0.5, 400.0, DT)
    half = 500.0
    assert TIME[np.argmax(fall < half)] > TIME[np.argmax(rise > half)] + 0.1
    assert np.isfinite(turbine_meter(np.where(TIME > 2.0, 0.0, 800.0), 0.5, 400.0, DT)).all()


# Times


@given(skew_s=st.floats(-0.2, 0.2))
def test_a_clock_that_is_late_shows_what_was_a_while_ago(skew_s):
    values, _ = one(400.0 + 3.0 * TIME, faults=[fault("time_skew", skew_s=skew_s)])
    inside = slice(10, -10)
    np.testing.assert_allclose(values[inside], 400.0 + 3.0 * (TIME - skew_s)[inside], atol=1e-9)


def test_a_switch_is_never_between_its_positions():
    switch = np.where(TIME >= 5.0, 1.0, 0.0)
    shown, _ = one(switch, "NAI", faults=[fault("time_skew", "NAI", skew_s=0.4 * DT)])
    assert set(shown) == {0.0, 1.0}
    np.testing.assert_array_equal(shown[1:], switch[:-1])


def test_a_slot_of_a_frame_is_held_until_the_next():
    taken = slots(len(TIME), DT, 1.0, 0.25)
    shown = taken.time_s[taken.shown]
    expected = np.floor(TIME - 0.25) + 0.25
    np.testing.assert_allclose(shown, expected, atol=1e-9)
    values, _ = one(TIME + 10.0, sensor={"rate_hz": 1.0, "slot_s": 0.25})
    np.testing.assert_allclose(values, np.maximum(expected, 0.0) + 10.0, atol=1e-9)


@given(rate_hz=st.floats(0.2, 31.0), slot_s=st.floats(0, 5))
def test_no_slot_shows_the_future_or_what_is_older_than_a_frame(rate_hz, slot_s):
    taken = slots(len(TIME), DT, rate_hz, slot_s)
    age = TIME - taken.time_s[taken.shown]
    assert (age > -1e-6).all()
    assert (age < 1.0 / rate_hz + 1e-6).all()
    assert set(taken.shown) == set(range(len(taken.time_s)))


@pytest.mark.parametrize("rate_hz", [0.0, 32.0, 1000.0])
def test_every_row_is_a_sample_of_its_own_where_nothing_slower_is_asked_for(rate_hz):
    taken = slots(5, DT, rate_hz, 0.01)
    np.testing.assert_array_equal(taken.time_s, np.arange(5) * DT)
    np.testing.assert_array_equal(taken.shown, np.arange(5))


def test_values_before_the_log_are_its_first_and_after_it_its_last():
    values = np.array([1.0, 2.0, 3.0])
    for stepwise in (True, False):
        np.testing.assert_array_equal(
            at_times(values, DT, np.array([-1.0, 9.0]), stepwise=stepwise), [1.0, 3.0]
        )


# Noise, steps, gaps


def test_coloured_noise_has_its_variance_from_the_first_sample_on_and_its_memory():
    random = np.random.default_rng(0)
    runs = np.array([coloured(random, 200, 0.9) for _ in range(2000)])
    np.testing.assert_allclose(runs[:, [0, 20, 199]].std(axis=0), 1.0, rtol=0.06)
    assert np.mean(runs[:, 100] * runs[:, 105]) == pytest.approx(0.9**5, abs=0.06)


def test_white_noise_is_of_the_size_that_was_asked_for():
    level = 500.0
    values, _ = one(np.full(20000, level), sensor={"noise_sigma": 1.0, "noise_share": 0.002})
    assert values.std() == pytest.approx(1.0 + 0.002 * level, rel=0.03)
    assert np.corrcoef(values[1:], values[:-1])[0, 1] == pytest.approx(0.0, abs=0.03)


def test_a_late_clock_does_not_smooth_the_noise():
    sensor = {"noise_sigma": 1.0}
    late, _ = one(np.full(5000, 9.0), sensor=sensor, faults=[fault("time_skew", skew_s=DT / 2)])
    plain, _ = one(np.full(5000, 9.0), sensor=sensor)
    np.testing.assert_array_equal(late, plain)


def test_a_slow_channel_has_one_noise_per_sample():
    values, _ = one(np.full(640, 9.0), sensor={"noise_sigma": 1.0, "rate_hz": 2.0})
    assert len(set(values)) == 40


@given(value=st.floats(-1e3, 1e3), resolution=st.sampled_from([0.02, 0.5, 2.0]))
def test_a_reading_is_a_whole_number_of_steps_and_at_most_half_a_step_off(value, resolution):
    (shown,) = quantised(np.array([value]), resolution)
    assert shown / resolution == pytest.approx(round(shown / resolution), abs=1e-9)
    assert abs(shown - value) <= resolution / 2 * (1 + 1e-9)
    assert quantised(np.array([value]), 0.0)[0] == value


def test_gain_bias_and_drift_of_a_flight_are_those_that_are_reported():
    sensor = {"gain_sigma": 0.01, "bias_sigma": 2.0, "drift_sigma_per_h": 50.0}
    truth = 500.0 + 100.0 * np.sin(TIME)
    values, drawn = one(truth, sensor=sensor)
    expected = truth * (1 + drawn["gain"]) + drawn["bias"] + drawn["drift_per_h"] * TIME / 3600
    np.testing.assert_allclose(values, expected, rtol=1e-12)
    assert one(truth, sensor=sensor, where=HERE._replace(flight=2))[1] != drawn


def test_windows_come_as_often_and_last_as_long_as_asked():
    random, hours = np.random.default_rng(1), np.array([0.0, 100 * 3600.0])
    found = windows(random, hours, 6.0, 4.0)
    assert len(found) == pytest.approx(600, abs=80)
    assert np.mean([b - a for a, b in found]) == pytest.approx(4.0, abs=0.6)
    assert found == sorted(found)
    assert windows(random, hours, 0.0, 4.0) == []


def test_dropouts_are_blank_freezes_repeat_and_spikes_stand_alone():
    sensor = {
        "dropouts_per_h": 600.0,
        "freezes_per_h": 600.0,
        "spikes_per_h": 3600.0,
        "spike_size": 1000.0,
    }
    values, drawn = one(100.0 + TIME, sensor=sensor)
    lost = within(TIME, drawn["dropouts_s"])
    np.testing.assert_array_equal(np.isnan(values), lost)
    stuck = within(TIME, drawn["freezes_s"])
    wild = np.isin(TIME, drawn["spikes_s"])
    plain = ~lost & ~stuck & ~wild
    np.testing.assert_allclose(values[plain], 100.0 + TIME[plain], rtol=1e-12)
    assert (
        np.abs(np.abs(values[wild & ~lost & ~stuck] - 100 - TIME[wild & ~lost & ~stuck]) - 1000)
        < 1e-9
    ).all()
    assert lost.any()
    assert stuck.any()
    assert wild.any()


def test_a_frozen_stretch_shows_the_value_before_it():
    values = np.arange(6.0)
    shown = frozen(values, values, [(2.0, 4.0), (9.0, 12.0)])
    np.testing.assert_array_equal(shown, [0, 1, 1, 1, 4, 5])
    np.testing.assert_array_equal(frozen(values, values, [(0.0, 2.0)]), [0, 0, 2, 3, 4, 5])


def test_an_indicator_does_not_leave_its_scale_and_a_spike_does():
    sensor = {"bias_sigma": 1e-3, "noise_sigma": 1e-3}
    shown = [
        one(np.zeros(99), "Mach", sensor=sensor, where=HERE._replace(flight=f))[0] for f in range(9)
    ]
    assert np.min(shown) == 0.0
    wild, drawn = one(
        np.zeros(len(TIME)), "Mach", sensor={"spikes_per_h": 3600.0, "spike_size": 5.0}
    )
    assert drawn["spikes_s"]
    assert wild.min() < 0.0


# Faults of the effect library


def test_the_lag_of_a_fault_comes_on_top_of_the_sensors():
    truth = np.where(TIME > 5.0, 700.0, 500.0)
    values, _ = one(truth, sensor={"tau_s": 0.3}, faults=[fault("sensor_lag", tau_s=1.5)])
    np.testing.assert_allclose(
        values, first_order(first_order(truth, 0.3, DT), 1.5, DT), rtol=1e-12
    )


def test_a_bias_is_there_in_its_windows_and_everywhere_without_any():
    truth = np.full(len(TIME), 500.0)
    always, _ = one(truth, faults=[fault("sensor_bias", offset=8.0)])
    np.testing.assert_array_equal(always, truth + 8.0)
    spans = ((2.0, 4.0), (6.0, 7.0))
    sometimes, _ = one(truth, faults=[fault("sensor_bias", windows_s=spans, offset=8.0)])
    np.testing.assert_array_equal(sometimes - truth, 8.0 * within(TIME, list(spans)))


def test_a_drift_grows_in_its_windows_and_stays():
    truth = np.full(len(TIME), 500.0)
    always, _ = one(truth, faults=[fault("sensor_drift", rate_per_h=3600.0)])
    np.testing.assert_allclose(always - truth, TIME, atol=1e-9)
    part, _ = one(truth, faults=[fault("sensor_drift", windows_s=((5.0, 8.0),), rate_per_h=3600.0)])
    np.testing.assert_allclose(part - truth, np.clip(TIME - 5.0, 0.0, 3.0), atol=1.01 * DT)


def test_the_flow_meters_dynamics_act_on_fuel_flow():
    flow = np.where(TIME > 5.0, 900.0, 300.0)
    dynamic = fault("flowmeter_dynamics", "FF_kgph", tau_s=0.4, reference_kgph=500.0)
    values, _ = one(flow, "FF_kgph", faults=[dynamic])
    np.testing.assert_array_equal(values, turbine_meter(flow, 0.4, 500.0, DT))


@pytest.mark.parametrize("effect", PARAMETERS)
def test_a_fault_of_its_neutral_size_is_none(effect):
    channel = channels_of(effect)[0]
    truth = 0.5 + 0.1 * np.sin(TIME)
    sizes = {name: row[3] for name, row in PARAMETERS[effect].items()}
    for faults in ([SensorFault(effect, channel, sizes)], [SensorFault(effect, channel, {})]):
        np.testing.assert_array_equal(one(truth, channel, faults=faults)[0], truth)


def test_a_fault_on_one_channel_leaves_the_others_alone():
    truth = {"N1_pct": 50 + TIME, "EGT_C": 500 + TIME}
    plain = record(truth, DT, SensorConfig(), HERE).channels
    faulty = record(truth, DT, SensorConfig(), HERE, [fault("sensor_bias", offset=20.0)]).channels
    np.testing.assert_array_equal(plain["N1_pct"], faulty["N1_pct"])
    assert (faulty["EGT_C"] > plain["EGT_C"]).all()


# The whole chain


def flight():
    """All that a recorder sees of a climb."""
    truth = {
        "time_s": TIME,
        "TRA_deg": 40.0 + 5.0 * np.sin(TIME),
        "ALT_ft": 10000.0 + 100.0 * TIME,
        "Mach": 0.4 + 0.001 * TIME,
        "dT_C": np.full(len(TIME), 5.0),
        "NAI": (TIME > 9.0).astype(float),
        "N1_pct": 80.0 + np.sin(TIME),
        "EGT_C": 600.0 + 10 * np.sin(TIME),
        "FF_kgph": 400.0 + 30 * np.sin(TIME),
    }
    return {name: np.asarray(values, dtype=float) for name, values in truth.items()}


def test_a_perfect_recording_is_the_truth():
    found = record(flight(), DT, PERFECT, HERE)
    for name, values in flight().items():
        np.testing.assert_array_equal(found.channels[name], values)
    assert list(found.channels) == list(flight())
    assert found.drawn == {}


@pytest.mark.parametrize("preset", sorted(PRESETS))
def test_the_same_seed_gives_the_same_numbers_and_another_one_others(preset):
    config = SensorConfig(preset=preset)
    first, again, other = (
        record(flight(), DT, config, Streams(seed, 1, 0)).channels for seed in (1, 1, 2)
    )
    for name in first:
        np.testing.assert_array_equal(first[name], again[name])
    assert preset == "perfect" or (first["EGT_C"] != other["EGT_C"]).any()


def test_air_data_are_one_for_both_engines_and_the_engines_sensors_are_not():
    left, right = (record(flight(), DT, SensorConfig(), Streams(1, 1, e)).channels for e in (0, 1))
    for name in ("ALT_ft", "Mach", "dT_C", "NAI"):
        np.testing.assert_array_equal(left[name], right[name])
    for name in ("TRA_deg", "N1_pct", "EGT_C"):
        assert (left[name] != right[name]).any()


def test_a_further_fault_of_a_sensor_changes_no_other_number():
    config = SensorConfig()
    more = SensorConfig(channels={"EGT_C": ChannelSensor(dropouts_per_h=720.0)})
    plain, gappy = (record(flight(), DT, each, HERE).channels["EGT_C"] for each in (config, more))
    there = np.isfinite(gappy)
    assert not there.all()
    np.testing.assert_array_equal(gappy[there], plain[there])


def test_keys_that_are_not_given_are_the_presets():
    config = SensorConfig(channels={"N1_pct": ChannelSensor(resolution=0.5)})
    sensor = config.sensor("N1_pct")
    assert sensor.resolution == 0.5
    assert sensor.noise_sigma == PRESETS["test_instrumentation"]["N1_pct"].noise_sigma
    assert config.sensor("WOW") == ChannelSensor()


def test_inputs_can_be_recorded_as_they_are():
    found = record(flight(), DT, SensorConfig(inputs="exact"), HERE)
    for name in ("TRA_deg", "ALT_ft", "Mach", "dT_C", "NAI"):
        np.testing.assert_array_equal(found.channels[name], flight()[name])
    assert (found.channels["N1_pct"] != flight()["N1_pct"]).any()


def test_a_temperature_probe_that_lags_shows_a_false_deviation_while_climbing():
    tau_s = 2.0
    config = SensorConfig(preset="perfect", tat_tau_s=tau_s)
    truth = flight() | {"Mach": np.full(len(TIME), 0.5)}
    found = record(truth, DT, config, HERE).channels["dT_C"]
    # Total temperature falls in a straight line, so the probe ends up `tau_s` behind it.
    lapse = (isa(truth["ALT_ft"])[0][0] - isa(truth["ALT_ft"])[0][-1]) / TIME[-1]
    assert found[0] == 5.0
    assert found[-1] == pytest.approx(5.0 + lapse * tau_s, rel=1e-3)
    level = record(
        flight() | {"ALT_ft": np.full(len(TIME), 9e3), "Mach": np.full(len(TIME), 0.3)},
        DT,
        config,
        HERE,
    )
    np.testing.assert_allclose(level.channels["dT_C"], 5.0, rtol=1e-12)


# Refusals


@pytest.mark.parametrize(
    ("table", "message"),
    [
        (
            {"channels": {"EGT_K": {}}},
            "unknown channel 'EGT_K'. Did you mean 'EGT_C'?",
        ),
        (
            {"channels": {"SAT_C": {}}},
            (
                "[sensors.channels] names 'SAT_C', which no flight records. "
                "Name the lever, an ambient channel, a switch or an output"
            ),
        ),
        (
            {"channels": {"N1_pct": {"meter_reference_kgph": 200.0}}},
            (
                "[sensors.channels.N1_pct] has meter_reference_kgph. "
                "Only FF_kgph is measured by a turbine meter"
            ),
        ),
        (
            {"channels": {"N1_pct": {"noise": 1.0}}},
            "unknown key 'channels.N1_pct.noise'. Did you mean 'noise_sigma'?",
        ),
        (
            {"preset": "ideal"},
            (
                "key 'preset': Input should be 'test_instrumentation', 'fdr' or 'perfect', "
                "found 'ideal'"
            ),
        ),
        (
            {"channels": {"N1_pct": {"noise_sigma": -1.0}}},
            (
                "key 'channels.N1_pct.noise_sigma': Input should be greater than or equal to 0, "
                "found -1.0"
            ),
        ),
    ],
)
def test_settings_that_cannot_be_are_refused(table, message):
    with pytest.raises(ConfigError) as error:
        SensorConfig.parse(table)
    assert str(error.value) == message
