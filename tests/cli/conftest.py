"""Flights, one model trained on them, and two ways to run commands."""

import os
import subprocess
import sys
from contextlib import ExitStack
from functools import cache
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from narxcal.calibration.bundle import load_bundle
from narxcal.cli import main, train
from narxcal.flight_test.signals import first_order
from training import pipeline
from training.dynamics.network import TrainingState
from training.methods import read_checkpoint, write_checkpoint

ROOT = Path(__file__).parents[2]
CHECKPOINTS = 3  # of a training whose fit is replaced
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

[narx]
lag_limits = false

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


# Idle, range and time constant of a simulator of first-order lags; what a recorder adds.
LAGS = {"N1_pct": (25.0, 75.0, 1.5), "N2_pct": (55.0, 45.0, 0.8), "EGT_C": (400.0, 350.0, 0.7)}
NOISE = {"N1_pct": 0.05, "N2_pct": 0.04, "EGT_C": 0.8}
PROBE_TAU_S = 1.2


def slow_probe(seed, duration_s=100.0, rate_hz=8.0, stay_s=10.0):
    """Recorded and simulated table of one flight: slams, and an EGT probe slower than simulated."""
    rng = np.random.default_rng(seed)
    time_s = np.arange(round(duration_s * rate_hz)) / rate_hz
    levels = np.where(np.arange(40) % 2, 55.0, 15.0) + rng.uniform(-8.0, 8.0, 40)
    lever = levels[(time_s // stay_s).astype(int)]
    sim = pd.DataFrame({"time_s": time_s, "TRA_deg": lever, "ALT_ft": 5000.0 + 20.0 * time_s})
    for name, (idle, span, tau_s) in LAGS.items():
        sim[name] = idle + span * first_order(lever / 70.0, tau_s, 1.0 / rate_hz)
    real = sim.assign(EGT_C=first_order(sim["EGT_C"].to_numpy(), PROBE_TAU_S, 1.0 / rate_hz))
    for name, size in NOISE.items():
        real[name] += rng.normal(0.0, size, len(lever))
    return real, sim


@pytest.fixture(name="slow_probe", scope="session")
def _slow_probe():
    """Flights of a simulator of lags whose EGT probe is `PROBE_TAU_S` slower than it says."""
    return slow_probe


@pytest.fixture(scope="session")
def case(slow_probe, tmp_path_factory):
    """Three flights with a probe that lags by 1.2 s, one held out, and the same without it."""
    folder = tmp_path_factory.mktemp("case")
    for seed in range(4):
        real, sim = slow_probe(seed, 200.0, stay_s=20.0)
        held = "_held" if seed == 3 else ""
        for kind, table in (("sim", sim), ("real", real)):
            (folder / f"{kind}{held}").mkdir(exist_ok=True)
            table.to_csv(folder / f"{kind}{held}" / f"f{seed}.csv", index=False)
    return folder


@pytest.fixture(scope="session")
def diagnosed(case):
    held = ["--heldout-real", str(case / "real_held"), "--heldout-sim", str(case / "sim_held")]
    where = ["--real", str(case / "real"), "--sim", str(case / "sim")]
    out = ["--out", str(case / "gap"), "--quiet"]
    assert main(["diagnose", *where, *held, *out]) == 0
    return case / "gap"


@pytest.fixture
def narxcal(capsys):
    """Run a command in this process: exit code, stdout and stderr."""

    def run(*arguments):
        code = main([str(part) for part in arguments])
        shown = capsys.readouterr()
        return SimpleNamespace(code=code, out=shown.out, err=shown.err)

    return run


@pytest.fixture
def training(project, monkeypatch):
    """The command `train`, whose fit is three checkpoints and then the model of the project."""
    trained = load_bundle(project / "run")

    def calibrate(_config, _base, _split, options):
        file, first = options.checkpoints / "joint.safetensors", 0
        if options.resume and file.is_file():
            first = read_checkpoint(file, "key").iteration
        for step in range(first, CHECKPOINTS):
            write_checkpoint(
                file, TrainingState(np.full(500, float(step)), iteration=step + 1), "key"
            )
        return trained

    real = pipeline.prepare_logs
    once = cache(lambda file: real(train.read_config(project / "tiny.toml", None)[0], [file]))
    monkeypatch.setattr(pipeline, "prepare_logs", lambda _, files: once(files[0]))
    monkeypatch.setattr(train, "calibrate", calibrate)
    return "train", project / "tiny.toml", "--out"


@pytest.fixture
def undrawn(monkeypatch):
    """Pages without their drawings, which take most of the time, where only figures are read."""
    monkeypatch.setattr("narxcal.cli.evaluate.evaluate_page", lambda *_: "")
    monkeypatch.setattr("narxcal.cli.prepare.prepare_page", lambda *_: "")
    monkeypatch.setattr("narxcal.cli.prepare.MOST_DRAWN", 0)


def environment(**more):
    return {**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1", **more}


@pytest.fixture(scope="session")
def shell():
    """Run the command as a user does, in a process of its own."""

    def run(*arguments, **options):
        command = [sys.executable, "-m", "narxcal", *map(str, arguments)]
        pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "env": environment()}
        return subprocess.run(command, text=True, check=False, **{**pipes, **options})

    return run


@pytest.fixture
def start():
    """Start the command and leave it running; it is gone when the test is over."""
    with ExitStack() as stack:

        def run(*arguments):
            command = [sys.executable, "-m", "narxcal", *map(str, arguments)]
            pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "env": environment()}
            process = stack.enter_context(subprocess.Popen(command, text=True, **pipes))
            stack.callback(process.kill)
            return process

        yield run
