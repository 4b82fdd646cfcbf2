"""Output error for discrete linear systems: recovered systems and what is refused."""

import numpy as np
import pytest

from narxcal.record import Record
from narxcal.transfer.state_space import StateSpace
from training.linear_output_error import polish

TRUE = StateSpace(
    np.array([[0.95, 0.1], [-0.1, 0.9]]),
    np.array([[0.1], [0.3]]),
    np.array([[1.0, 0.5], [0.0, 1.0]]),
    np.array([[0.2], [0.0]]),
    1.0,
)
NEAR = StateSpace(TRUE.A * 0.97, TRUE.B * 1.2, TRUE.C * 0.9, TRUE.D, 1.0)


def records(sd=0.05, points=800):
    rng = np.random.default_rng(0)
    found = []
    for number in range(2):
        u = rng.normal(size=(points, 1)).cumsum(axis=0) * 0.1
        y = TRUE.simulate(u, rng.normal(size=2))
        found.append(Record(u, y + sd * rng.normal(size=y.shape), f"record {number}"))
    return found


def test_a_system_comes_back_in_any_coordinates_with_the_states_of_each_record():
    found = polish(NEAR, records(0.0))
    np.testing.assert_allclose(np.sort(found.system.poles), np.sort(TRUE.poles), atol=1e-5)
    for record in records(0.0):
        simulated = found.system.simulate(record.u, found.x0[record.name])
        np.testing.assert_allclose(simulated, record.y, atol=1e-4)


def test_noise_is_estimated_and_the_free_coordinates_are_not_counted():
    found = polish(NEAR, records()).fit
    assert found.status == "unidentifiable"
    assert len(found.unidentifiable) == 4  # n^2 changes of coordinates
    np.testing.assert_allclose(list(found.sigma.values()), 0.05, rtol=0.05)
    entries, states, noises = 12, 4, 2
    count = entries + states + noises - 4
    assert found.aic == pytest.approx(2.0 * (found.cost + count))


def test_feedthrough_can_be_kept():
    found = polish(NEAR, records(), [0.05, 0.05], feedthrough=False)
    np.testing.assert_array_equal(found.system.D, NEAR.D)


def test_poles_of_a_second_order_plant_under_40_db_of_noise():
    quiet = records(0.0)[0].y
    found = polish(NEAR, records(0.01 * quiet.std()))
    error = np.abs(np.sort(found.system.poles) - np.sort(TRUE.poles)) / np.abs(TRUE.poles)
    assert error.max() < 0.01
