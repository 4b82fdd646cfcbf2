"""Where an export puts its nodes, and how far it takes a model to hold."""

import re
from itertools import combinations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from narxcal.export.grid import USUAL_RANGES, Grid, model_ranges
from narxcal.export.plan import best_nodes, candidates, grow
from narxcal.steady.function import SteadyCallable
from narxcal.steady.table import SteadyTable
from narxcal.support.errors import ConfigError, ModelError


def worst(x, values, chosen):
    """Slow twin: the error of straight lines between the chosen candidates."""
    lines = [np.interp(x, x[chosen], column[chosen]) for column in values.T]
    return np.abs(np.transpose(lines) - values).max()


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 10_000), asked=st.booleans())
def test_no_other_choice_of_nodes_is_better(seed, asked):
    rng = np.random.default_rng(seed)
    x = np.sort(rng.uniform(0, 10, 9))
    values = rng.normal(size=(9, 3)).cumsum(axis=0)
    must = [x[0], x[4], x[-1]] if asked else [x[0], x[-1]]
    found = best_nodes(x, values, must)
    for segments in range(found.fewest, 9):
        every = ((0, *inner, 8) for inner in combinations(range(1, 8), segments - 1))
        best = min(worst(x, values, list(way)) for way in every if not asked or 4 in way)
        nodes = found.nodes(segments)
        assert len(nodes) == segments + 1
        assert set(must) <= set(nodes)
        assert found.errors[segments] == pytest.approx(best, abs=1e-12)
        chosen = np.searchsorted(x, nodes)
        assert worst(x, values, chosen) == pytest.approx(best, abs=1e-12)


def test_a_parabola_gets_even_nodes_and_the_error_of_the_closed_form():
    x = np.linspace(0.0, 1.0, 65)
    found = best_nodes(x, (x**2)[:, None], [0.0, 1.0])
    np.testing.assert_array_equal(found.nodes(4), [0.0, 0.25, 0.5, 0.75, 1.0])
    assert found.errors[4] == pytest.approx(0.25**2 / 4)


def test_a_kink_gets_a_node():
    x = np.linspace(0.0, 1.0, 101)
    found = best_nodes(x, np.maximum(0.0, x - 0.37)[:, None], [0.0, 1.0])
    np.testing.assert_allclose(found.nodes(2), [0.0, 0.37, 1.0])
    assert found.errors[2] < 1e-12
    assert found.finer(2) is None or found.errors[found.finer(2)] < 1e-12


def axes(size=65):
    x = np.linspace(0.0, 1.0, size)
    return {
        "TRA_deg": best_nodes(x, (4 * x**2)[:, None], [0.0, 1.0]),
        "Mach": best_nodes(x, (x**2)[:, None], [0.0, 1.0]),
        "dT_C": best_nodes(x, x[:, None], [0.0, 1.0]),
    }


def test_the_axis_with_the_largest_error_is_refined_until_the_goal_is_met():
    plans = axes()
    segments, reason = grow(plans, others=4, goal=0.02, most=10_000)
    assert reason is None
    errors = {name: plans[name].errors[count] for name, count in segments.items()}
    assert sum(errors.values()) <= 0.02
    assert segments["dT_C"] == 1
    assert segments["TRA_deg"] == pytest.approx(2 * segments["Mach"], abs=1)


def test_a_goal_out_of_reach_says_whether_size_or_nodes_stood_in_the_way():
    segments, reason = grow(axes(), others=4, goal=1e-4, most=200)
    assert reason == "size"
    assert 4 * np.prod([count + 1 for count in segments.values()]) <= 200
    few = {"TRA_deg": best_nodes(np.array([0.0, 0.5, 1.0]), np.ones((3, 1)), [0.0, 1.0])}
    assert grow(few, others=1, goal=-1.0, most=200) == ({"TRA_deg": 1}, "nodes")


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


def test_an_envelope_is_found_by_asking_and_exactly():
    ranges = {"TRA_deg": (0.0, 78.25), "Mach": (0.1, 0.83)}
    model = SteadyCallable(lambda u: u, (("TRA_deg", "Mach"), ("N1_pct", "EGT_C")), ranges)
    assert model_ranges(model, {}) == ranges
    far = SteadyCallable(lambda u: u, (("dT_C",), ("EGT_C",)), {"dT_C": (50.0, 55.0)})
    assert model_ranges(far, {}) == {"dT_C": (50.0, 55.0)}


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


class Nowhere:
    input_names, output_names = ("Mach",), ("N1_pct",)

    def outputs(self, inputs):
        return np.asarray(inputs)

    def inside(self, inputs):
        return np.zeros(np.shape(inputs)[:-1], dtype=bool)


def test_nodes_that_fit_no_input_and_models_that_hold_nowhere_are_refused():
    message = "'WOW' is no input of the model. Inputs are Mach"
    with pytest.raises(ConfigError, match=f"^{re.escape(message)}$"):
        Grid.of_model(Nowhere(), {"WOW": [0.0]})
    message = (
        "the model is valid nowhere in the range searched. Give the ends of its inputs as nodes"
    )
    with pytest.raises(ModelError, match=f"^{re.escape(message)}$"):
        Grid.of_model(Nowhere())
