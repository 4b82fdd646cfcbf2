"""Short pieces of virtual flights, one model trained on them, and two ways to run commands."""

import os
import signal
import subprocess
import sys
from contextlib import ExitStack
from pathlib import Path
from types import SimpleNamespace

import pytest

from narxcal.cli import main

ROOT = Path(__file__).parents[2]
CONFIG = """\
schema = "narxcal.config/1"
name = "tiny"

[logs]
folder = "flights"
files = ["flight_*.csv"]
raster_hz = 8.0

[smooth]
window = 3

[split]
train = ["flight_[1-2].csv*"]
test = ["flight_3.csv*"]

[train]
horizons_s = [5.0, 30.0]
iterations = [2, 2]
threads = 1

[evaluate.crossval]
random_splits = 1

[steady_state]
kind = "table"
source = "MAKER"
inputs = ["TRA_deg", "ALT_ft", "Mach", "dT_C", "WOW", "Approach"]
"""


@pytest.fixture(scope="session")
def project(tmp_path_factory, write_pieces, maker_table):
    """A folder with flights, a configuration and a trained model, for all tests to read."""
    folder = tmp_path_factory.mktemp("project")
    write_pieces(folder / "flights", seed=3, flights=3)
    (folder / "tiny.toml").write_text(CONFIG.replace("MAKER", maker_table["source"]), "utf-8")
    assert main(["train", str(folder / "tiny.toml"), "--out", str(folder / "run"), "--quiet"]) == 0
    return folder


@pytest.fixture
def narxcal(capsys):
    """Run a command in this process: exit code, stdout and stderr."""

    def run(*arguments):
        code = main([str(part) for part in arguments])
        shown = capsys.readouterr()
        return SimpleNamespace(code=code, out=shown.out, err=shown.err)

    return run


def environment(**more):
    return {**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1", **more}


@pytest.fixture(scope="session")
def shell():
    """Run the command as a user does, in a process of its own."""

    def run(*arguments, **options):
        command = [sys.executable, "-m", "narxcal.cli", *map(str, arguments)]
        pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "env": environment()}
        return subprocess.run(command, text=True, check=False, **{**pipes, **options})

    return run


def hearing():
    signal.signal(signal.SIGINT, signal.SIG_DFL)


@pytest.fixture
def start():
    """Start the command and leave it running; it is gone when the test is over."""
    with ExitStack() as stack:

        def run(*arguments):
            command = [sys.executable, "-m", "narxcal.cli", *map(str, arguments)]
            pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "env": environment()}
            # A shell starts its background jobs deaf to Ctrl-C, and theirs inherit that.
            process = stack.enter_context(
                subprocess.Popen(command, text=True, preexec_fn=hearing, **pipes)  # noqa: PLW1509 - no threads here
            )
            stack.callback(process.kill)
            return process

        yield run
