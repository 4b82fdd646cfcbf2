"""The virtual engine's figures: rows that keep their targets, and their table."""

import numpy as np
import pytest

from eval.benchmarks import virtual_engine
from narxcal.turbofan import VirtualEngine


def test_what_has_to_hold_exactly_holds():
    rows = {row.name: row for row in virtual_engine.rows(duration_s=20.0, points=100)}
    for name in ("business_jet", "single_aisle"):
        assert rows[f"{name}, slam to 95 % thrust"].reached
        assert rows[f"{name}, settled points without solution"].value == 0.0
        assert rows[f"{name}, simulated"].value > 0.0


@pytest.fixture(scope="module")
def figures():
    return virtual_engine.figures()


def test_the_table_has_a_finite_figure_of_each_engine(figures):
    assert all(np.isfinite(row.ours).all() for row in figures)
    lines = virtual_engine.markdown(figures).splitlines()
    assert len(lines) == 2 + len(figures) > 30
    assert {line.count("|") for line in lines} == {7}


def test_similar_points_have_similar_lags(figures):
    row = next(row for row in figures if "similarity" in row.name)
    assert row.ours == pytest.approx((1.0, 1.0), abs=0.06)


def test_points_of_equal_thrust_have_it():
    engine = VirtualEngine("business_jet")
    u = virtual_engine.at_thrust(engine, (20000.0, 0.5), (0.3, 1.0))
    thrust = engine.outputs(u)[:, 4]
    assert thrust[0] / thrust[1] == pytest.approx(0.3, abs=1e-3)
