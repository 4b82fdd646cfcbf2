"""Newton's method: the same solution from anywhere, and an honest failure."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from narxcal.turbofan.cycle import Health, Running
from narxcal.turbofan.gas import intake
from narxcal.turbofan.solve import TOLERANCE, balances, invert, largest_magnitude, solve


@given(st.integers(0, 10_000), st.integers(1, 7))
def test_inversion_agrees_with_numpy(seed, n):
    matrix = np.random.default_rng(seed).standard_normal((n, n)) + 0.1 * np.eye(n)
    found = np.empty((n, n))
    assert invert(matrix.copy(), found)
    scale = np.abs(np.linalg.inv(matrix)).max()
    assert found == pytest.approx(np.linalg.inv(matrix), abs=1e-9 * scale * np.linalg.cond(matrix))


@pytest.mark.parametrize("fault", [np.ones((3, 3)), np.full((3, 3), np.nan), np.zeros((2, 2))])
def test_a_matrix_without_inverse_is_reported(fault):
    assert not invert(fault.copy(), np.empty_like(fault))


def test_worst_is_infinite_where_anything_is_no_number():
    assert largest_magnitude(np.array([0.1, -0.3])) == 0.3
    assert largest_magnitude(np.array([0.1, np.nan])) == np.inf
    assert largest_magnitude(np.array([-np.inf])) == np.inf


def running(bench, n1=0.8):
    x, _ = bench.rest(bench.point(n1=n1))
    fuel = bench.machine.fuel_unit_kgps
    air = intake(288.15, 101325.0, 0.0, bench.machine.recovery)
    return x, air, (bench.machine.path, Health()), fuel


@given(st.lists(st.floats(-0.25, 0.25), min_size=5, max_size=5))
def test_the_positions_found_do_not_depend_on_the_start(bench, offset):
    x, air, engine, unit = running(bench)
    run = Running(0.8, x[5], unit * x[6], 0.0, 0.0, 0.0, 0.0)
    start = x[:5] + np.array(offset)
    _, good = solve(engine, air, run, start, np.zeros((5, 5)))
    assert good
    assert start == pytest.approx(x[:5], rel=1e-7, abs=1e-8)


def test_an_old_jacobian_gives_the_same_solution(bench):
    x, air, engine, unit = running(bench)
    run = Running(0.8, x[5], unit * x[6], 0.0, 0.0, 0.0, 0.0)
    inverse, kept, fresh = np.zeros((5, 5)), x[:5].copy(), x[:5].copy()
    solve(engine, air, run, kept, inverse)
    after = run._replace(fuel_kgps=1.08 * run.fuel_kgps, n2=run.n2 * 1.01)
    assert solve(engine, air, after, kept, inverse)[1]
    assert solve(engine, air, after, fresh, np.zeros((5, 5)))[1]
    assert kept == pytest.approx(fresh, rel=1e-7)


def test_a_solution_fulfils_its_balances_and_is_left_alone(bench):
    x, air, engine, unit = running(bench)
    asked = Running(0.8, 1.0, unit, 0.0, 0.0, 0.0, 0.0)
    residual = np.empty(7)
    balances(engine, air, asked, x, residual)
    assert largest_magnitude(residual) < TOLERANCE
    again = x.copy()
    assert solve(engine, air, asked, again, np.zeros((7, 7)))[1]
    assert np.array_equal(again, x)


def test_what_has_no_solution_is_not_said_to_have_one(bench):
    x, air, engine, unit = running(bench)
    run = Running(0.8, 0.05, unit * 3.0, 0.6, 0.0, 0.0, 0.0)
    assert not solve(engine, air, run, x[:5].copy(), np.zeros((5, 5)))[1]
