"""Where an export puts its nodes, and how far it takes a model to hold."""

import re
from itertools import chain, combinations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from narxcal.export.grid import USUAL_RANGES, Grid
from narxcal.export.nodes import candidates, fewest_nodes, segment_errors
from narxcal.steady.function import SteadyCallable
from narxcal.steady.table import SteadyTable
from narxcal.support.errors import ConfigError


def worst(x, values, chosen):
    """Slow twin: the error of straight lines between the chosen candidates."""
    lines = [np.interp(x, x[chosen], column[chosen]) for column in values.T]
    return np.abs(np.transpose(lines) - values).max()


@given(seed=st.integers(0, 10_000), share=st.floats(0.01, 1.0))
def test_no_smaller_choice_of_nodes_is_as_good(seed, share):
    rng = np.random.default_rng(seed)
    x = np.sort(rng.uniform(0, 10, 9))
    values = rng.normal(size=(9, 3)).cumsum(axis=0)
    allowed = share * worst(x, values, [0, 8])
    nodes = fewest_nodes(x, segment_errors(x, values), allowed)
    rounding = 1e-12
    assert worst(x, values, np.searchsorted(x, nodes)) <= allowed + rounding
    fewer = chain.from_iterable(combinations(range(1, 8), n) for n in range(len(nodes) - 2))
    assert all(worst(x, values, [0, *inner, 8]) > allowed - rounding for inner in fewer)


def test_a_parabola_gets_the_nodes_of_the_closed_form():
    x = np.linspace(0.0, 1.0, 65)
    errors = segment_errors(x, (x**2)[:, None])
    nodes = fewest_nodes(x, errors, 0.25**2 / 4 + 1e-12)
    np.testing.assert_array_equal(nodes, [0.0, 0.25, 0.5, 0.75, 1.0])
    assert len(fewest_nodes(x, errors, 0.25**2 / 4 - 1e-6)) == 6


def test_a_kink_gets_a_node_and_so_does_what_has_to_be_one():
    x = np.linspace(0.0, 1.0, 101)
    errors = segment_errors(x, np.maximum(0.0, x - 0.37)[:, None])
    np.testing.assert_allclose(fewest_nodes(x, errors, 1e-9), [0.0, 0.37, 1.0])
    errors[:50, 51:] = np.inf
    np.testing.assert_allclose(fewest_nodes(x, errors, 1e-9), [0.0, 0.37, 0.5, 1.0])


@pytest.mark.parametrize("ends", [(0.0, 85.0), (-1000.0, 43000.0), (0.0, 0.8), (-0.013, 0.011)])
def test_candidates_are_the_nodes_asked_for_and_round_numbers(ends):
    low, high = ends
    middle = low + 0.4213 * (high - low)
    found = candidates((low, middle, high), 128)
    assert {low, middle, high} <= set(found)
    assert 50 < len(found) < 140
    assert all(len(f"{value:.9g}") <= 7 for value in found if value not in (low, middle, high))
    step = np.median(np.diff(found))
    assert np.diff(found).min() > 0.29 * step


def test_a_model_without_an_envelope_is_sampled_over_the_usual_ranges(maker):
    grid = Grid.of_model(maker, {"NAI": [0.0], "dT_C": [-10.0, 0.0, 10.0]})
    assert grid.axes["TRA_deg"] == USUAL_RANGES["TRA_deg"]
    assert grid.axes["dT_C"] == (-10.0, 0.0, 10.0)
    assert grid.axes["WAI"] == (0.0, 1.0)
    assert grid.fixed == {"NAI": 0.0}
    assert "NAI" not in grid.varying
    assert grid.rows == 2**7 * 3


def test_the_ends_are_those_of_the_envelope():
    ranges = {"TRA_deg": (0.0, 78.25), "Mach": (0.1, 0.83)}
    model = SteadyCallable(lambda u: u, (("TRA_deg", "Mach"), ("N1_pct", "EGT_C")), ranges)
    assert Grid.of_model(model).axes == ranges


def test_a_gridded_table_brings_its_own_nodes_and_scattered_points_their_box():
    names = (("TRA_deg", "Mach"), ("N1_pct",))
    x, y = np.meshgrid([0.0, 31.0, 78.0], [0.0, 0.8], indexing="ij")
    points = np.column_stack([x.ravel(), y.ravel()])
    table = SteadyTable(names, points, x.ravel()[:, None])
    assert Grid.of_model(table).axes == {"TRA_deg": (0.0, 31.0, 78.0), "Mach": (0.0, 0.8)}
    assert Grid.of_model(table, {"Mach": [0.4]}).fixed == {"Mach": 0.4}
    scattered = SteadyTable(names, points[:-1], x.ravel()[:-1, None])
    assert Grid.of_model(scattered).axes == {"TRA_deg": (0.0, 78.0), "Mach": (0.0, 0.8)}


def test_random_conditions_lie_between_the_nodes_and_switches_are_on_or_off():
    grid = Grid({"TRA_deg": (10.0, 20.0), "WOW": (0.0, 1.0), "Mach": (0.5,)})
    drawn = grid.draw(500, np.random.default_rng(0))
    assert drawn[:, 0].min() >= 10.0
    assert drawn[:, 0].max() <= 20.0
    assert set(drawn[:, 1]) == {0.0, 1.0}
    assert set(drawn[:, 2]) == {0.5}


@pytest.mark.parametrize(
    ("axes", "message"),
    [
        ({"Mach": ()}, "channel Mach: an axis needs at least one node, got none"),
        ({"Mach": (0.0, 0.5, 0.2)}, "channel Mach: nodes have to increase, got 0, 0.5, 0.2"),
        ({"Mach": (0.0, np.nan)}, "channel Mach: nodes have to increase, got 0, nan"),
        (
            {"Mach": (0.3,), "WOW": (1.0,)},
            (
                "every input is fixed, so nothing is left to tabulate. Give at least one input two "
                "nodes"
            ),
        ),
    ],
)
def test_a_grid_that_cannot_be_is_refused(axes, message):
    with pytest.raises(ConfigError, match=f"^{re.escape(message)}$"):
        Grid(axes)


def test_nodes_that_fit_no_input_are_refused(maker):
    message = "'FF_kgph' is no input of the model. Inputs are TRA_deg, "
    with pytest.raises(ConfigError, match=f"^{re.escape(message)}"):
        Grid.of_model(maker, {"FF_kgph": [0.0]})
