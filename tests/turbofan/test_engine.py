"""The whole engine with its control: what it promises its users, and published figures."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from narxcal.support.errors import ModelError
from narxcal.turbofan import VirtualEngine, build_scatter, maker_model
from narxcal.turbofan.cycle import Health
from narxcal.turbofan.engine import INPUT_NAMES, OUTPUT_NAMES, Unmodelled
from narxcal.turbofan.fadec import GOVERNOR
from narxcal.turbofan.transient import COLUMNS

N1, N2, EGT, FF, FN = range(5)
HZ = 32
CONDITIONS = {
    "ground": {"WOW": 1.0},
    "sea level": {},
    "10 kft": {"ALT_ft": 10000.0, "Mach": 0.4},
    "35 kft": {"ALT_ft": 35000.0, "Mach": 0.8},
}


def lever(*moves, end_s):
    """Lever angle at 32 Hz through (time, angle) `moves`, each a jump."""
    t = np.arange(int(end_s * HZ)) / HZ
    angle = np.zeros(len(t))
    for at, to in moves:
        angle[t >= at] = to
    return t, angle


def settled(engine, angle, condition):
    row = [angle] + [condition.get(name, 0.0) for name in INPUT_NAMES[1:]]
    return engine.outputs(np.array(row))


@pytest.fixture(scope="module", params=CONDITIONS)
def slam(request, bench, log):
    """Time, run, settled ends and condition of idle, take-off for 30 s, idle for 30 s."""
    condition = CONDITIONS[request.param]
    t, angle = lever((1.0, 85.0), (31.0, 0.0), end_s=61.0)
    run = bench.engine.simulate(log(len(t), TRA_deg=angle, **condition), 1.0 / HZ)
    ends = [settled(bench.engine, a, condition) for a in (0.0, 85.0)]
    return request.param, t, run, ends


def seconds_to_thrust(slam, share=0.95):
    _, t, run, (_, top) = slam
    return float(t[np.argmax((t >= 1.0) & (run["FN_kN"] >= share * top[FN]))]) - 1.0


def test_speed_meets_its_command_without_overshoot_or_cycling(slam):
    _, t, run, (idle, top) = slam
    up, down = (t > 1.0) & (t < 31.0), t > 31.0
    assert run["N1_pct"][up].max() < top[N1] + 0.1
    assert run["N1_pct"][down].min() > idle[N1] - 0.4
    late = (t > 26.0) & (t < 31.0)
    assert np.ptp(run["N1_pct"][late]) < 0.02
    assert run["N1_pct"][late] == pytest.approx(top[N1], abs=0.05)


def test_a_slam_stays_clear_of_surge(slam):
    assert slam[2]["hpc_angle"].max() < 0.85 * 0.5 * np.pi


def test_certified_acceleration_from_flight_idle_at_sea_level(slam):
    """14 CFR 33.73 : flight idle, or 15 % thrust, to 95 % in 5 s."""
    name, _, _, (idle, top) = slam
    if name == "sea level":
        assert idle[FN] < 0.15 * top[FN]
        assert 3.0 < seconds_to_thrust(slam) <= 5.0
    elif name == "35 kft":
        assert 6.0 < seconds_to_thrust(slam) < 12.0  # AGTF30 takes 10.2 s


def test_exhaust_temperature_overshoots_a_slam_and_blooms_away(slam):
    name, t, run, (_, top) = slam
    peak = run["EGT_C"][(t > 1.0) & (t < 31.0)].max()
    assert peak > top[EGT] + 8.0
    if name in ("ground", "sea level"):
        drift = float(np.interp(15.0, t, run["EGT_C"])) - top[EGT]
        assert 10.0 < drift < 30.0


def test_a_chop_ends_within_the_time_of_the_class(slam):
    _, t, run, (idle, _) = slam
    low = t[np.argmax((t > 31.0) & (run["N1_pct"] < idle[N1] + 5.0))] - 31.0
    assert 3.0 < low < 13.0  # AGTF30: 10 to 11.5 s


@pytest.mark.parametrize("condition", ["sea level", "35 kft"])
@pytest.mark.parametrize("pause_s", [1.5, 4.0])
def test_a_reslam_is_governed_as_well(bench, log, condition, pause_s):
    t, angle = lever((1.0, 85.0), (14.0, 0.0), (14.0 + pause_s, 85.0), end_s=45.0)
    run = bench.engine.simulate(log(len(t), TRA_deg=angle, **CONDITIONS[condition]), 1.0 / HZ)
    top = settled(bench.engine, 85.0, CONDITIONS[condition])
    assert run["N1_pct"].max() < top[N1] + 1.0
    assert np.ptp(run["N1_pct"][t > 40.0]) < 0.02
    assert run["hpc_angle"].max() < 0.5 * np.pi


@settings(max_examples=8)
@given(
    st.floats(0.0, 85.0),
    st.fixed_dictionaries(
        {
            "ALT_ft": st.floats(0.0, 39000.0),
            "Mach": st.floats(0.0, 0.8),
            "dT_C": st.floats(-30.0, 20.0),
            "ECS": st.sampled_from([0.0, 1.0]),
        }
    ),
)
def test_what_a_long_run_comes_to_is_the_steady_state(bench, log, angle, condition):
    samples = 3000
    angles = np.where(np.arange(samples) < 5, 0.9 * angle + 4.0, angle)
    run = bench.engine.simulate(log(samples, TRA_deg=angles, **condition), 0.2)
    want = settled(bench.engine, angle, condition)
    # 10 minutes: seven time constants of the casing.
    found = np.array([run[name][-1] for name in OUTPUT_NAMES])
    assert run["limiter"][-1] == GOVERNOR
    assert found == pytest.approx(want, rel=2e-4, abs=0.03)


def test_a_run_starts_settled(bench, log):
    run = bench.engine.simulate(log(400, TRA_deg=50.0, ALT_ft=20000.0, Mach=0.5), 1.0 / HZ)
    want = settled(bench.engine, 50.0, {"ALT_ft": 20000.0, "Mach": 0.5})
    for name, value in zip(OUTPUT_NAMES, want, strict=True):
        assert run[name] == pytest.approx(value, rel=1e-6)


def test_sampling_changes_nothing_but_where_it_is_looked_at(bench, log):
    """The lever moves at samples of the coarse log: the control's cycle is 15.6 ms in both."""
    t, angle = lever((1.0, 85.0), (9.0, 10.0), end_s=16.0)
    coarse = bench.engine.simulate(log(len(t), TRA_deg=angle), 1.0 / HZ)
    fine = bench.engine.simulate(log(2 * len(t), TRA_deg=np.repeat(angle, 2)), 0.5 / HZ)
    for name in COLUMNS[:-1]:  # where two limits agree to rounding, either may be named
        assert fine[name][::2] == pytest.approx(coarse[name], rel=1e-9, abs=1e-9)


def test_an_eighth_of_the_step_changes_a_slam_by_less_than_its_control_cycle(bench, log):
    t, angle = lever((1.0, 85.0), (9.0, 10.0), end_s=16.0)
    coarse = bench.engine.simulate(log(len(t), TRA_deg=angle), 1.0 / HZ)
    fine = bench.engine.simulate(log(8 * len(t), TRA_deg=np.repeat(angle, 8)), 0.125 / HZ)
    assert fine["N1_pct"][::8] == pytest.approx(coarse["N1_pct"], abs=0.4)
    assert fine["N2_pct"][::8] == pytest.approx(coarse["N2_pct"], abs=0.25)
    assert fine["EGT_C"][::8] == pytest.approx(coarse["EGT_C"], abs=3.5)


def test_inputs_are_left_as_they_were(bench, log):
    u = log(50, TRA_deg=60.0)
    VirtualEngine(bench.name, unmodelled=[Unmodelled("throttle_bias", {"bias_deg": 3.0})]).simulate(
        u, 1.0 / HZ
    )
    assert np.all(u["TRA_deg"] == 60.0)


def test_thrust_rises_with_the_lever_and_falls_with_altitude(bench):
    rows = np.zeros((9, 9))
    rows[:, 0] = np.linspace(0.0, 85.0, 9)
    assert np.all(np.diff(bench.engine.outputs(rows)[:, [N1, N2, FF, FN]], axis=0) > 0.0)
    rows[:, 0], rows[:, 1] = 85.0, np.linspace(0.0, 40000.0, 9)
    assert np.all(np.diff(bench.engine.outputs(rows)[:, FN]) < 0.0)


def test_a_degree_of_outside_air_costs_about_three_of_exhaust_gas(bench):
    hot, standard = (settled(bench.engine, 85.0, {"dT_C": d, "WOW": 1.0}) for d in (10.0, 0.0))
    assert 2.5 < (hot - standard)[EGT] / 10.0 < 4.2  # CFM56-7: about 3 at constant thrust
    assert hot[FN] == pytest.approx(standard[FN], rel=0.005)  # flat rated


@pytest.mark.parametrize(
    ("switch", "least", "most"), [("ECS", 8, 25), ("NAI", 8, 20), ("WAI", 5, 20)]
)
def test_bleed_costs_temperature_and_lowers_the_rating(bench, switch, least, most):
    on, off = (settled(bench.engine, 85.0, {switch: s}) for s in (1.0, 0.0))
    assert least < (on - off)[EGT] < most
    assert -0.85 < (on - off)[N1] < -0.35


def at_the_same_speed(bench, **health):
    """Changes by a build: degC, % of N2, % of fuel, at take-off N1."""
    worn = VirtualEngine(bench.name, build=Health(**health))
    new, old = (settled(e, 85.0, {}) for e in (bench.engine, worn))
    return (old - new)[EGT], 100.0 * (old / new - 1.0)[N2], 100.0 * (old / new - 1.0)[FF]


@pytest.mark.parametrize(
    ("part", "egt", "n2"),
    # AGTF30, per percent at take-off: degC of EGT, and the sign of the change in N2.
    [("hpc_efficiency", 7.0, -1), ("hpt_efficiency", 9.7, -1), ("lpt_efficiency", 6.5, 1)],
)
def test_wear_shows_its_signature(bench, part, egt, n2):
    found = at_the_same_speed(bench, **{part: 0.99})
    assert found[0] == pytest.approx(egt, rel=0.35)
    assert np.sign(found[1]) == n2
    assert 0.1 < abs(found[1]) < 0.8
    assert 0.3 < found[2] < 1.8


def test_lost_flow_speeds_the_core_up_where_lost_efficiency_slows_it(bench):
    found = at_the_same_speed(bench, hpc_flow=0.99)
    assert 0.1 < found[1] < 0.8
    assert abs(found[0]) < 3.0


def test_an_input_that_is_missing_or_of_another_length_is_refused(bench, log):
    whole = log(4)
    short = {name: values for name, values in whole.items() if name != "WAI"}
    for inputs in (short, {**whole, "WAI": np.zeros(3)}):
        with pytest.raises(ModelError, match=r"^expected inputs of one length: TRA_deg, ALT_ft, "):
            bench.engine.simulate(inputs, 1.0 / HZ)


def test_what_is_outside_the_envelope_is_named(bench, log):
    with pytest.raises(ModelError, match=r"sample 2: Mach is 0\.9 -, outside .* 0 \.\. 0\.85"):
        bench.engine.simulate(log(4, Mach=[0.1, 0.2, 0.9, 0.3]), 1.0 / HZ)
    with pytest.raises(ModelError, match="needs at least one sample, got none"):
        bench.engine.simulate(log(0), 1.0 / HZ)
    with pytest.raises(ModelError, match=r"steps of up to 0\.2 s, got 0\.5 s"):
        bench.engine.simulate(log(4), 0.5)
    with pytest.raises(ModelError, match="sample 1: ALT_ft is nan"):
        bench.engine.simulate(log(2, ALT_ft=[0.0, np.nan]), 1.0 / HZ)


def test_an_engine_that_cannot_run_is_named_with_its_condition(bench, log):
    broken = VirtualEngine(bench.name, build=Health(hpt_efficiency=0.3))
    where = "at TRA_deg 85, ALT_ft 500, Mach 0, dT_C 0, WOW 1, Approach 0, ECS 0, NAI 0, WAI 0"
    with pytest.raises(ModelError, match=f"the engine has no steady state {where}"):
        settled(broken, 85.0, {"ALT_ft": 500.0, "WOW": 1.0})
    with pytest.raises(ModelError, match=f"row 0: .* no steady state to start from {where}"):
        broken.simulate(log(5, TRA_deg=85.0, ALT_ft=500.0, WOW=1.0), 1.0 / HZ)


def test_a_run_that_loses_its_solution_says_where(log):
    drained = Unmodelled(
        "unlogged_switch", {"power_kW": 500.0, "bleed": 0.15}, windows=((1.0, 9.0),)
    )
    engine = VirtualEngine("business_jet", unmodelled=[drained])
    with pytest.raises(ModelError, match=r"gas path has no solution at TRA_deg 80") as caught:
        engine.simulate(log(320, TRA_deg=80.0), 1.0 / HZ)
    assert 32 < caught.value.row < 320


def test_outputs_keep_shape_and_missing_values_and_are_held_in_the_envelope(bench):
    u = np.zeros((2, 3, 9))
    u[..., 0] = 60.0
    u[1, 2, 3] = np.nan
    u[0, 1, 2] = 2.0
    found = bench.engine.outputs(u)
    assert found.shape == (2, 3, len(OUTPUT_NAMES))
    assert np.isnan(found[1, 2]).all()
    assert np.isfinite(found[0]).all()
    assert bench.engine.inside(u).tolist() == [[True, False, True], [True, True, False]]
    held = u[0, 1].copy()
    held[2] = 0.85
    assert np.array_equal(found[0, 1], bench.engine.outputs(held))


def test_builds_scatter_reproducibly_round_the_nominal_engine():
    one, two = (build_scatter(np.random.default_rng(3)) for _ in range(2))
    assert one == two
    many = np.array([build_scatter(np.random.default_rng(k), 0.5) for k in range(400)])
    assert many.mean() == pytest.approx(1.0, abs=5e-4)
    assert many.std() == pytest.approx(0.005, rel=0.1)


def test_the_makers_model_is_the_settled_business_jet():
    u = np.array([[70.0, 20000.0, 0.5, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0]])
    assert np.array_equal(maker_model(u), VirtualEngine("business_jet").outputs(u)[:, :3])
