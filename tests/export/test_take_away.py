"""What docs/take_away.md shows runs as it stands there."""

import json
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from narxcal.export.fmu import write_fmu
from narxcal.export.jsbsim import Turbine
from narxcal.export.onnx_model import write_onnx
from narxcal.export.program import Program
from narxcal.export.proof import Case
from tests.export import models

PAGE = (Path(__file__).parents[2] / "docs/take_away.md").read_text("utf-8")


def section(title):
    """A section of the page, and the text of its examples."""
    (text,) = re.findall(rf"^## {title}\n(.*?)(?=^## |\Z)", PAGE, re.MULTILINE | re.DOTALL)
    return text, re.findall(r"^```\w*\n(.*?)^```", text, re.MULTILINE | re.DOTALL)


def test_the_program_in_c_builds_by_the_command_of_the_page(tmp_path):
    if shutil.which("cc") is None:
        pytest.skip("needs a C compiler")
    text, (main,) = section("C")
    model = Program(models.narx(models.table(), models.lags(governed=True)))
    for name, code in {**model.code, "main.c": main}.items():
        (tmp_path / name).write_text(code, "utf-8")
    (command,) = re.findall(r"^    (cc .*)$", text, re.MULTILINE)
    subprocess.run(command.split(), cwd=tmp_path, check=True)
    done = subprocess.run([tmp_path / "main"], capture_output=True, text=True, check=True)
    inside, value = done.stdout.split()
    assert inside == "0"
    assert 0.0 < float(value) < 120.0


def test_the_host_in_python_flies_the_fmu(tmp_path, monkeypatch, capsys):
    pytest.importorskip("fmpy", reason="needs the extra fmu", exc_type=ImportError)
    _, (host,) = section("A Python host by FMPy")
    write_fmu(Program(models.KINDS["narx behind limited lags"]()), tmp_path / "engine.fmu")
    monkeypatch.chdir(tmp_path)
    exec(compile(host, "take_away.md", "exec"), {})  # noqa: S102
    shown = capsys.readouterr().out.splitlines()[-1]
    first, last = map(float, shown.strip("[]").split())
    assert last > first + 5.0


def test_the_graph_is_stepped_by_onnxruntime(tmp_path, monkeypatch, capsys):
    pytest.importorskip("onnx", reason="needs the extra export")
    pytest.importorskip("onnxruntime", reason="needs onnxruntime")
    _, (host,) = section("ONNX")
    write_onnx(Program(models.KINDS["narx behind limited lags"]()), tmp_path / "engine.onnx")
    monkeypatch.chdir(tmp_path)
    exec(compile(host, "take_away.md", "exec"), {})  # noqa: S102
    speeds = [float(line.strip("[]").split()[0]) for line in capsys.readouterr().out.splitlines()]
    assert speeds[0] < speeds[1] < speeds[3]


def test_the_run_answers_next_to_jsbsims_turbine(tmp_path, monkeypatch, capsys):
    pytest.importorskip("fmpy", reason="needs the extra fmu", exc_type=ImportError)
    pytest.importorskip("jsbsim", reason="needs jsbsim")
    _, (example,) = section("JSBSim")
    program, inputs = Program(models.KINDS["narx behind limited lags"]()), models.log(120)
    write_fmu(program, tmp_path / "engine.fmu")
    turbine = Turbine.of(program.model, program.envelope, [Case("moves", "", inputs)])
    (tmp_path / "engine.xml").write_bytes(turbine.xml(program.about))
    proofs = {"proofs": {"engine.xml": {"throttle": turbine.to_json()}}}
    (tmp_path / "proof.json").write_text(json.dumps(proofs), "utf-8")
    pd.DataFrame(inputs, columns=models.INPUTS).to_csv(tmp_path / "flight.csv", index=False)
    monkeypatch.chdir(tmp_path)
    exec(compile(example, "take_away.md", "exec"), {})  # noqa: S102
    shown = capsys.readouterr().out.replace("[", " ").replace("]", " ").split()
    theirs, ours = np.array(shown, dtype=float).reshape(2, 2)
    np.testing.assert_allclose(ours, program.model.simulate(inputs)[-1, :2], atol=0.06)
    assert (theirs >= 0.0).all()
