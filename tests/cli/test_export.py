"""`narxcal export`: what it takes, what it says, and how it ends."""

import json
import re
import shutil
import sys

import numpy as np
import pytest

from narxcal.calibration.bundle import load_bundle
from narxcal.steady.fmu import SteadyFmu
from narxcal.steady.table import read_steady_table
from narxcal.turbofan import maker_model
from narxcal.turbofan.engine import INPUT_NAMES

MAKER = "narxcal.turbofan:maker_model"
# Two inputs are enough for most of what is tested here.
FIXED = ("--nodes", "Mach=0.3", "dT_C=0", *(f"{name}=0" for name in INPUT_NAMES[4:]))


def test_a_function_becomes_a_table_with_its_errors_told(narxcal, tmp_path):
    out = tmp_path / "deck.csv"
    done = narxcal("export", MAKER, "--to", "table", "--out", out, *FIXED)
    assert (done.code, done.err) == (0, "")
    assert "Interpolation error at 4096 random conditions" in done.out
    assert "the tolerance is met" in done.out
    assert "WAI is fixed at 0 and left out" in done.out
    assert f"Exported: {out}" in done.out
    assert max(len(line) for line in done.out.splitlines() if "/" not in line) <= 80
    deck = read_steady_table(out)
    assert deck.input_names == ("TRA_deg", "ALT_ft")
    assert deck.output_names == ("N1_pct", "N2_pct", "EGT_C")
    at = [33.0, 12_345.0]
    expected = maker_model([*at, 0.3, *[0.0] * 6])
    np.testing.assert_allclose(deck.outputs(at), expected, rtol=0.01)
    assert out.read_text("utf-8").startswith(f"# Steady-state engine model {MAKER}, sampled")


def test_json_is_one_document_with_the_same_numbers(narxcal, tmp_path):
    out = tmp_path / "deck.csv.gz"
    done = narxcal("export", MAKER, "--to", "table", "--out", out, *FIXED, "--json")
    document = json.loads(done.out)
    assert document["schema"] == "narxcal.export/1"
    assert document["met"] is True
    assert document["bytes"] == out.stat().st_size
    assert document["rows"] == len(read_steady_table(out).points)
    assert document["axes"]["TRA_deg"][0] == 0.0
    assert document["fixed"]["Mach"] == 0.3
    worst = max(output["max_pct"] for output in document["outputs"])
    assert 0.0 < worst <= document["tolerance_pct"] == 0.5


def test_a_missed_tolerance_warns_and_ends_with_one_or_writes_nothing(narxcal, tmp_path):
    out = tmp_path / "deck.csv"
    tight = ("export", MAKER, "--to", "table", "--out", out, *FIXED, "--tolerance", "0.001")
    done = narxcal(*tight, "--max-rows", "50", "--quiet")
    assert (done.code, done.out) == (1, "")
    assert re.match(
        r"narxcal: warning: the largest error, \S+ % of the range, is above the tolerance of "
        r"0\.001 %: the limit of rows was reached\. Allow a larger tolerance",
        done.err,
    )
    assert out.exists()
    out.unlink()
    done = narxcal(*tight, "--max-rows", "50", "--strict")
    assert done.code == 2
    assert "the error reaches" in done.err
    assert list(tmp_path.iterdir()) == []


def test_nodes_are_kept_and_nothing_is_added_without_refinement(narxcal, tmp_path):
    nodes = ("TRA_deg=0,20,85", "ALT_ft=0:40000:3", "--no-refine", "--json")
    done = narxcal("export", MAKER, "--to", "table", "--out", tmp_path / "d.csv", *FIXED, *nodes)
    document = json.loads(done.out)
    assert document["axes"] == {"TRA_deg": [0, 20, 85], "ALT_ft": [0, 20000, 40000]}
    assert document["stopped"] == "nodes"
    assert done.code == 1


def needs_a_compiler():
    pytest.importorskip("fmpy", reason="needs the extra fmu", exc_type=ImportError)
    if shutil.which("cc") is None or not sys.platform.startswith("linux"):
        pytest.skip("needs a C compiler, on Linux")


def test_a_table_becomes_an_fmu_and_the_fmu_a_table(narxcal, tmp_path):
    needs_a_compiler()
    table, fmu, back = (tmp_path / name for name in ("deck.csv", "deck.fmu", "back.csv"))
    assert narxcal("export", MAKER, "--to", "table", "--out", table, *FIXED).code == 0
    done = narxcal("export", table, "--to", "fmu", "--fmi", "3.0", "--out", fmu)
    assert (done.code, done.err) == (0, "")
    names = (("TRA_deg", "ALT_ft"), ("N1_pct", "EGT_C"))
    deck, unit = read_steady_table(table, *names), SteadyFmu(fmu, names)
    inputs = np.random.default_rng(0).uniform([0, 0], [85, 43000], (100, 2))
    np.testing.assert_allclose(unit.outputs(inputs), deck.outputs(inputs), rtol=1e-12)
    named = ("--inputs", *names[0], "--outputs", *names[1])
    given = ("--nodes", "TRA_deg=0,40,85", "ALT_ft=0,43000", "--no-refine")
    narxcal("export", fmu, "--to", "table", "--out", back, *named, *given, "--quiet")
    again = read_steady_table(back)
    np.testing.assert_allclose(again.values, deck.outputs(again.points), rtol=1e-8)


def test_switches_that_add_up_are_named(narxcal, tmp_path, monkeypatch):
    needs_a_compiler()
    (tmp_path / "sums.py").write_text(MODULES["sums"], "utf-8")
    monkeypatch.chdir(tmp_path)
    nodes = ("--nodes", "ALT_ft=0", "Mach=0", "dT_C=0", "WOW=0", "Approach=0")
    done = narxcal("export", "sums:deck", "--to", "fmu", "--out", tmp_path / "deck.fmu", *nodes)
    assert done.code == 0
    assert "Switches on grids of their own: ECS, NAI, WAI" in done.out


def test_a_run_folder_gives_its_steady_state_model(project, narxcal, tmp_path):
    out = tmp_path / "deck.csv"
    nodes = [node for node in FIXED if node[:3] not in {"ECS", "NAI", "WAI"}]
    done = narxcal("export", project / "run", "--to", "table", "--out", out, *nodes)
    assert done.code == 0
    steady = load_bundle(project / "run").calibration.steady
    at = [60.0, 5_000.0]
    expected = steady.outputs(np.array([*at, 0.3, *[0.0] * 3]))
    np.testing.assert_allclose(read_steady_table(out).outputs(at), expected, rtol=0.01)
    assert out.read_text("utf-8").startswith("# Steady-state engine model run, sampled")


def test_a_virtual_engine_is_exported_by_its_name(narxcal, tmp_path):
    out = tmp_path / "deck.csv"
    done = narxcal("export", "business_jet", "--to", "table", "--out", out, *FIXED, "ALT_ft=0")
    assert done.code == 0, done.err
    deck = read_steady_table(out)
    assert deck.output_names == ("N1_pct", "N2_pct", "EGT_C", "FF_kgph", "FN_kN", "FPR", "EPR")
    assert (np.diff(deck.values[:, 0]) > -1e-6).all()


MODULES = {
    "sums": (
        "import numpy as np\n"
        "def deck(u): return u[:, :1] ** np.array([1.1, 1.2, 1.3]) + u[:, 6:].sum(1)[:, None]\n"
    ),
    "wide": "import numpy as np\ndef deck(u): return np.ones((len(u), 9))\n",
    "broken": "def deck(u): raise ValueError('no such lever')\n",
    "two": "import numpy as np\ndef deck(u): return np.column_stack([u[:, 0], 300 + u[:, 0]])\n",
}


NAME_THEM = "Name its columns with --inputs and --outputs"
HOW_NODES = "Write NAME=VALUE, NAME=VALUE,VALUE,... or NAME=LOW:HIGH:COUNT"
REFUSED = {
    "airship": "'airship' is no run folder, table (.csv), FMU, module:function or virtual engine. "
    "Virtual engines are business_jet and single_aisle",
    "deck.fmu": "deck.fmu: an FMU does not say which of its variables to export. Name them with "
    "--inputs and --outputs",
    "deck.csv": "deck.csv: the table does not exist",
    "wide:deck": "steady-state model 'wide:deck' returned (1, 9), expected (1, 1). " + NAME_THEM,
    "broken:deck": "steady-state model 'broken:deck' failed on inputs (1, 9): no such lever. "
    + NAME_THEM,
    f"{MAKER} --nodes Mach=fast": f"cannot read the nodes 'Mach=fast'. {HOW_NODES}",
    f"{MAKER} --nodes Mach=0:1:1000000000": "the nodes 'Mach=0:1:1000000000' are more than the "
    "limit of 100000 rows. Give fewer nodes, or allow more rows by --max-rows",
    f"{MAKER} --nodes Mach=0:1:0": f"cannot read the nodes 'Mach=0:1:0'. {HOW_NODES}",
    f"{MAKER} --nodes Mahc=0": "unknown channel 'Mahc'. Did you mean 'Mach'?",
    f"{MAKER} --nodes FF_kgph=0": "'FF_kgph' is no input of the model. Inputs are "
    + ", ".join(INPUT_NAMES),
    f"{MAKER} --tolerance 0": "expected a tolerance above 0 and below 100 %, got 0",
}


@pytest.mark.parametrize("words", REFUSED)
def test_what_cannot_be_exported_is_said_in_one_line(narxcal, tmp_path, monkeypatch, words):
    for name, text in MODULES.items():
        (tmp_path / f"{name}.py").write_text(text, "utf-8")
    monkeypatch.chdir(tmp_path)
    source, *more = words.split()
    done = narxcal("export", source, "--to", "table", "--out", "out.csv", *more)
    assert (done.code, done.out, done.err) == (2, "", f"narxcal: error: {REFUSED[words]}\n")
    assert not (tmp_path / "out.csv").exists()


@pytest.mark.parametrize(
    ("kind", "name", "said"),
    [
        (
            "fmu",
            "deck.csv",
            "--to fmu writes a .fmu file, and --out names deck.csv. Name it deck.fmu",
        ),
        (
            "table",
            "deck.fmu",
            "--to table writes a .csv or .csv.gz file, and --out names deck.fmu. Name it deck.csv",
        ),
    ],
)
def test_a_file_is_not_given_the_name_of_another_kind(narxcal, tmp_path, kind, name, said):
    done = narxcal("export", MAKER, "--to", kind, "--out", tmp_path / name)
    assert (done.code, done.out, done.err) == (2, "", f"narxcal: error: {said}\n")
    assert list(tmp_path.iterdir()) == []


def test_columns_can_be_named(narxcal, tmp_path, monkeypatch):
    (tmp_path / "two.py").write_text(MODULES["two"], "utf-8")
    monkeypatch.chdir(tmp_path)
    names = ("--inputs", "TRA_deg", "--outputs", "N2_pct", "EGT_C")
    done = narxcal("export", "two:deck", "--to", "table", "--out", "out.csv", *names)
    assert done.code == 0
    assert read_steady_table("out.csv").output_names == ("N2_pct", "EGT_C")
