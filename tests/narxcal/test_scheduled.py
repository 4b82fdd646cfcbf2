"""Responses behind a moving steady value, against closed forms and a differential equation."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.signal import lsim

from narxcal.transfer import ResponseFromSteady, Schedule, node_weights, respond

DT = 0.1
TIME = DT * np.arange(100)
RAMP = np.minimum(TIME / 2.0, 1.0)


def constant(*values):
    return np.tile(np.log(np.array(values, dtype=complex)), (len(TIME), 1))


@pytest.mark.parametrize("xi", [0.3, 1.0, 3.0])
def test_the_response_to_a_ramp_is_that_of_the_transfer_function(xi):
    second, first = ([4.0], [1.0, 4.0 * xi, 4.0]), ([1.0], [0.7, 1.0])
    for system, logs in ((second, constant(xi, 2.0)), (first, constant(0.7))):
        y, _ = respond(RAMP, logs.real, DT)
        np.testing.assert_allclose(y, lsim(system, RAMP, TIME, interp=True)[1], atol=1e-9)


@pytest.mark.parametrize("xi", [0.3, 1.0, 3.0])
def test_complex_steps_give_the_slope_of_the_response(xi):
    exact = respond(RAMP, constant(xi + 1e-20j, 2.0), DT)[0].imag / 1e-20
    ahead, behind = (respond(RAMP, constant(xi + d, 2.0).real, DT)[0] for d in (1e-6, -1e-6))
    np.testing.assert_allclose(exact, (ahead - behind) / 2e-6, atol=1e-8)


def test_a_scheduled_second_order_converges_to_its_differential_equation():
    def frequency(t):
        return 1.0 + 0.1 * t

    def slope(t, state):
        w = frequency(t)
        return [state[1], w * w * (np.sin(t) - state[0]) - 1.4 * w * state[1]]

    exact = solve_ivp(slope, (0.0, 8.0), [0.0, 0.0], rtol=1e-10, atol=1e-12).y[0, -1]
    errors = []
    for dt in (0.02, 0.002):
        t = np.linspace(0.0, 8.0, round(8.0 / dt) + 1)
        logs = np.log(np.column_stack([np.full_like(t, 0.7), frequency(t)]))
        errors.append(abs(respond(np.sin(t), logs, dt)[0][-1] - exact))
    assert errors[0] < 0.01
    assert errors[1] < 0.2 * errors[0]


def test_a_measurement_replaces_the_output_after_its_sample():
    measured = np.full(len(TIME), np.nan)
    measured[20] = 5.0
    free, _ = respond(np.zeros(len(TIME)), constant(0.5).real, DT)
    y, end = respond(np.zeros(len(TIME)), constant(0.5).real, DT, None, measured)
    np.testing.assert_array_equal(y[:21], free[:21])
    np.testing.assert_allclose(y[21:], 5.0 * np.exp(-(TIME[21:] - TIME[20]) / 0.5))
    assert end[0] == y[-1]


def test_weights_of_nodes_interpolate_as_a_schedule_does():
    axes = ((0.0, 1.0), (0.0, 10.0, 20.0))
    values = np.random.default_rng(0).normal(size=(2, 3, 4))
    at = np.array([[0.2, 3.0], [0.9, 17.0], [-1.0, 99.0]])
    weights = node_weights(axes, at)
    np.testing.assert_allclose(weights.sum(axis=1), 1.0)
    np.testing.assert_allclose(weights @ values.reshape(6, 4), Schedule(axes, values).at(at))
    np.testing.assert_allclose(
        Schedule(axes, values).at((0.2, 3.0)), Schedule(axes, values).at(at)[0]
    )


def test_parameters_are_named_by_output_and_node():
    model = ResponseFromSteady("N1_pct", "second", ("level=20", "level=80"), DT)
    names = [one.name for one in model.parameters]
    assert names == ["xi_N1_pct@level=20", "w_N1_pct@level=20",
                     "xi_N1_pct@level=80", "w_N1_pct@level=80"]  # fmt: skip
    assert [one.name for one in ResponseFromSteady("EGT_C", "first", ("",), DT).parameters] == [
        "tau_EGT_C"
    ]
