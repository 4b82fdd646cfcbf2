"""Chains of the Spey engine, and what its tables imply."""

from itertools import product

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from narxcal.output_error.blocks import LinearSystem, Rotors, lag
from narxcal.output_error.engine import (
    DuctPressures,
    EngineAndControl,
    EngineFromFuel,
    EngineFromSteady,
    ThrottleLinkage,
)
from narxcal.output_error.paper import (
    PROGRAMMES,
    TABLE_3,
    TABLE_4,
    TAU_ENGINE,
    fly,
    noise_sd,
    table_4,
    throttle_programme,
)
from training.papers.likelihood_statistics import combine

DT = 0.05


def values_of(model, base=None, **given):
    return {one.name: one.start for one in model.parameters} | (base or {}) | given


def command(seed=0, points=600):
    return np.random.default_rng(seed).normal(size=(points, 1)).cumsum(axis=0) * 0.3


def test_the_whole_chain_is_its_parts_in_series():
    whole = EngineAndControl(DT)
    values = values_of(whole, table_4("left"))
    # A meter too fast to be seen, so that its output is the fuel flow of the parts.
    values |= {"zeta": 1.0, "omega": 2e3, "N_HO": 0.3}
    u = command()
    delta_TM, W_FM, N_HM, N_LM, P_TM, P_DM = whole.simulate(values, u).T
    linkage = ThrottleLinkage().simulate(values_of(ThrottleLinkage(), table_4("left")), u)
    np.testing.assert_allclose(delta_TM, linkage[:, 0])
    # The parts take signals as linear between samples; within the loop they bend.
    engine = EngineFromFuel(DT).simulate({**values, "tau_M": 0.0}, W_FM[:, None])
    np.testing.assert_allclose(engine[:, 0], N_HM, atol=0.01)
    np.testing.assert_allclose(engine[:, 1], N_LM, atol=0.02)
    speeds = np.column_stack([N_HM - 0.3, N_LM - values["N_LO"]])
    pressures = DuctPressures(DT).simulate(values, speeds)
    np.testing.assert_allclose(pressures, np.column_stack([P_TM, P_DM]), atol=0.02)


def test_steady_speed_is_the_commanded_one_when_feedback_and_engine_balance():
    model = EngineAndControl(DT)
    values = values_of(model, table_4("right"), a_fixed=0.0)
    y = model.simulate(values, np.full((50, 1), -10.0))
    np.testing.assert_allclose(y[:, 2], -7.212, atol=1e-9)


def test_a_level_dependent_throttle_play_is_wider_at_larger_deflections():
    u = np.array([[0.0], [-1.0], [-20.0], [-21.0], [-20.0]])
    model = ThrottleLinkage()
    y = model.simulate(values_of(model, a_fixed=0.1, a_prop=0.05, b0=0.0, b1=1.0), u)[:, 0]
    np.testing.assert_allclose(y, [0.0, -0.85, -18.9, -19.85, -19.85])


def test_initial_states_fade_with_their_time_constants():
    model = EngineFromFuel(DT)
    values = values_of(model, tau_H=0.5, tau_L=0.2, alpha=1.0, N_H_start=2.0)
    y = model.simulate(values, np.zeros((40, 1)))
    np.testing.assert_allclose(y[:, 0], 2.0 * np.exp(-np.arange(40) * DT / 0.5), atol=1e-12)
    np.testing.assert_allclose(y[:, 1], 0.0, atol=1e-12)


def test_a_lag_of_the_meter_is_undone():
    model = EngineFromFuel(0.005)
    fuel = command(3, 4000)
    truth = values_of(model)
    fine = model.simulate(truth, fuel)
    metered = lag(1.0, 0.4).respond(fuel, 0.005)
    undone = model.simulate({**truth, "tau_M": 0.4}, metered)
    np.testing.assert_allclose(undone, fine, atol=0.03)


def test_the_engine_from_steady_values_is_a_linear_one_on_straight_curves():
    rotors = Rotors(tau_H=0.3, tau_L=0.4, C_FH=0.2, C_HL=2.5, alpha=0.3).system()
    drive = LinearSystem.gain([[1.0 - 1.7, 0.0, 1.7 * 0.2]])
    outputs = LinearSystem.gain(np.eye(3)[:2]).beside(drive.then(lag(6.0, 0.8)))
    linear = rotors.beside(LinearSystem.gain([[1.0]])).then(outputs)
    fuel = command(4)
    H = 0.2 * fuel[:, 0]
    u = np.column_stack([H, 2.5 * H, 6.0 * H, np.full_like(H, 2.5), np.full_like(H, 6.0)])
    whole = EngineFromSteady(DT)
    own = {"tau_H": 0.3, "tau_L": 0.4, "alpha": 0.3, "tau_T": 0.8, "beta": 1.7}
    y = whole.simulate(values_of(whole, own, rate_H=0.0, rate_L=0.0), u)
    # Within a sample N_H is a line here and an exponential there.
    np.testing.assert_allclose(y, linear.respond(fuel, DT), atol=0.02)


def test_a_scheduled_time_constant_converges_to_its_differential_equation():
    end = 12.0

    def slope(t, state):
        return (10.0 * np.sin(0.5 * t) - state) / (0.5 * np.exp(-0.1 * (state - 2.0)))

    exact = solve_ivp(slope, (0.0, end), [0.0], rtol=1e-10, atol=1e-10).y[0, -1]
    errors = []
    for dt in (0.05, 0.005):
        model = EngineFromSteady(dt, reference=2.0)
        u = np.zeros((round(end / dt) + 1, 5))
        u[:, 0] = 10.0 * np.sin(0.5 * np.linspace(0.0, end, len(u)))
        y = model.simulate(values_of(model, tau_H=0.5, rate_H=0.1), u)
        errors.append(abs(y[-1, 0] - exact))
    assert errors[0] < 0.1
    assert errors[1] == pytest.approx(0.1 * errors[0], rel=0.1)  # first order in the step


@pytest.mark.parametrize("side", ["left", "right"])
def test_the_papers_time_constant_of_engine_and_governor_follows_from_its_parameters(side):
    row = table_4(side)
    product_ = row["tau_H"] / (row["K_AF"] * row["C_FB"])
    assert product_ == pytest.approx(TAU_ENGINE.side(side)[0], abs=0.005)


def test_no_other_product_of_powers_gives_that_time_constant_for_both_engines():
    names = ("tau_H", "K_AF", "C_FH", "alpha", "C_HL", "tau_L")
    powers = np.array(list(product(range(-2, 3), repeat=len(names))))
    logs = [np.log([table_4(side)[name] for name in names]) for side in ("left", "right")]
    near = [
        np.abs(np.exp(powers @ log) - TAU_ENGINE.side(side)[0]) < 0.005
        for log, side in zip(logs, ("left", "right"), strict=True)
    ]
    assert [tuple(row) for row in powers[near[0] & near[1]]] == [(1, -1, -1, 0, 0, 0)]


def test_the_weighted_means_of_table_3_are_table_4_for_the_six_rotor_rows():
    final = {row.name: row for row in TABLE_4}
    found = {row.name: combine(row.estimates, row.sd) for row in TABLE_3}
    agree = [
        name
        for name, one in found.items()
        if abs(one.value - final[name].left) <= final[name].left_sd
    ]
    assert agree == ["tau_H", "C_FH", "alpha", "C_HL", "tau_L", "N_LO"]
    assert found["tau_H"].value == pytest.approx(0.2316, abs=5e-5)
    assert found["tau_H"].birge == pytest.approx(9.5, abs=0.05)
    assert found["C_HL"].birge == pytest.approx(22.0, abs=0.5)


@pytest.mark.parametrize("kind", PROGRAMMES)
def test_a_throttle_programme_stays_in_its_range_and_below_the_rate_of_the_servo(kind):
    u = throttle_programme(kind, 2000, 5.0)
    assert u.min() >= -10.0
    assert u.max() <= 0.0
    assert np.ptp(u) > 8.0
    assert np.abs(np.diff(u)).max() <= 20.0 * DT + 1e-12


def test_simulated_records_have_the_noise_of_table_1_and_depend_on_the_seed_alone():
    one, same, other = fly(table_4("left"), 1), fly(table_4("left"), 1), fly(table_4("left"), 2)
    assert [len(record.signals["delta_c"]) for record in one] == [3000, 3000, 2000]
    for name, sd in noise_sd().items():
        if name != "delta_c":
            a, b = one[0].signals[name], other[0].signals[name]
            np.testing.assert_array_equal(a, same[0].signals[name])
            assert (a - b).std() == pytest.approx(np.sqrt(2.0) * sd, rel=0.05)
