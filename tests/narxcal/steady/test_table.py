"""Interpolation of gridded and scattered tables, inside and outside their envelope."""

import gzip
import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from narxcal.steady.table import SteadyTable, read_steady_table
from narxcal.support.errors import ConfigError, DataError, ModelError

NAMES = (("TRA_deg", "ALT_ft"), ("N1_pct", "N2_pct"))


def grid(tra=(0.0, 20.0, 45.0, 78.0), alt=(0.0, 10000.0, 41000.0)):
    first, second = np.meshgrid(tra, alt, indexing="ij")
    return np.column_stack([first.ravel(), second.ravel()])


def plane(points):
    return np.column_stack([20 + points[:, 0] + 1e-4 * points[:, 1], 60 + 0.5 * points[:, 0]])


def scattered(rows=60):
    points = np.random.default_rng(5).uniform([0, 0], [78, 41000], (rows, 2))
    return SteadyTable(NAMES, points, plane(points)), points


@given(
    values=hnp.arrays(np.float64, (12, 2), elements=st.floats(-1e4, 1e4, width=32)),
    method=st.sampled_from(["linear", "pchip"]),
    seed=st.integers(0, 100),
)
def test_a_grid_is_exact_at_its_nodes_in_any_row_order(values, method, seed):
    order = np.random.default_rng(seed).permutation(12)
    points = grid()[order]
    table = SteadyTable(NAMES, points, values, method)
    assert table.gridded
    np.testing.assert_allclose(table.outputs(points), values, rtol=0, atol=1e-8)
    assert table.inside(points).all()


@given(
    steps=hnp.arrays(np.float64, (4, 3), elements=st.floats(0, 100, width=32)),
    method=st.sampled_from(["linear", "pchip"]),
    alt=st.floats(-5000, 60000),
)
def test_a_table_monotone_in_the_driver_stays_monotone_between_the_nodes(steps, method, alt):
    values = np.cumsum(steps, axis=0).reshape(12, 1)
    table = SteadyTable((NAMES[0], ("N1_pct",)), grid(), values, method)
    lever = np.linspace(-10, 90, 400)
    along = table.outputs(np.column_stack([lever, np.full(400, alt)]))[:, 0]
    assert (np.diff(along) >= -1e-9).all()


@given(inputs=hnp.arrays(np.float64, (6, 2), elements=st.floats(-1e7, 1e7)))
def test_outputs_never_leave_the_range_of_the_table(inputs):
    rng = np.random.default_rng(1)
    for points in (grid(), scattered()[1]):
        values = rng.uniform(0, 100, (len(points), 2))
        found = SteadyTable(NAMES, points, values).outputs(inputs)
        assert (found >= values.min(axis=0) - 1e-6).all()
        assert (found <= values.max(axis=0) + 1e-6).all()


def test_pchip_is_closer_than_linear_to_a_smooth_curve():
    lever = np.linspace(0, 60, 7)
    curve = 20 + 80 * np.sin(np.radians(lever))
    between = np.linspace(0, 60, 301)
    errors = {
        method: np.abs(
            SteadyTable((["TRA_deg"], ["N1_pct"]), lever[:, None], curve[:, None], method).outputs(
                between[:, None]
            )[:, 0]
            - (20 + 80 * np.sin(np.radians(between)))
        ).max()
        for method in ("linear", "pchip")
    }
    assert errors["pchip"] < 0.5 * errors["linear"]


def test_a_scattered_table_is_exact_at_its_points_and_on_a_plane():
    table, points = scattered()
    assert not table.gridded
    np.testing.assert_allclose(table.outputs(points), plane(points), atol=1e-8)
    weights = np.random.default_rng(2).dirichlet(np.ones(len(points)), 200)
    within = weights @ points
    assert table.inside(within).all()
    np.testing.assert_allclose(table.outputs(within), plane(within), atol=1e-6)


def test_outside_a_grid_the_nearest_conditions_of_the_box_answer():
    points = grid()
    table = SteadyTable(NAMES, points, plane(points))
    far = np.array([[100.0, -500.0], [40.0, 1e6]])
    near = np.array([[78.0, 0.0], [40.0, 41000.0]])
    assert not table.inside(far).any()
    np.testing.assert_allclose(table.outputs(far), table.outputs(near))


def test_outside_the_hull_scattered_tables_stay_continuous():
    table, _ = scattered()
    path = np.column_stack([np.linspace(-80, 160, 20001), np.full(20001, 20000.0)])
    held = table.inside(path)
    assert not held[0]
    assert not held[-1]
    assert held[10000]
    jumps = np.abs(np.diff(table.outputs(path)[:, 0]))
    assert jumps.max() < 0.1


def test_leading_axes_are_kept_and_nan_inputs_give_nan_outside():
    for table in (SteadyTable(NAMES, grid(), plane(grid())), scattered()[0]):
        inputs = np.full((2, 3, 2), 30.0)
        inputs[1, 2, 0] = np.nan
        found, held = table.outputs(inputs), table.inside(inputs)
        assert found.shape == (2, 3, 2)
        assert held.shape == (2, 3)
        assert np.isnan(found[1, 2]).all()
        assert np.isfinite(found[0]).all()
        assert not held[1, 2]
        assert table.outputs(inputs[0, 0]).shape == (2,)
        assert table.outputs(inputs[:0]).shape == (0, 3, 2)
        assert table.inside(inputs[:0]).shape == (0, 3)


def test_a_stored_table_gives_the_same_numbers():
    for table in (SteadyTable(NAMES, grid(), plane(grid()), "pchip"), scattered()[0]):
        back = SteadyTable.from_arrays(*table.to_arrays())
        probe = np.random.default_rng(3).uniform([-10, 0], [90, 50000], (50, 2))
        np.testing.assert_array_equal(back.outputs(probe), table.outputs(probe))
        np.testing.assert_array_equal(back.inside(probe), table.inside(probe))


def test_a_stored_table_without_its_values_is_refused():
    meta, arrays = scattered()[0].to_arrays()
    del arrays["values"]
    with pytest.raises(ModelError, match=r"^the stored steady-state table has no 'values'"):
        SteadyTable.from_arrays(meta, arrays)


@pytest.mark.parametrize(
    ("points", "values", "method", "error", "message"),
    [
        (
            [[0.0, 1.0]],
            [[1.0]],
            "linear",
            DataError,
            (
                "a table of 2 inputs and 2 outputs needs points (rows, 2) and values (rows, 2), "
                "got (1, 2) and (1, 1)"
            ),
        ),
        (
            grid(),
            plane(grid()),
            "cubic",
            ConfigError,
            "unknown table method 'cubic'. Use 'linear' or 'pchip'",
        ),
        (
            grid(),
            plane(grid()) * np.nan,
            "linear",
            DataError,
            "the table contains values that are not finite. Leave them out",
        ),
        (
            grid(alt=(0.0,)),
            plane(grid(alt=(0.0,))),
            "linear",
            DataError,
            (
                "channel ALT_ft: the table needs at least two values of each input. "
                "Leave an input out that does not vary"
            ),
        ),
        (
            np.vstack([grid(), grid()[:1]]),
            np.vstack([plane(grid()), plane(grid()[:1])]),
            "linear",
            DataError,
            "the table contains the same conditions twice. Keep one row each",
        ),
        (
            scattered()[1],
            plane(scattered()[1]),
            "pchip",
            ConfigError,
            (
                "method 'pchip' needs a full grid, and the table is scattered. "
                "Fill the grid, or use 'linear'"
            ),
        ),
        (
            np.column_stack([np.arange(5.0), np.arange(5.0)]),
            np.zeros((5, 2)),
            "linear",
            DataError,
            (
                "the 5 rows of the table do not span its 2 inputs. "
                "Add rows in which the inputs vary independently, or drop an input"
            ),
        ),
    ],
)
def test_points_that_are_no_table_are_refused(points, values, method, error, message):
    with pytest.raises(error, match=f"^{re.escape(message)}$"):
        SteadyTable(NAMES, points, values, method)


CSV = (
    "# maker's table, issue C\nTRA_deg,ALT_ft,N1_pct,FF_kgph\n0,0,20,100\n0,9000,25,80\n"
    "78,0,95,900\n78,9000,97,700\n"
)


def test_a_csv_is_read_by_the_role_of_its_columns(tmp_path):
    (tmp_path / "t.csv").write_text("\ufeff" + CSV, encoding="utf-8")
    table = read_steady_table(tmp_path / "t.csv")
    assert table.input_names == ("TRA_deg", "ALT_ft")
    assert table.output_names == ("N1_pct", "FF_kgph")
    np.testing.assert_allclose(table.outputs([39.0, 4500.0]), [59.25, 445.0])


@pytest.mark.parametrize(("delimiter", "mark"), [(";", ","), (";", "."), ("\t", ",")])
def test_a_table_of_a_worksheet_reads_as_any_other(tmp_path, delimiter, mark):
    plain = CSV.replace("97,", "97.25,")
    comment, rows = plain.split("\n", 1)
    sheet = rows.replace(",", delimiter).replace(".", mark)
    (tmp_path / "sheet.csv").write_text(f"{comment}\n{sheet}", encoding="utf-8")
    (tmp_path / "plain.csv").write_text(plain, encoding="utf-8")
    found, known = (read_steady_table(tmp_path / f"{name}.csv") for name in ("sheet", "plain"))
    np.testing.assert_array_equal(found.points, known.points)
    np.testing.assert_array_equal(found.values, known.values)


def test_fuel_flow_may_be_the_driver_and_other_columns_are_ignored(tmp_path):
    with gzip.open(tmp_path / "t.csv.gz", "wt", encoding="utf-8") as stream:
        stream.write("FF_kgph,remark,N1_pct,EGT_C\n100,idle,20,400\n900,max,95,650\n")
    table = read_steady_table(tmp_path / "t.csv.gz", ["FF_kgph"], ["N1_pct", "EGT_C"])
    np.testing.assert_allclose(table.outputs([[500.0]]), [[57.5, 525.0]])


@pytest.mark.parametrize(
    ("text", "names", "message"),
    [
        (
            CSV.replace("25,", "n/a,"),
            {},
            "FILE, channel N1_pct, row 4: expected a number, got 'n/a'",
        ),
        (CSV + "78\n", {}, "FILE, channel ALT_ft, row 7: expected a number, got ''"),
        (
            CSV,
            {"input_names": ["Mach"]},
            (
                "FILE, channel Mach: the table lacks this column. "
                "Columns found: TRA_deg, ALT_ft, N1_pct, FF_kgph"
            ),
        ),
        ("TRA_deg,N1_pct\n", {}, "FILE: the table has no rows"),
        (
            "TRA_deg,Mach\n1,2\n",
            {},
            (
                "FILE: the table needs input and output columns, got inputs ['TRA_deg', 'Mach'] "
                "and outputs []"
            ),
        ),
        (
            CSV.replace("9000", "0"),
            {},
            (
                "FILE, channel ALT_ft: the table needs at least two values of each input. "
                "Leave an input out that does not vary"
            ),
        ),
    ],
)
def test_a_bad_csv_is_refused_with_file_row_and_value(tmp_path, text, names, message):
    file = tmp_path / "t.csv"
    file.write_text(text, encoding="utf-8")
    with pytest.raises(DataError, match=f"^{re.escape(message.replace('FILE', str(file)))}$"):
        read_steady_table(file, **names)


def test_an_unknown_column_names_the_nearest_channel(tmp_path):
    file = tmp_path / "t.csv"
    file.write_text(CSV.replace("ALT_ft", "Alt_ft"), encoding="utf-8")
    message = "unknown channel 'Alt_ft'. Did you mean 'ALT_ft'?"
    with pytest.raises(ConfigError, match=f"^{re.escape(message)}$"):
        read_steady_table(file)


def test_a_missing_or_unreadable_file_is_named(tmp_path):
    with pytest.raises(DataError, match=r"none\.csv: the table does not exist$"):
        read_steady_table(tmp_path / "none.csv")
    (tmp_path / "bad.csv.gz").write_bytes(b"no gzip")
    with pytest.raises(DataError, match=r"bad\.csv\.gz: the table cannot be read: Not a gzipped"):
        read_steady_table(tmp_path / "bad.csv.gz")


def test_a_file_that_is_no_table_is_not_quoted(tmp_path):
    file = tmp_path / "secret.txt"
    file.write_text("password: hunter2\nname\n", encoding="utf-8")
    with pytest.raises(DataError, match="the file is no table of a steady-state model") as error:
        read_steady_table(file)
    assert "hunter2" not in str(error.value)


def test_a_small_archive_with_a_long_line_is_refused(tmp_path):
    file = tmp_path / "table.csv.gz"
    file.write_bytes(gzip.compress(b"TRA_deg,N1_pct\n" + b"1," * 5_000_000))
    with pytest.raises(DataError, match="a line of more than 100000 characters"):
        read_steady_table(file)
