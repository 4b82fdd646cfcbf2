"""Steady states: found all over the envelope, and named where there is none."""

import numpy as np
import pytest

from narxcal.turbofan.engine import HIGH, LOW
from narxcal.turbofan.lever import n1_command
from narxcal.turbofan.solve import N1, UNKNOWN, Line, running_line, steady_points

SURGE = 0.5 * np.pi


def drawn(count, seed=0):
    """Inputs all over the envelope, a third of them at the idle stop."""
    random = np.random.default_rng(seed)
    u = random.uniform(LOW, HIGH, (count, 9))
    u[random.random(count) < 0.3, 0] = 0.0
    u[:, 4:] = random.integers(0, 2, (count, 5))
    u[:, 4] *= (u[:, 2] < 0.3) & (u[:, 1] < 12000.0)  # wheels on the ground
    return u


def test_thousands_of_points_of_the_envelope_converge_short_of_surge(bench):
    u = drawn(3000)
    conditions = bench.engine._conditions(u, n1_command(bench.engine.settings.ratings, u))
    unknowns, rows, good = steady_points(bench.machine, bench.line, conditions)
    assert good.all(), u[~good][:3]
    assert np.isfinite(rows).all()
    assert unknowns[:, :3].max() < SURGE


def test_a_point_gives_the_same_alone_and_among_others(bench):
    u = drawn(50, seed=1)
    conditions = bench.engine._conditions(u, n1_command(bench.engine.settings.ratings, u))
    together = steady_points(bench.machine, bench.line, conditions)[0]
    alone = [steady_points(bench.machine, bench.line, c[np.newaxis])[0][0] for c in conditions]
    assert np.array_equal(together, np.array(alone))


def test_a_poor_start_reaches_the_same_point_by_walking_there(bench):
    point = bench.point(30000.0, 0.7, 10.0, 0.9, bleed=0.05, offtake_W=2e4)
    line = bench.line
    far_off = Line(line.n1[-3:], line.unknowns[:, -3:].copy(), line.inverses[-3:])
    x, _, good = steady_points(bench.machine, far_off, point.condition()[np.newaxis])
    assert good[0]
    assert x[0] == pytest.approx(bench.rest(point)[0], rel=1e-8)


def test_neither_the_stored_jacobians_nor_learning_move_a_point(bench):
    u = drawn(200, seed=2)
    conditions = bench.engine._conditions(u, n1_command(bench.engine.settings.ratings, u))
    blank = bench.line._replace(inverses=np.zeros_like(bench.line.inverses))
    found = steady_points(bench.machine, bench.line, conditions)[0]
    anew = steady_points(bench.machine, blank, conditions)[0]
    np.testing.assert_allclose(found, anew, rtol=1e-7, atol=1e-8)


def test_an_impossible_point_is_reported_and_spoils_no_other(bench):
    possible, impossible = bench.point().condition(), bench.point(bleed=0.95).condition()
    _, _, good = steady_points(
        bench.machine, bench.line, np.array([possible, impossible, possible])
    )
    assert good.tolist() == [True, False, True]


def test_the_running_line_passes_through_the_steady_points(bench):
    assert np.all(np.diff(bench.line.n1) > 0.0)
    assert bench.line.n1[0] < 0.2
    for k in (0, 20, len(bench.line.n1) - 1):
        x, _ = bench.rest(bench.point(n1=float(bench.line.n1[k])))
        assert x == pytest.approx(bench.line.unknowns[:, k], rel=1e-8, abs=1e-9)


def test_a_line_ends_above_the_first_speed_without_solution(bench):
    top = np.array([*bench.core.closed.positions, 1.0, 1.0])
    line = running_line(bench.machine, np.array([-0.5, 0.9, 0.95, 1.0]), top)
    assert line.n1.tolist() == [0.9, 0.95, 1.0]
    assert line.unknowns.shape == (UNKNOWN, 3)
    assert bench.point().condition()[N1] == 1.0
