"""An exported table says of itself what is true, and is read back as it was written."""

import gzip
import re
import textwrap
from pathlib import Path

import numpy as np
import pytest

from narxcal.export import ExportOptions, Grid, export_table
from narxcal.export.grid import Block, GriddedModel
from narxcal.export.plan import additive_switches, layers, plan
from narxcal.steady.function import SteadyCallable
from narxcal.steady.table import SteadyTable, read_steady_table
from narxcal.support.errors import ConfigError, ModelError
from narxcal.turbofan.engine import INPUT_NAMES

FIXED = {name: [0.0] for name in ("WOW", "Approach", "NAI", "WAI")}


def bent(inputs):
    """Bends in the lever only; the switch adds a constant."""
    lever, mach, ecs = inputs.T
    return np.column_stack([0.01 * lever**2 + 5 * mach, 300 + 4 * lever + 10 * ecs])


@pytest.fixture
def small():
    ranges = {"TRA_deg": (0.0, 80.0), "Mach": (0.0, 0.8), "ECS": (0.0, 1.0)}
    return SteadyCallable(bent, (("TRA_deg", "Mach", "ECS"), ("N1_pct", "EGT_C")), ranges)


def test_the_table_keeps_the_tolerance_where_nobody_looked(maker, tmp_path):
    grid = Grid.of_model(maker, FIXED)
    report = export_table(maker, grid, tmp_path / "deck.csv", ExportOptions(tolerance_pct=0.3))
    assert report.met
    assert report.stopped == "tolerance"
    deck = read_steady_table(tmp_path / "deck.csv")
    assert deck.gridded
    assert deck.input_names == ("TRA_deg", "ALT_ft", "Mach", "dT_C", "ECS")
    assert len(deck.points) == report.rows == np.prod([len(a) for a in report.axes.values()])
    drawn = grid.draw(2000, np.random.default_rng(99))
    kept = [INPUT_NAMES.index(name) for name in deck.input_names]
    off = np.abs(deck.outputs(drawn[:, kept]) - maker.outputs(drawn)).max(axis=0)
    for name, error, said in zip(deck.output_names, off, report.measured.outputs, strict=True):
        assert said.name == name
        assert error < 1.3 * said.max
        assert said.rms < said.max
        assert error / said.range < 0.0039


def test_nodes_go_where_the_model_bends_and_nowhere_else(small, tmp_path):
    report = export_table(small, Grid.of_model(small), tmp_path / "deck.csv")
    assert len(report.axes["TRA_deg"]) > 4
    assert report.axes["Mach"] == (0.0, 0.8)
    assert report.axes["ECS"] == (0.0, 1.0)
    # Worst error of a parabola between nodes h apart: 0.01 h^2 / 4.
    widest = np.diff(report.axes["TRA_deg"]).max()
    assert report.measured.outputs[0].max == pytest.approx(0.01 * widest**2 / 4, rel=0.02)
    assert report.measured.outputs[1].max < 1e-6


def test_a_table_is_written_again_with_the_same_bytes_and_packed_on_request(small, tmp_path):
    grid = Grid.of_model(small)
    for name in ("a.csv", "b.csv", "a.csv.gz", "b.csv.gz"):
        report = export_table(small, grid, tmp_path / name, ExportOptions(source="a\ndeck\x07"))
        assert report.bytes == (tmp_path / name).stat().st_size
    a, b, packed, again = ((tmp_path / f"{n}").read_bytes() for n in
                           ("a.csv", "b.csv", "a.csv.gz", "b.csv.gz"))  # fmt: skip
    assert a == b == gzip.decompress(packed)
    assert packed == again
    assert a.startswith(b"# Steady-state engine model a deck, sampled by narxcal")


def test_an_exported_table_is_exported_again_as_it_is(small, tmp_path):
    first = export_table(small, Grid.of_model(small), tmp_path / "deck.csv")
    deck = read_steady_table(tmp_path / "deck.csv")
    again = export_table(deck, Grid.of_model(deck), tmp_path / "again.csv")
    assert again.axes == first.axes
    assert again.measured.worst_pct == 0.0
    rows = [
        [line for line in (tmp_path / name).read_text("utf-8").splitlines() if line[0] != "#"]
        for name in ("deck.csv", "again.csv")
    ]
    assert rows[0] == rows[1]


def test_the_size_limit_stops_the_refinement_and_says_so(small, tmp_path):
    options = ExportOptions(tolerance_pct=0.001, max_rows=40)
    report = export_table(small, Grid.of_model(small), tmp_path / "deck.csv", options)
    assert (report.stopped, report.met) == ("size", False)
    assert report.rows <= 40
    assert report.why == "the limit of rows was reached"
    document = report.to_dict()
    assert document["met"] is False
    assert document["outputs"][0]["max_pct"] == report.measured.worst_pct
    assert document["axes"]["ECS"] == (0.0, 1.0)


def test_without_refinement_the_nodes_are_those_given(small, tmp_path):
    grid = Grid.of_model(small, {"TRA_deg": [0.0, 20.0, 80.0]})
    report = export_table(small, grid, tmp_path / "deck.csv", ExportOptions(refine=False))
    assert report.axes["TRA_deg"] == (0.0, 20.0, 80.0)
    assert (report.rows, report.stopped, report.met) == (12, "nodes", False)


def test_a_missed_tolerance_is_refused_where_that_was_asked_for(small, tmp_path):
    options = ExportOptions(tolerance_pct=0.001, max_rows=40, strict=True)
    message = (
        r"^channel N1_pct: the error reaches \S+ % of the range with 40 rows, above the "
        r"tolerance of 0\.001 %\. Allow a larger tolerance or more rows, give nodes where the "
        r"model bends, "
        r"or fix an input$"
    )
    with pytest.raises(ModelError, match=message):
        export_table(small, Grid.of_model(small), tmp_path / "deck.csv", options)
    assert list(tmp_path.iterdir()) == []


def test_a_grid_too_large_from_the_start_is_refused(small, tmp_path):
    grid = Grid.of_model(small, {"TRA_deg": np.linspace(0, 80, 50).tolist()})
    message = (
        "the given nodes make 200 rows, more than the limit of 100. "
        "Allow more rows, give fewer nodes, or fix an input at one node"
    )
    with pytest.raises(ModelError, match=f"^{re.escape(message)}$"):
        export_table(small, grid, tmp_path / "deck.csv", ExportOptions(max_rows=100))


def test_a_model_that_gives_no_number_is_named_with_its_condition(tmp_path):
    names = (("TRA_deg", "Mach"), ("N1_pct", "EGT_C"))
    ranges = {"TRA_deg": (0.0, 80.0), "Mach": (0.0, 0.8)}
    broken = SteadyCallable(
        lambda u: np.where(u[:, [0, 0]] > 79.9, [1.0, np.nan], 1.0), names, ranges
    )
    message = (
        r"^channel EGT_C: the model gives no number at TRA_deg 80, Mach 0\. "
        r"Choose nodes that leave such conditions out$"
    )
    with pytest.raises(ModelError, match=message):
        export_table(broken, Grid.of_model(broken), tmp_path / "deck.csv")


def test_nodes_outside_the_envelope_leave_nothing_to_compare(small, tmp_path):
    grid = Grid({**Grid.of_model(small).axes, "Mach": (0.9, 1.0)})
    message = "the model is valid nowhere between these nodes. Give nodes inside its envelope"
    with pytest.raises(ModelError, match=f"^{re.escape(message)}$"):
        export_table(small, grid, tmp_path / "deck.csv")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"tolerance_pct": 0.0}, "expected a tolerance above 0 and below 100 %, got 0"),
        ({"tolerance_pct": np.nan}, "expected a tolerance above 0 and below 100 %, got nan"),
        ({"max_rows": 0}, "max_rows has to be 1 or more, got 0"),
        ({"probes": 0}, "probes has to be 1 or more, got 0"),
    ],
)
def test_options_that_make_no_sense_are_refused(options, message):
    with pytest.raises(ConfigError, match=f"^{re.escape(message)}$"):
        ExportOptions(**options)


def test_a_file_that_cannot_be_written_is_an_error_that_names_it(small, tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(ConfigError, match="cannot write"):
        export_table(small, Grid.of_model(small), tmp_path / "file" / "deck.csv")


def test_an_output_that_never_varies_is_judged_by_its_size(tmp_path):
    ranges = {"TRA_deg": (0.0, 80.0)}
    flat = SteadyCallable(
        lambda u: np.column_stack([u[:, 0], np.full(len(u), 500.0)]),
        (("TRA_deg",), ("N1_pct", "EGT_C")),
        ranges,
    )
    report = export_table(flat, Grid.of_model(flat), tmp_path / "deck.csv")
    assert report.measured.outputs[1].range == 500.0
    assert report.met


# Sums of grids, as an FMU holds them.


def gated(inputs):
    """ECS merely adds; WOW and NAI act on each other."""
    lever, wow, ecs, nai = inputs.T
    return (lever**1.5 + 30 * wow * (1 - nai) + 5 * nai + 0.05 * lever * ecs)[:, None]


@pytest.fixture
def switches():
    names = ("TRA_deg", "WOW", "ECS", "NAI")
    return SteadyCallable(gated, (names, ("N1_pct",)), {"TRA_deg": (0.0, 80.0)})


def test_switches_that_add_up_are_told_from_those_that_do_not(switches):
    grid = Grid.of_model(switches)
    # One of two that act on each other can always be written as what it adds to the rest.
    assert additive_switches(switches, grid, np.array([700.0]), 1e-6) == ("ECS", "NAI")
    assert additive_switches(switches, grid, np.array([700.0]), 1.0) == ("WOW", "ECS", "NAI")


def test_a_sum_of_layers_is_the_model_where_switches_add_up(switches):
    grid = Grid.of_model(switches)
    points = grid.draw(200, np.random.default_rng(3))
    for additive in ((), ("ECS",), ("ECS", "NAI")):
        found = sum(
            part(points[:, [INDEX[name] for name in part.names]])
            for part in layers(switches, grid, additive)
        )
        np.testing.assert_allclose(found, gated(points), rtol=1e-12, atol=1e-9)


INDEX = {"TRA_deg": 0, "WOW": 1, "ECS": 2, "NAI": 3}


def test_one_block_is_the_table_with_the_same_nodes():
    rng = np.random.default_rng(4)
    lever, mach = np.array([0.0, 10.0, 30.0, 80.0]), np.array([0.0, 0.3, 0.8])
    values = rng.normal(size=(4, 3, 2))
    names = (("TRA_deg", "Mach"), ("N1_pct", "EGT_C"))
    one = GriddedModel(names, [Block((0, 1), (lever, mach), values)], np.ones((4, 3), bool))
    x, y = np.meshgrid(lever, mach, indexing="ij")
    points = np.column_stack([x.ravel(), y.ravel()])
    table = SteadyTable(names, points, values.reshape(-1, 2))
    inputs = rng.uniform([-10, -0.1], [90, 0.9], (300, 2))
    inputs[0] = np.nan
    np.testing.assert_allclose(one.outputs(inputs), table.outputs(inputs), rtol=1e-13)
    np.testing.assert_array_equal(one.inside(inputs), table.inside(inputs))


def test_a_cell_is_inside_only_where_the_model_holds_at_its_nodes():
    axis = np.array([0.0, 1.0, 2.0, 3.0])
    known = np.array([True, True, True, False])
    model = GriddedModel((("Mach",), ("N1_pct",)), [Block((0,), (axis,), axis[:, None])], known)
    at = np.array([[0.0], [1.9], [2.0], [2.1], [3.0], [-0.1], [np.nan]])
    assert model.inside(at).tolist() == [True, True, True, False, False, False, False]


def test_a_sum_needs_fewer_rows_for_the_same_error(maker):
    grid = Grid.of_model(maker, {"WOW": [0.0], "Approach": [0.0]})
    options = ExportOptions(tolerance_pct=0.4, max_rows=20_000)
    whole, summed = (plan(maker, grid, options, separate=flag) for flag in (False, True))
    assert summed.additive == ("ECS", "NAI", "WAI")
    assert whole.stopped == summed.stopped == "tolerance"
    assert summed.gridded.rows < 0.5 * whole.gridded.rows


def test_what_the_documentation_shows_works_as_shown(tmp_path, monkeypatch):
    page = (Path(__file__).parents[2] / "docs" / "steady_state.md").read_text("utf-8")
    table = re.search(r"((?:^    .*\n)+)", page, re.MULTILINE).group(1)
    (tmp_path / "deck.csv").write_text(textwrap.dedent(table), "utf-8")
    blocks = re.findall(r"```python\n(.*?)```", page, re.DOTALL)
    monkeypatch.chdir(tmp_path)
    names = {}
    exec(next(code for code in blocks if "export_table" in code), names)  # noqa: S102
    assert names["report"].met
    assert read_steady_table("copy.csv").outputs([78.0, 41000.0])[0] == pytest.approx(98.2)
