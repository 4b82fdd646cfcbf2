"""`narxcal export RUN`: files, proof, and what it refuses."""

import json
import shutil

import pytest

from narxcal.support.errors import DataError

needs_a_compiler = pytest.mark.skipif(shutil.which("cc") is None, reason="needs a C compiler")


@pytest.fixture(scope="module")
def run(project):
    return project / "run"


@needs_a_compiler
def test_a_run_becomes_c_that_is_proven_over_its_held_out_logs(narxcal, run, tmp_path):
    done = narxcal("export", run, "--to", "c", "--out", tmp_path / "c")
    assert (done.code, done.err) == (0, "")
    assert "Largest difference from simulate" in done.out
    assert sorted(file.name for file in (tmp_path / "c").iterdir()) == [
        "engine.c", "engine.h", "proof.json",
    ]  # fmt: skip
    document = json.loads((tmp_path / "c/proof.json").read_text("utf-8"))
    assert document["schema"] == "narxcal.proof/1"
    proof = document["proofs"]["engine.c"]
    assert proof["ok"]
    assert proof["largest"] <= proof["bound"] == 1e-9
    assert {row["what"] for row in proof["rows"]} == {
        "free run", "restart in mid-flight", "start at other outputs",
    }  # fmt: skip
    logs = {row["log"] for row in proof["rows"]}
    assert logs == {"drawn: outside the envelope, with holes", "flight_3.csv"}
    done = narxcal("export", run, "--to", "c", "--out", tmp_path / "c", "--overwrite", "--json")
    assert json.loads(done.out)["largest"] == proof["largest"]


@needs_a_compiler
def test_a_difference_above_the_bound_ends_with_one(narxcal, run, tmp_path, monkeypatch):
    monkeypatch.setattr("narxcal.export.proof.BOUND", 1e-300)
    done = narxcal("export", run, "--to", "c", "--out", tmp_path / "c", "--quiet")
    assert done.code == 1
    assert done.err.startswith("narxcal: warning: the largest difference, ")
    assert done.err.endswith(", is above 1e-300\n")


def test_without_a_compiler_there_are_the_sources_alone(narxcal, run, tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    done = narxcal("export", run, "--to", "c", "--out", tmp_path / "c", "--quiet")
    assert (done.code, done.err) == (
        0,
        "narxcal: warning: there is no C compiler 'cc' on the PATH: sources alone, and no proof\n",
    )
    proof = json.loads((tmp_path / "c/proof.json").read_text("utf-8"))["proofs"]["engine.c"]
    assert proof == {"file": "engine.c", "rows": []}


@needs_a_compiler
def test_without_the_runs_logs_the_proof_is_over_drawn_inputs_and_says_so(
    narxcal, run, tmp_path, monkeypatch
):
    def gone(*_):
        raise DataError("the folder does not exist", file="flights")

    monkeypatch.setattr("narxcal.cli.export.evaluation_logs", gone)
    out = tmp_path / "c"
    done = narxcal("export", run, "--to", "c", "--out", out, "--quiet")
    assert (done.code, done.err) == (
        0,
        (
            "narxcal: warning: the proof is over drawn inputs alone, without the run's logs: "
            "flights: the folder does not exist\n"
        ),
    )
    document = json.loads((out / "proof.json").read_text("utf-8"))
    logs = {row["log"] for row in document["proofs"]["engine.c"]["rows"]}
    assert logs == {"drawn: outside the envelope, with holes"}


def test_a_folder_with_content_and_an_unknown_engine_are_refused(narxcal, run, tmp_path):
    (tmp_path / "c").mkdir()
    (tmp_path / "c/mine.txt").write_text("mine", "utf-8")
    done = narxcal("export", run, "--to", "c", "--out", tmp_path / "c")
    assert (done.code, done.out) == (2, "")
    assert "exists and is not empty" in done.err
    done = narxcal("export", run, "--to", "c", "--out", tmp_path / "d", "--engine", "port")
    assert (done.code, done.out, done.err) == (
        2,
        "",
        "narxcal: error: the run has no model of an engine 'port'. Leave --engine out\n",
    )
    assert not (tmp_path / "d").exists()


@pytest.mark.slow
@needs_a_compiler
def test_a_run_becomes_an_fmu_and_the_proofs_of_a_folder_stand_side_by_side(narxcal, run, tmp_path):
    pytest.importorskip("fmpy", reason="needs the extra fmu", exc_type=ImportError)
    for version in ("2.0", "3.0"):
        out = tmp_path / f"engine{version[0]}.fmu"
        done = narxcal("export", run, "--to", "fmu", "--fmi", version, "--out", out)
        assert (done.code, done.err) == (0, "")
        assert "state stored and set" in done.out
    proofs = json.loads((tmp_path / "proof.json").read_text("utf-8"))["proofs"]
    assert sorted(proofs) == ["engine2.fmu", "engine3.fmu"]
    assert all(proof["ok"] for proof in proofs.values())
    done = narxcal("export", run, "--to", "fmu", "--out", tmp_path / "engine2.fmu")
    assert (done.code, "exists. Add --overwrite" in done.err) == (2, True)


def test_a_proof_of_somebody_else_is_not_written_over(narxcal, run, tmp_path):
    (tmp_path / "proof.json").write_text("{}", "utf-8")
    done = narxcal("export", run, "--to", "fmu", "--out", tmp_path / "engine.fmu")
    assert (done.code, done.err) == (
        2,
        (
            f"narxcal: error: {tmp_path}/proof.json: the file is no proof of an export. "
            "Choose another folder\n"
        ),
    )
    assert not (tmp_path / "engine.fmu").exists()


def test_c_is_for_runs(narxcal, tmp_path):
    done = narxcal("export", "business_jet", "--to", "c", "--out", tmp_path / "c")
    assert (done.code, done.err) == (
        2,
        (
            "narxcal: error: --to c takes a run folder, and SOURCE is business_jet. "
            "Train one, or export a table or an FMU\n"
        ),
    )


@pytest.mark.slow
def test_a_run_becomes_a_graph(narxcal, run, tmp_path):
    pytest.importorskip("onnx", reason="needs the extra export")
    pytest.importorskip("onnxruntime", reason="needs onnxruntime")
    done = narxcal("export", run, "--to", "onnx", "--out", tmp_path / "engine.onnx", "--json")
    assert (done.code, done.err) == (0, "")
    document = json.loads(done.out)
    assert document["bound"] == 1e-5
    assert document["largest"] < 1e-9
    done = narxcal("export", run, "--to", "onnx", "--out", tmp_path / "engine.fmu")
    assert (done.code, done.err) == (
        2,
        (
            "narxcal: error: --to onnx writes a .onnx file, and --out names engine.fmu. "
            "Name it engine.onnx\n"
        ),
    )


@pytest.mark.slow
def test_a_run_becomes_jsbsims_turbine_and_what_that_cannot_hold_is_said(narxcal, run, tmp_path):
    pytest.importorskip("jsbsim", reason="needs jsbsim")
    done = narxcal("export", run, "--to", "jsbsim", "--out", tmp_path / "engine.xml")
    assert (done.code, done.err) == (0, "")
    assert "What the form of JSBSim's turbine does not hold, %" in done.out
    proof = json.loads((tmp_path / "proof.json").read_text("utf-8"))["proofs"]["engine.xml"]
    assert proof["largest"] < proof["bound"]
    assert set(proof["misfit"]) == {"largest", "t90_s", "rms"}
    assert proof["throttle"]["driver"] == "TRA_deg"
