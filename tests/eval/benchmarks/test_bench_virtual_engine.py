"""The virtual engine's figures: rows that keep their targets, and the table of its page."""

import re
from pathlib import Path

import pytest

from eval.benchmarks import virtual_engine
from narxcal.turbofan import VirtualEngine

PAGE = Path(__file__).parents[3] / "docs" / "virtual_engine.md"


def test_what_has_to_hold_exactly_holds():
    rows = {row.name: row for row in virtual_engine.rows(duration_s=20.0, points=100)}
    for name in ("business_jet", "single_aisle"):
        assert rows[f"{name}, slam to 95 % thrust"].reached
        assert rows[f"{name}, settled points without solution"].value == 0.0
        assert rows[f"{name}, simulated"].value > 0.0


@pytest.fixture(scope="module")
def figures():
    return virtual_engine.figures()


def test_the_page_shows_the_table_that_the_command_prints(figures):
    """To a percent, since numerical libraries of another version may change last digits."""
    number = re.compile(r"-?\d+(?:\.\d+)?(?:e-?\d+)?$")
    page = {
        tuple(line.split(" | ")[:4]): line.rstrip(" |").split(" | ")[4:]
        for line in PAGE.read_text("utf-8").splitlines()
        if line.startswith("| ") and line.count("|") == 7
    }
    lines = virtual_engine.markdown(figures).splitlines()[2:]
    assert len(lines) == len(figures) > 30
    seen = set()
    for line in lines:
        cells = line.rstrip(" |").split(" | ")
        seen.add(tuple(cells[:4]))
        if lines.count(line) == 1 and sum(x.startswith(" | ".join(cells[:4])) for x in lines) == 1:
            for ours, shown in zip(cells[4:], page[tuple(cells[:4])], strict=True):
                assert number.match(ours)
                assert float(shown) == pytest.approx(float(ours), rel=0.02, abs=0.01)
    assert seen <= set(page)


def test_similar_points_have_similar_lags(figures):
    row = next(row for row in figures if "similarity" in row.name)
    assert row.ours == pytest.approx((1.0, 1.0), abs=0.06)


def test_points_of_equal_thrust_have_it():
    engine = VirtualEngine("business_jet")
    u = virtual_engine.at_thrust(engine, (20000.0, 0.5), (0.3, 1.0))
    thrust = engine.outputs(u)[:, 4]
    assert thrust[0] / thrust[1] == pytest.approx(0.3, abs=1e-3)
