"""Blocks of the Spey model against closed forms, slow twins and finite differences."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from narxcal.output_error.blocks import (
    Governor,
    LinearSystem,
    Rotors,
    flowmeter,
    lag,
    play,
    recursion,
)
from narxcal.support.errors import ModelError

DT = 0.05
TIME = np.arange(400) * DT
STEP = np.ones(400)
LEFT = {"tau_H": 0.232, "tau_L": 0.437, "C_FH": 0.114, "C_HL": 3.39, "alpha": 0.64}
RIGHT = {"tau_H": 0.312, "tau_L": 0.423, "C_FH": 0.118, "C_HL": 3.02, "alpha": 0.56}
K_AF = {"left": 3.11, "right": 2.96}
ENGINES = [(LEFT, 3.11, 0.654), (RIGHT, 2.96, 0.893)]


def from_rest(system, u, hold):
    return system.respond(u, DT, hold, np.zeros(len(system.A)))


def test_a_step_through_a_lag_is_exact_under_zero_order_hold():
    y = from_rest(lag(1.36, 0.4), STEP, "zoh")[:, 0]
    np.testing.assert_allclose(y, 1.36 * (1.0 - np.exp(-TIME / 0.4)), atol=1e-12)


def test_a_ramp_through_a_lag_is_exact_under_first_order_hold():
    y = from_rest(lag(2.0, 0.4), TIME, "foh")[:, 0]
    expected = 2.0 * (TIME - 0.4 * (1.0 - np.exp(-TIME / 0.4)))
    np.testing.assert_allclose(y, expected, atol=1e-12)


def test_on_a_ramp_zero_order_hold_lags_by_about_half_a_sample_more():
    zoh, foh = (from_rest(lag(1.0, 0.3), TIME, hold)[-1, 0] for hold in ("zoh", "foh"))
    assert TIME[-1] - foh == pytest.approx(0.3)
    assert TIME[-1] - zoh == pytest.approx(DT / (1.0 - np.exp(-DT / 0.3)))


def test_a_time_constant_of_zero_drops_the_state():
    assert lag(4.1, 0.0).A.shape == (0, 0)
    np.testing.assert_array_equal(lag(4.1, 0.0).respond(TIME, DT)[:, 0], 4.1 * TIME)
    series = Rotors(**LEFT).system().then(LinearSystem.gain([[4.1, 0.0]]))
    np.testing.assert_allclose(
        series.respond(STEP, DT)[:, 0], 4.1 * 0.114 * np.ones(400), atol=1e-12
    )


def test_a_run_without_a_start_begins_in_equilibrium():
    y = Rotors(**LEFT).system().respond(5.0 * STEP, DT)
    np.testing.assert_allclose(y, np.tile([0.57, 0.57 * 3.39], (400, 1)), atol=1e-12)


def test_the_flowmeter_overshoots_by_53_percent_and_lags_a_ramp_by_two_zeta_over_omega():
    time = np.arange(4000) * 0.002
    step = flowmeter(0.2, 13.0).respond(np.ones(4000), 0.002, "zoh", np.zeros(2))[:, 0]
    assert step.max() - 1.0 == pytest.approx(np.exp(-np.pi * 0.2 / np.sqrt(0.96)), abs=1e-4)
    assert step.max() - 1.0 == pytest.approx(0.527, abs=5e-4)
    ramp = flowmeter(0.2, 13.0).respond(time, 0.002, "foh", np.zeros(2))[:, 0]
    assert time[-1] - ramp[-1] == pytest.approx(2 * 0.2 / 13.0, rel=1e-4)


def test_rotors_with_equal_time_constants_have_their_critical_response():
    system = Rotors(**{**LEFT, "tau_L": 0.3, "tau_H": 0.3, "alpha": 0.0}).system()
    y = from_rest(system, STEP, "zoh")[:, 1]
    s = TIME / 0.3
    np.testing.assert_allclose(y, 3.39 * 0.114 * (1 - (1 + s) * np.exp(-s)), atol=1e-12)


def loop(values, k_af, **more):
    governor = Governor(**{"K_AF": k_af, "C_FB": values["C_FH"], **more})
    return governor, governor.engine(Rotors(**values).system())


@pytest.mark.parametrize(("values", "k_af", "tau"), ENGINES)
def test_engine_and_governor_are_one_lag_of_tau_engine(values, k_af, tau):
    governor, plant = loop(values, k_af)
    closed = governor.closed_loop(plant)
    y = closed.respond(k_af * STEP, DT, "zoh", np.zeros(2))
    exact = values["tau_H"] / (k_af * values["C_FH"])
    assert exact == pytest.approx(tau, abs=5e-4)
    np.testing.assert_allclose(y[:, 0], 1.0 - np.exp(-TIME / exact), atol=1e-12)
    first_jump, final = y[0, 2], 1.0 / values["C_FH"]
    assert first_jump / final == pytest.approx(k_af * values["C_FH"])
    assert y[-1, 2] == pytest.approx(final, rel=1e-6)


def test_feedback_of_another_size_gives_the_general_time_constant_and_gain():
    governor, plant = loop(LEFT, 3.11, C_FB=0.15)
    y = governor.closed_loop(plant).respond(3.11 * STEP, DT, "zoh", np.zeros(2))[:, 0]
    stiffness = 1.0 - 0.114 / 0.15 + 0.114 * 3.11
    expected = 0.114 * 3.11 / stiffness * (1.0 - np.exp(-TIME * stiffness / 0.232))
    np.testing.assert_allclose(y, expected, atol=1e-12)


@given(
    u=st.lists(st.floats(-10, 10), min_size=2, max_size=60),
    r=st.floats(0, 3),
    proportional=st.floats(0, 0.5),
)
def test_play_equals_a_machine_of_three_contacts(u, r, proportional):
    w, expected = u[0], []
    for value in u:
        width = r + proportional * abs(value)
        gap = value - w
        if gap > width:  # pushes at the upper contact
            w = value - width
        elif gap < -width:
            w = value + width
        expected.append(w)
    np.testing.assert_allclose(play(np.array(u), r, proportional), expected, atol=1e-12)


def test_play_has_its_one_sided_derivative_by_complex_step():
    u = np.array([0.0, 0.1, 2.0, 1.9, -2.0, -1.9, -1.2])
    w = play(u, 0.5 + 1e-20j)
    np.testing.assert_array_equal(w.imag / 1e-20, [0, 0, -1, -1, 1, 1, 1])
    np.testing.assert_allclose(w.real, [0, 0, 1.5, 1.5, -1.5, -1.5, -1.5])


def test_complex_steps_equal_central_differences_through_the_closed_loop():
    base = np.array([*LEFT.values(), 3.11])
    command = np.random.default_rng(1).normal(size=300).cumsum() * 0.2

    def run(point):
        governor, plant = loop(dict(zip(LEFT, point[:-1], strict=True)), point[-1])
        return governor.respond(plant, command, DT)

    for unit in np.eye(len(base)):
        exact = run(base + 1e-20j * unit).imag / 1e-20
        difference = (run(base + 1e-6 * unit) - run(base - 1e-6 * unit)) / 2e-6
        np.testing.assert_allclose(exact, difference, atol=1e-6 * np.abs(exact).max())


def test_a_lead_undoes_a_lag():
    u = np.cumsum(np.random.default_rng(2).normal(size=2000)) * 0.1
    system = Rotors(**LEFT).system()
    fine = 0.005
    exact = lag(1.0, 0.6).then(system).lead(0.6).respond(u, fine)
    np.testing.assert_allclose(exact, system.respond(u, fine), atol=1e-9)


def test_recursion_equals_a_plain_loop():
    rng = np.random.default_rng(3)
    phi, drive, x = 0.3 * rng.normal(size=(3, 3)), rng.normal(size=(50, 3)), rng.normal(size=3)
    expected = [x]
    for row in drive:
        expected.append(phi @ expected[-1] + row)
    np.testing.assert_allclose(recursion(phi, drive, x), expected, atol=1e-12)


def test_a_system_that_integrates_has_no_equilibrium():
    integrator = LinearSystem(np.zeros((1, 1)), np.ones((1, 1)), np.ones((1, 1)), np.zeros((1, 1)))
    with pytest.raises(ModelError) as error:
        integrator.respond(STEP, DT)
    assert str(error.value) == (
        "the system integrates its input and has no equilibrium. Give the initial state"
    )
