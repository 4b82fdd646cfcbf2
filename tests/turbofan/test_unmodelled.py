"""What nobody modelled: each effect moves what it should, and none of it when neutral."""

import numpy as np
import pytest

from narxcal.support.errors import ConfigError
from narxcal.turbofan import Unmodelled, VirtualEngine
from narxcal.turbofan.engine import INPUT_NAMES
from narxcal.turbofan.transient import COLUMNS
from narxcal.turbofan.unmodelled import PARAMETERS

DT = 1.0 / 32.0
N1, N2, EGT, FF, FN = range(5)


@pytest.fixture(scope="module")
def flight(log):
    """Push and pull at 20 kft with bleed on, then approach idle."""
    t = np.arange(int(40.0 / DT)) * DT
    angle = np.interp(t, [0, 2, 3, 15, 16, 40], [15, 15, 75, 75, 0, 0])
    approach = (t > 25.0).astype(float)
    return log(
        len(t), TRA_deg=angle, ALT_ft=20000.0, Mach=0.5, dT_C=8.0, ECS=1.0, Approach=approach
    )


@pytest.fixture(scope="module")
def clean(flight):
    return VirtualEngine("business_jet").simulate(flight, DT)


def flown(flight, *effects):
    return VirtualEngine("business_jet", unmodelled=effects).simulate(flight, DT)


def deviation(run, clean, name="N1_pct"):
    return np.abs(run[name] - clean[name])


@pytest.mark.parametrize("effect", PARAMETERS)
def test_a_neutral_effect_leaves_every_bit_as_it_was(effect, flight, clean):
    neutral = {name: size.neutral for name, size in PARAMETERS[effect].items()}
    windows = ((5.0, 9.0),) if effect == "unlogged_switch" else ()
    if effect == "throttle_rate_limit":  # its neutral rate is only very fast
        found = flown(flight, Unmodelled(effect, neutral))
        assert all(np.allclose(found[name], clean[name], rtol=1e-12) for name in COLUMNS)
        return
    for parameters in (neutral, {}):
        found = flown(flight, Unmodelled(effect, parameters, windows))
        assert all(np.array_equal(found[name], clean[name]) for name in COLUMNS)


# Effects that change how the engine gets there, and not where.
TRANSIENT = {
    "throttle_delay": {"delay_s": 0.5},
    "throttle_rate_limit": {"rate_degps": 10.0},
    "actuator_lag": {"tau_s": 0.8, "slew": 0.5},
    "spool_lag": {"factor": 2.0},
    "spool_coupling": {"factor": 2.0},
    "accel_decel_asymmetry": {"ratio": 2.0},
    "accel_limit": {"factor": 0.4},
    "altitude_lag": {"exponent": 0.8},
    "heat_soak": {"factor": 3.0},
}
STEADY = {
    "throttle_bias": {"bias_deg": 4.0},
    "bleed_extraction": {"share": 0.05},
    "deterioration": {"hpc_efficiency_pct": 3.0},
    "temperature_effect": {"N1_pct_per_C": 0.2},
}


@pytest.mark.parametrize("effect", TRANSIENT)
def test_what_acts_on_the_way_leaves_the_steady_state_alone(effect, flight, clean):
    tuned = Unmodelled(effect, TRANSIENT[effect])
    found = flown(flight, tuned)
    name = "EGT_C" if effect == "heat_soak" else "N1_pct"
    assert deviation(found, clean, name)[:60].max() < 1e-6
    assert deviation(found, clean, name).max() > 0.5
    u = np.column_stack([flight[name] for name in INPUT_NAMES])[::200]
    plain, changed = (VirtualEngine(unmodelled=e).outputs(u) for e in ((), (tuned,)))
    assert np.array_equal(plain, changed)


@pytest.mark.parametrize("effect", STEADY)
def test_what_acts_at_rest_shifts_the_steady_state_as_it_shifts_the_run(effect, flight, clean):
    tuned = Unmodelled(effect, STEADY[effect])
    found = flown(flight, tuned)
    u = np.array([[flight[name][0] for name in INPUT_NAMES]])
    want = VirtualEngine(unmodelled=[tuned]).outputs(u)[0]
    assert found["EGT_C"][0] == pytest.approx(want[EGT], abs=1e-6)
    assert abs(found["EGT_C"][0] - clean["EGT_C"][0]) > 1.0


def test_backlash_acts_where_the_lever_turns_round(flight, clean):
    found = flown(flight, Unmodelled("throttle_backlash", {"width_deg": 6.0}))
    assert deviation(found, clean)[:64].max() < 1e-9
    assert deviation(found, clean)[int(10.0 / DT)] > 0.2


def test_a_delay_shifts_the_run(log):
    angle = np.where(np.arange(640) < 64, 20.0, 70.0)
    u = log(640, TRA_deg=angle)
    plain = flown(u)["N1_pct"]
    late = flown(u, Unmodelled("throttle_delay", {"delay_s": 16 * DT}))["N1_pct"]
    assert late[16:] == pytest.approx(plain[:-16], abs=1e-9)


def test_asymmetry_slows_only_the_way_up(flight, clean):
    found = flown(flight, Unmodelled("accel_decel_asymmetry", {"ratio": 2.0}))
    up, down = slice(int(2.0 / DT), int(10.0 / DT)), slice(int(16.5 / DT), int(20.0 / DT))
    assert deviation(found, clean)[up].max() > 5.0 * deviation(found, clean)[down].max()


def test_a_heavier_fan_trails_a_core_that_stays_quick(flight, clean):
    fan = flown(flight, Unmodelled("spool_coupling", {"factor": 2.0}))
    both = flown(flight, Unmodelled("spool_lag", {"factor": 2.0}))
    at = int(4.5 / DT)
    assert fan["N1_pct"][at] < clean["N1_pct"][at] - 0.5
    assert both["N2_pct"][at] < fan["N2_pct"][at] - 0.5


def test_thin_air_slows_aloft_and_not_at_sea_level(log):
    tuned = Unmodelled("altitude_lag", {"exponent": 1.0})
    angle = np.where(np.arange(320) < 64, 20.0, 75.0)
    shifts = []
    for condition in ({}, {"ALT_ft": 35000.0, "Mach": 0.5}):
        u = log(320, TRA_deg=angle, **condition)
        shifts.append(np.abs(flown(u, tuned)["N1_pct"] - flown(u)["N1_pct"]).max())
    assert shifts[0] < 0.2  # the intake's loss makes the air a little thin
    assert shifts[1] > 1.0


def test_bleed_is_taken_only_while_a_bleed_is_on(log):
    tuned = Unmodelled("bleed_extraction", {"share": 0.05})
    on = np.repeat([0.0, 1.0, 0.0], 200)
    u = log(600, TRA_deg=60.0, ECS=on)
    shift = flown(u, tuned)["EGT_C"] - flown(u)["EGT_C"]
    assert np.all(shift[:200] == 0.0)
    assert shift[300] > 10.0


def test_a_switch_acts_in_its_windows(log):
    u = log(640, TRA_deg=60.0)
    tuned = Unmodelled("unlogged_switch", {"bleed": 0.04, "power_kW": 10.0}, ((5.0, 10.0),))
    shift = flown(u, tuned)["EGT_C"] - flown(u)["EGT_C"]
    assert np.all(shift[: int(5.0 / DT)] == 0.0)
    assert shift[int(9.0 / DT)] > 10.0
    assert abs(shift[-1]) < 3.0


def test_a_switch_without_windows_is_never_on(flight, clean):
    found = flown(flight, Unmodelled("unlogged_switch", {"bleed": 0.1}))
    assert np.array_equal(found["EGT_C"], clean["EGT_C"])


def test_idle_shift_shows_at_approach_idle_alone(flight, clean):
    found = flown(flight, Unmodelled("idle_schedule", {"shift_pct": 4.0}))
    assert np.array_equal(found["N1_pct"][: int(25.0 / DT)], clean["N1_pct"][: int(25.0 / DT)])
    assert found["N1_pct"][-1] == pytest.approx(clean["N1_pct"][-1] + 4.0, abs=0.8)


def test_effects_add_up_in_any_order(flight):
    one = Unmodelled("spool_lag", {"factor": 1.5})
    two = Unmodelled("deterioration", {"hpt_efficiency_pct": 2.0})
    assert np.array_equal(flown(flight, one, two)["EGT_C"], flown(flight, two, one)["EGT_C"])


@pytest.mark.parametrize(
    ("effect", "message"),
    [
        (("spool_lagg",), r"unknown effect 'spool_lagg'\. Did you mean 'spool_lag'\?"),
        (("qqq",), r"unknown effect 'qqq'\. Known are accel_decel_asymmetry, "),
        (("spool_lag", {"factr": 2.0}), r"'spool_lag' has no parameter 'factr'\. Did you mean"),
        (("spool_lag", {"factor": 9.0}), r"factor has to lie in 0\.3 \.\. 4, found 9"),
        (("throttle_delay", {"delay_s": float("nan")}), r"delay_s has to lie in 0 \.\. 3 s"),
        (("spool_lag", {}, ((1.0, 2.0),)), "has no windows; unlogged_switch has"),
        (("unlogged_switch", {}, ((2.0, 1.0),)), "a window has to start before it stops"),
    ],
)
def test_a_wrong_effect_is_refused(effect, message):
    with pytest.raises(ConfigError, match=message):
        Unmodelled(*effect)


def test_what_is_left_out_is_neutral():
    assert Unmodelled("actuator_lag", {"tau_s": 1.0}).value("slew") == 1.0
