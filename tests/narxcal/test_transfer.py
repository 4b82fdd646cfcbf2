"""Step responses and state-space models: closed forms, twins by simulation, forms, schedules."""

import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.linalg import expm
from scipy.signal import lsim

from narxcal.state_space import StateSpace, coordinates, from_coordinates
from narxcal.support.errors import ConfigError, DataError, ModelError
from narxcal.transfer import Schedule
from training.papers.transfer_fit import (
    FirstOrder,
    Scale,
    SecondOrder,
    rise_times,
)

T = np.linspace(0.0, 12.0, 1201)


def simulated(xi, omega, u):
    """Oracle: the transfer function w^2 / (s^2 + 2 xi w s + w^2) driven by u (time,)."""
    system = ([omega**2], [1.0, 2.0 * xi * omega, omega**2])
    return lsim(system, u, T, interp=True)[1]


@pytest.mark.parametrize("xi", [0.1, 0.7, 0.999, 1.0, 1.001, 1.5, 5.0, 40.0])
def test_second_order_step_is_that_of_the_transfer_function(xi):
    np.testing.assert_allclose(
        SecondOrder(xi, 2.0).step(T), simulated(xi, 2.0, np.ones_like(T)), atol=2e-9
    )


def test_critical_damping_is_the_textbook_form():
    w = 1.7
    np.testing.assert_allclose(
        SecondOrder(1.0, w).step(T), 1.0 - (1.0 + w * T) * np.exp(-w * T), atol=1e-12
    )


def test_over_damped_step_is_the_form_with_two_time_constants():
    xi, w = 1.8, 2.3
    tau1, tau2 = (xi + s * np.sqrt(xi**2 - 1.0) for s in (1, -1))
    tau1, tau2 = tau1 / w, tau2 / w
    form = 1.0 - (tau1 * np.exp(-T / tau1) - tau2 * np.exp(-T / tau2)) / (tau1 - tau2)
    np.testing.assert_allclose(SecondOrder(xi, w).step(T), form, atol=1e-12)


def test_under_damped_step_is_the_form_with_a_sine():
    xi, w = 0.35, 2.3
    root = np.sqrt(1.0 - xi**2)
    form = 1.0 - np.exp(-xi * w * T) * np.sin(w * root * T + np.arccos(xi)) / root
    np.testing.assert_allclose(SecondOrder(xi, w).step(T), form, atol=1e-12)


@given(st.floats(0.9, 1.1), st.floats(0.1, 20.0))
def test_no_jump_between_damping_cases(xi, omega):
    near = SecondOrder(xi + 1e-9, omega).step(T)
    assert np.max(np.abs(near - SecondOrder(xi, omega).step(T))) < 1e-7


def test_rise_times_of_a_first_order_lag():
    t10, t90 = rise_times(T, FirstOrder(0.5).step(T))
    assert t90 == pytest.approx(0.5 * np.log(10.0), abs=1e-4)
    assert t90 / t10 == pytest.approx(21.85, abs=0.05)


def test_a_response_that_ends_early_has_no_rise_time():
    message = r"^the response does not reach 90 % within 12 s\. Record it for longer$"
    with pytest.raises(ModelError, match=message):
        rise_times(T, FirstOrder(20.0).step(T))


def test_scaling_and_back():
    ratio = 0.8 + 0.2 * FirstOrder(0.5).step(T)
    scale = Scale.of(ratio)
    np.testing.assert_allclose(scale.ratio(scale.scaled(ratio)), ratio, rtol=1e-14)
    assert scale.scaled(ratio)[[0, -1]].tolist() == [0.0, 1.0]


def test_a_response_that_does_not_move_is_refused():
    message = (
        r"^FPR moves from 1 to 1: the input never moves, or the output does not follow it\. "
        r"Leave this record out$"
    )
    with pytest.raises(DataError, match=message):
        Scale.of(np.ones(2), name="FPR")


# State space.
def second_order(xi=0.4, omega=2.0, dt_s=0.1):
    """Zero-order hold of the transfer function above, in phase variables."""
    A = np.array([[0.0, 1.0], [-(omega**2), -2.0 * xi * omega]])
    B = np.array([[0.0], [omega**2]])
    whole = expm(np.block([[A, B], [np.zeros((1, 3))]]) * dt_s)
    return StateSpace(whole[:2, :2], whole[:2, 2:], np.array([[1.0, 0.0]]), np.zeros((1, 1)), dt_s)


def random_model(random, order, outputs, inputs=1):
    poles = random.uniform(-0.4, 0.97, order)
    T = random.standard_normal((order, order)) + 2.0 * np.eye(order)
    shapes = (order, inputs), (outputs, order)
    B, C = (random.standard_normal(shape) for shape in shapes)
    return StateSpace(np.diag(poles), B, C, np.zeros((outputs, inputs)), 0.1).transformed(T)


def test_free_run_is_the_sampled_step_response():
    y = second_order().simulate(np.ones((120, 1)))[:, 0]
    np.testing.assert_allclose(y, SecondOrder(0.4, 2.0).step(0.1 * np.arange(120)), atol=1e-12)


def test_free_run_is_the_recursion_in_numpy():
    random = np.random.default_rng(0)
    model, u = random_model(random, 4, 3, 2), random.standard_normal((50, 2))
    x, slow = np.arange(4.0), []
    for row in u:
        slow.append(model.C @ x + model.D @ row)
        x = model.A @ x + model.B @ row
    np.testing.assert_allclose(model.simulate(u, np.arange(4.0)), slow, rtol=1e-10, atol=1e-12)


def test_poles_time_constants_and_gain():
    model = second_order(1.5, 2.0)
    rate = -2.0 * (1.5 - np.sqrt(1.25)), -2.0 * (1.5 + np.sqrt(1.25))
    np.testing.assert_allclose(model.time_constants_s, [-1.0 / r for r in rate], rtol=1e-9)
    assert model.gain[0, 0] == pytest.approx(1.0)
    assert model.stable


def test_a_model_is_stored_and_read():
    model = second_order()
    again = StateSpace.from_dict(json.loads(json.dumps(model.to_dict())))
    for name in "ABCD":
        np.testing.assert_array_equal(getattr(again, name), getattr(model, name))


@pytest.mark.parametrize("form", ["modal", "canonical"])
@pytest.mark.parametrize(("order", "outputs"), [(1, 1), (2, 1), (3, 1), (4, 2), (5, 5)])
def test_coordinates_and_back_keep_the_impulse_response(form, order, outputs):
    model = random_model(np.random.default_rng(order), order, outputs)
    again = from_coordinates(coordinates(model, form), (order, outputs, 1), 0.1, form)
    np.testing.assert_allclose(again.markov(30), model.markov(30), atol=1e-9)
    assert again.order == order


def test_coordinates_do_not_depend_on_the_basis():
    random = np.random.default_rng(5)
    model = random_model(random, 4, 1)
    other = model.transformed(random.standard_normal((4, 4)) + 3.0 * np.eye(4))
    for form in ("modal", "canonical"):
        np.testing.assert_allclose(
            coordinates(other, form), coordinates(model, form), rtol=1e-6, atol=1e-8
        )


def test_form_with_unit_output_matrix_is_the_model_in_its_outputs():
    model = random_model(np.random.default_rng(2), 3, 3)
    again = from_coordinates(coordinates(model, "output"), (3, 3, 1), 0.1, "output")
    np.testing.assert_allclose(again.markov(20), model.markov(20), atol=1e-9)
    np.testing.assert_array_equal(again.C, np.eye(3))


def test_modal_coordinate_of_one_pole_is_its_logarithm():
    def slow(tau):
        return StateSpace(*(np.array([[v]]) for v in (np.exp(-0.001 / tau), 1.0, 1.0, 0.0)), 0.001)

    middle = 0.5 * (coordinates(slow(0.5)) + coordinates(slow(2.0)))
    found = from_coordinates(middle, (1, 1, 1), 0.001).time_constants_s[0]
    assert found == pytest.approx(1.0, rel=1e-3)  # the geometric mean


def companion(*polynomial):
    c = np.array(polynomial[1:])
    A = np.diag(np.ones(len(c) - 1), 1)
    A[:, 0] = -c
    n = len(c)
    return StateSpace(A, np.ones((n, 1)), np.eye(1, n), np.zeros((1, 1)), 0.1)


# Stable cubics whose mean has a root of modulus 1.52.
CUBICS = companion(1, 2.6011, 2.2569, 0.6535), companion(1, -2.6437, 2.3504, -0.6998)


def halfway(pair, form):
    values = np.array([coordinates(model, form) for model in pair])
    table = Schedule(((0.0, 1.0),), values)
    first = pair[0]
    sizes = (first.order, *first.D.shape)
    return from_coordinates(table.at([0.5]), sizes, first.dt_s, form)


def test_canonical_interpolation_of_order_three_can_be_unstable():
    assert all(model.stable for model in CUBICS)
    assert np.abs(halfway(CUBICS, "canonical").poles).max() == pytest.approx(1.52, abs=0.01)
    assert halfway(CUBICS, "modal").stable


def test_interpolation_of_entries_is_unstable_for_two_stable_matrices():
    pair = [
        StateSpace(np.array(A), np.ones((2, 1)), np.eye(2), np.zeros((2, 1)), 0.1)
        for A in ([[0.0, 2.0], [0.0, 0.0]], [[0.0, 0.0], [2.0, 0.0]])
    ]
    assert all(model.stable for model in pair)
    assert np.abs(halfway(pair, "output").poles).max() == pytest.approx(1.0)
    assert np.abs(halfway(pair, "modal").poles).max() < 0.1


@given(st.integers(0, 10_000), st.integers(1, 5), st.floats(0.0, 1.0))
def test_modal_interpolation_is_always_stable(seed, order, share):
    random = np.random.default_rng(seed)

    def stable():
        pairs = random.uniform(0.0, 0.999, order // 2) * np.exp(
            1j * random.uniform(0.0, np.pi, order // 2)
        )
        poles = [*pairs, *pairs.conj(), *random.uniform(-0.999, 0.999, order % 2)]
        return companion(*np.real(np.poly(poles)))

    table = Schedule(((0.0, 1.0),), np.array([coordinates(stable()), coordinates(stable())]))
    assert from_coordinates(table.at([share]), (order, 1, 1), 0.1).stable


def test_schedule_is_bilinear_and_constant_beyond_its_grid():
    grid = np.array([[0.0, 1.0], [2.0, 3.0]])[..., np.newaxis]
    table = Schedule(((0.0, 10.0), (0.0, 1.0)), grid)
    assert table.at([5.0, 0.5])[0] == 1.5
    assert table.at([50.0, -3.0])[0] == 2.0


def test_a_schedule_with_holes_is_refused():
    message = (
        r"^a schedule over 2 x 2 conditions needs finite parameters at each, found \(2, 2\) of "
        r"which 1 are not: the mesh has holes$"
    )
    with pytest.raises(DataError, match=message):
        Schedule(((0.0, 1.0), (0.0, 1.0)), np.array([[[1.0], [2.0]], [[np.nan], [4.0]]]))


def test_sizes_that_do_not_fit_are_refused():
    with pytest.raises(ConfigError, match=r"^state space of order 2: expected \{'A': \(2, 2\)"):
        StateSpace(np.eye(2), np.ones((3, 1)), np.ones((1, 2)), np.zeros((1, 1)), 0.1)
    with pytest.raises(DataError, match=r"^expected inputs \(time, 1\), found \(5,\)$"):
        second_order().simulate(np.ones(5))


def test_unit_output_form_needs_as_many_outputs_as_states():
    message = r"^the form with C = I needs as many independent outputs as states and D = 0, found 1"
    with pytest.raises(ModelError, match=message):
        coordinates(second_order(), "output")
