"""The lumped engine: at rest it rests, its control holds, every effect does what it should."""

from functools import cache

import numpy as np
import pytest

from eval.diagnosis.blind.lumped import KINDS, LumpedEngine, applies, fuel_needed, speed_followed
from narxcal.turbofan import Unmodelled
from narxcal.turbofan.cycle import Health
from narxcal.turbofan.unmodelled import PARAMETERS

DT = 1.0 / 16.0
GOVERNED = ("lumped_n1", "lumped_n2")
LARGE = {
    "throttle_backlash": {"width_deg": 5.0},
    "throttle_delay": {"delay_s": 0.5},
    "throttle_rate_limit": {"rate_degps": 5.0},
    "throttle_bias": {"bias_deg": 3.0},
    "actuator_lag": {"tau_s": 0.5},
    "spool_lag": {"factor": 1.6},
    "spool_coupling": {"factor": 1.6},
    "accel_decel_asymmetry": {"ratio": 1.6},
    "accel_limit": {"factor": 0.5},
    "altitude_lag": {"exponent": 1.0},
    "heat_soak": {"factor": 3.0},
    "bleed_extraction": {"share": 0.04},
    "unlogged_switch": {"bleed": 0.04},
    "deterioration": {"hpt_efficiency_pct": 3.0},
    "temperature_effect": {"N1_pct_per_C": 0.2},
    "idle_schedule": {"shift_pct": 5.0},
}


def flight(kind="lumped_n1", alt_ft=5000.0, steps=((0, 20.0), (40, 70.0), (80, 20.0), (120, 0.0))):
    time_s = np.arange(0.0, 160.0, DT)
    lever = np.select([time_s >= t for t, _ in reversed(steps)], [v for _, v in reversed(steps)])
    zero = np.zeros_like(time_s)
    inputs = {
        "TRA_deg": lever,
        "ALT_ft": zero + alt_ft,
        "Mach": zero + 0.3,
        "dT_C": zero + 10.0,
        "WOW": zero,
        "Approach": (time_s > 120.0) * 1.0,
        "ECS": zero,
        "NAI": (time_s > 60.0) * 1.0,
        "WAI": zero,
    }
    if kind == "lumped_fuel":
        fuel = LumpedEngine("lumped_n2").simulate(inputs, DT)["FF_kgph"]
        del inputs["TRA_deg"]
        inputs["FF_kgph"] = fuel
    return inputs


def flown(kind, effect=None, parameters=None, inputs=None, windows=(), **more):
    effects = [] if effect is None else [Unmodelled(effect, parameters or {}, windows)]
    inputs = flight(kind) if inputs is None else inputs
    return LumpedEngine(kind, unmodelled=effects, **more).simulate(inputs, DT)


@cache
def undisturbed(kind):
    return flown(kind)


@pytest.mark.parametrize("kind", KINDS)
def test_at_rest_it_rests(kind):
    inputs = {name: np.full(400, values[0]) for name, values in flight(kind).items()}
    for name, values in flown(kind, inputs=inputs).items():
        assert np.abs(values - values[0]).max() < 2e-3 * abs(values[0]), name


@pytest.mark.parametrize("kind", KINDS)
def test_speeds_and_temperature_are_those_of_an_engine(kind):
    found = undisturbed(kind)
    assert 20.0 < found["N1_pct"].min() < 40.0
    assert 80.0 < found["N1_pct"].max() < 100.0
    assert 55.0 < found["N2_pct"].min() < 70.0
    assert 85.0 < found["N2_pct"].max() < 100.0
    assert 250.0 < found["EGT_C"].min() < found["EGT_C"].max() < 800.0
    assert 50.0 < found["FF_kgph"].min() < found["FF_kgph"].max() < 1200.0


def test_each_control_holds_its_own_speed():
    bleed = {"windows": ((20.0, 39.0),), "effect": "unlogged_switch", "parameters": {"bleed": 0.05}}
    at = round(38.0 / DT)
    for kind, held, free in (
        ("lumped_n1", "N1_pct", "N2_pct"),
        ("lumped_n2", "N2_pct", "N1_pct"),
    ):
        with_it, without = flown(kind, **bleed), undisturbed(kind)
        moved = {name: abs(with_it[name][at] - without[name][at]) for name in (held, free)}
        assert moved[held] < 0.05
        assert moved[free] > 0.5
        assert with_it["EGT_C"][at] > without["EGT_C"][at] + 20.0


def test_the_ungoverned_one_answers_with_its_speeds():
    with_it = flown("lumped_fuel", "deterioration", {"hpt_efficiency_pct": 3.0})
    without = undisturbed("lumped_fuel")
    assert (with_it["N2_pct"] - without["N2_pct"]).max() < 0.0
    np.testing.assert_allclose(with_it["FF_kgph"][50:], without["FF_kgph"][50:], rtol=1e-9)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("effect", PARAMETERS)
def test_a_neutral_effect_changes_nothing_and_a_large_one_something(kind, effect):
    windows = ((50.0, 70.0),) if effect == "unlogged_switch" else ()
    neutral = {name: size.neutral for name, size in PARAMETERS[effect].items()}
    without = undisturbed(kind)
    for name, values in flown(kind, effect, neutral, windows=windows).items():
        np.testing.assert_allclose(values, without[name], rtol=1e-9)
    large = flown(kind, effect, LARGE[effect], windows=windows)
    moved = max(
        np.abs(large[n] - without[n]).max() / np.ptp(without[n]) for n in ("N1_pct", "EGT_C")
    )
    assert (moved > 0.004) == applies(effect, kind)


def test_a_delay_is_a_delay():
    inputs = {**flight(), "NAI": np.zeros(2560), "Approach": np.zeros(2560)}
    late = flown("lumped_n2", "throttle_delay", {"delay_s": 8 * DT}, inputs)
    without = flown("lumped_n2", inputs=inputs)
    for name in late:
        np.testing.assert_allclose(late[name][8:], without[name][:-8], rtol=1e-4)


@pytest.mark.parametrize("kind", ["lumped_n2", "lumped_fuel"])
def test_inertia_slows_the_transit_and_not_the_end(kind):
    heavy, without = flown(kind, "spool_lag", {"factor": 1.5}), undisturbed(kind)
    start, half = round(40.0 / DT), 0.5
    times = []
    for found in (heavy, without):
        speed = found["N2_pct"][start : start + round(35.0 / DT)]
        passed = speed > speed[0] + half * (speed[-1] - speed[0])
        times.append(float(np.argmax(passed)))
    assert times[0] > 1.15 * times[1]
    assert heavy["N2_pct"][start - 1] == pytest.approx(without["N2_pct"][start - 1], abs=0.1)


def test_asymmetry_leaves_pulls_alone():
    pull = flight(steps=((0, 60.0), (40, 20.0)))
    pull |= {"NAI": 0.0 * pull["NAI"], "Approach": 0.0 * pull["NAI"]}
    slow = flown("lumped_fuel", "accel_decel_asymmetry", {"ratio": 1.5}, fuelled(pull))
    without = flown("lumped_fuel", inputs=fuelled(pull))
    np.testing.assert_allclose(slow["N2_pct"], without["N2_pct"], atol=0.12)


def fuelled(inputs):
    fuel = 200.0 + 4.0 * inputs["TRA_deg"]
    return {name: values for name, values in inputs.items() if name != "TRA_deg"} | {
        "FF_kgph": fuel
    }


def test_soak_delays_the_temperature_by_minutes():
    soaked, without = flown("lumped_n1", "heat_soak", {"factor": 3.0}), undisturbed("lumped_n1")
    after, later = round(47.0 / DT), round(79.0 / DT)
    cold = [without["EGT_C"][k] - soaked["EGT_C"][k] for k in (after, later)]
    assert cold[0] > cold[1] > 0.0


def test_play_is_that_of_the_play_operator():
    lever = 40.0 + 20.0 * np.sin(np.arange(2560) / 100.0)
    engine = LumpedEngine(unmodelled=[Unmodelled("throttle_backlash", {"width_deg": 4.0})])
    heard = engine._heard(lever, DT)
    state, expected = lever[0], []
    for angle in lever:
        state = min(max(state, angle - 2.0), angle + 2.0)
        expected.append(state)
    np.testing.assert_allclose(heard, expected, rtol=1e-12)


def test_a_build_and_a_probe_are_its_own():
    worse = LumpedEngine(build=Health(hpt_efficiency=0.98)).simulate(flight(), DT)
    slow = LumpedEngine(probe=2.0).simulate(flight(), DT)
    without = undisturbed("lumped_n1")
    assert (worse["EGT_C"] - without["EGT_C"]).mean() > 3.0
    np.testing.assert_array_equal(slow["N1_pct"], without["N1_pct"])
    assert np.abs(slow["EGT_C"] - without["EGT_C"]).max() > 10.0


def test_curves_pass_full_power_and_rise():
    speeds = np.linspace(0.55, 1.05, 50)
    for curve in (fuel_needed, speed_followed):
        assert curve(1.0) == pytest.approx(1.0)
        assert np.all(np.diff([curve(each) for each in speeds.tolist()]) > 0.0)
