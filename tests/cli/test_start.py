"""How the command is started: as a module, and with one thread for the numerical libraries."""

import os
import subprocess
import sys

import pytest

from narxcal.cli.app import main


@pytest.mark.slow
def test_it_runs_as_a_module_where_no_script_is_installed(tmp_path):
    command = [sys.executable, "-m", "narxcal", "--version"]
    told = subprocess.run(command, capture_output=True, text=True, check=False, cwd=tmp_path)
    assert (told.returncode, told.stdout.partition(" ")[0]) == (0, "narxcal")


@pytest.mark.parametrize(("asked", "given"), [(None, "1"), ("4", "4")])
def test_numerical_libraries_get_one_thread_unless_more_are_asked_for(
    asked, given, monkeypatch, tmp_path, capsys
):
    monkeypatch.delenv("OMP_NUM_THREADS", raising=False)
    if asked is not None:
        monkeypatch.setenv("OMP_NUM_THREADS", asked)
    assert main(["info", str(tmp_path / "nowhere")]) == 2
    assert "nowhere" in capsys.readouterr().err
    assert os.environ["OMP_NUM_THREADS"] == given
