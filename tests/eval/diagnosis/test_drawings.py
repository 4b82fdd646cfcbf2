"""Every effect has its drawing, with its sizes in words below."""

import numpy as np
import pytest

from eval.diagnosis.drawings import drawing
from narxcal.effects import LIBRARY, Signals, effect
from narxcal.effects.signal_path import AIR_DATA, AirDataEffect, SensorEffect
from training.diagnosis.budget import Interval

INPUTS = ("TRA_deg", "ALT_ft", "Mach", "dT_C", "Approach", "ECS", "NAI", "WAI", "unlogged")
OUTPUTS = ("N1_pct", "N2_pct", "EGT_C", "FF_kgph")
LOW, HIGH = np.array([30.0, 55.0, 400.0, 150.0]), np.array([95.0, 98.0, 700.0, 900.0])
SIGNALS = Signals(INPUTS, OUTPUTS, 0.125, "TRA_deg", LOW, HIGH, (0.0, 85.0), INPUTS)


def sizes(acting):
    found = {}
    for p in acting.parameters(SIGNALS):
        value = p.starts[0] if p.starts else 0.05 * p.high
        found[p.name] = Interval(value, 0.8 * value, 1.2 * value)
    return found


EVERY = {
    name: effect(name)
    for kind in LIBRARY
    for name in (
        [f"{kind}:{c}" for c in OUTPUTS]
        if issubclass(LIBRARY[kind], SensorEffect)
        else [f"{kind}:{c}" for c in AIR_DATA]
        if issubclass(LIBRARY[kind], AirDataEffect)
        else [kind]
    )
}


@pytest.mark.parametrize("acting", EVERY.values(), ids=EVERY)
def test_every_effect_is_drawn(acting):
    found = drawing(acting, sizes(acting), SIGNALS)
    assert found.svg.startswith("<svg")
    assert found.alt == f"{acting.name}: {acting.meaning}"
    assert "nan" not in found.svg.lower()
    assert found.caption.endswith(".")


@pytest.mark.parametrize("name", ["throttle_backlash", "throttle_delay", "sensor_lag:EGT_C"])
def test_an_effect_of_no_size_can_be_drawn(name):
    assert drawing(effect(name), {}, SIGNALS).svg.startswith("<svg")


def test_the_caption_says_how_large_and_how_sure():
    found = drawing(effect("throttle_backlash"), {"width_deg": Interval(2.0, 1.5, 2.6)}, SIGNALS)
    assert found.caption == (
        "Play in the throttle linkage: width_deg 2.00 ° (1.50 to 2.60). "
        "Shaded, or a thin line in a bar: 90 % interval."
    )


def test_of_many_sizes_those_that_are_not_nil_are_told_and_the_others_counted():
    given = {"NAI_EGT_C": Interval(30.0, 25.0, 35.0), "WAI_N1_pct": Interval(0.1, -0.1, 0.3)}
    caption = drawing(effect("bleed_extraction"), given, SIGNALS).caption
    assert "EGT with NAI 30.0 °C (25.0 to 35.0)" in caption
    assert "; 12 others may as well be 0." in caption


def test_the_same_effect_gives_the_same_bytes():
    acting = effect("sensor_lag:EGT_C")
    first, second = (drawing(acting, sizes(acting), SIGNALS).svg for _ in range(2))
    assert first == second


def test_a_lever_that_is_a_fuel_flow_is_drawn_in_its_unit():
    fuel = Signals(("FF_kgph",), OUTPUTS, 0.125, "FF_kgph", LOW, HIGH, (150.0, 900.0), ("FF_kgph",))
    found = drawing(effect("throttle_bias"), {"bias_deg": Interval(4.0, 3.0, 5.0)}, fuel)
    assert "what arrives [kg/h]" in found.svg


def test_a_slower_probe_starts_from_that_of_the_simulator():
    own = {"tau_s": Interval(0.9, 0.8, 1.0), "own_s": Interval(0.6, 0.5, 0.7)}
    drawn = drawing(effect("sensor_lag:EGT_C"), own, SIGNALS)
    assert ">1.5 s<" in drawn.svg
    alone = drawing(effect("sensor_lag:EGT_C"), {"tau_s": own["tau_s"]}, SIGNALS)
    assert ">0.9 s<" in alone.svg


def test_a_limit_of_the_control_is_drawn_as_the_time_that_a_pull_takes():
    own = {"ratio": Interval(0.5, 0.4, 0.8), "by_control": Interval(1.0, 1.0, 1.0)}
    by_control = drawing(effect("accel_decel_asymmetry"), own, SIGNALS)
    assert "limited transit, simulator = 1" in by_control.svg
    by_rotors = drawing(effect("accel_decel_asymmetry"), {"ratio": own["ratio"]}, SIGNALS)
    assert "time constant, simulator = 1" in by_rotors.svg
