"""`narxcal fleet` on a real Dask cluster: interrupted, restarted, and the same bytes."""

import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

from narxcal.calibration.bundle import save_bundle
from narxcal.cli import main
from narxcal.support.csv_text import log_csv
from tests.dask_servers import ROOT

pytestmark = pytest.mark.slow
FILES, BATCH = 40, 4
CONFIG = 'schema = "narxcal.fleet/1"\nflights = "flights"\nrun = "run"\nbatch = {batch}\n'


@pytest.fixture(scope="module")
def fleet(tmp_path_factory):
    """A folder with flights of two tails, a bad file, a copy, and the dataset of one process."""
    from tests.eval.conftest import lag_bundle, lag_log  # noqa: PLC0415 -- fixtures are per test

    folder = tmp_path_factory.mktemp("fleet")
    save_bundle(folder / "run", lag_bundle())
    log = lag_log(duration_s=120.0)
    for number in range(FILES):
        file = folder / "flights" / f"N{number % 2}" / f"f{number:02d}.csv"
        file.parent.mkdir(parents=True, exist_ok=True)
        noise = np.random.default_rng(number).normal(0.0, 0.05, len(log))
        channels = {**log.channels, "N2_pct": log["N2_pct"] + noise}
        file.write_bytes(log_csv({"time_s": log.time_s, **channels}).encode())
    (folder / "flights/N0/bad.csv").write_text("no,log\n", "utf-8")
    (folder / "flights/N1/copy.csv").write_bytes((folder / "flights/N0/f00.csv").read_bytes())
    (folder / "fleet.toml").write_text(CONFIG.format(batch=BATCH), "utf-8")
    assert main(["fleet", str(folder / "fleet.toml"), "--out", str(folder / "one"), "--quiet"]) == 0
    return folder


def parts(folder):
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in files}


def done(out):
    return len(list(out.glob("logs/*/*.parquet")))


def started(fleet, out, *how):
    """The command in a process of its own."""
    command = [sys.executable, "-m", "narxcal", "fleet", fleet / "fleet.toml", "--out", out, *how]
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    return subprocess.Popen([str(part) for part in command], env=environment, **pipes)


def wait_for(condition, process):
    deadline = time.monotonic() + 600.0  # a busy machine is no failure
    while not condition():
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < deadline
        time.sleep(0.01)


@pytest.mark.parametrize("how", [("--workers", "2"), ("--jobs", "2")])
def test_a_cluster_and_processes_give_the_bytes_of_one_process(fleet, tmp_path, how):
    out = tmp_path / "two"
    assert main(["fleet", str(fleet / "fleet.toml"), "--out", str(out), *how, "--quiet"]) == 0
    assert parts(out) == parts(fleet / "one")


@pytest.mark.parametrize("how", [signal.SIGTERM, signal.SIGKILL])
def test_an_interrupted_client_goes_on_to_the_same_dataset(fleet, tmp_path, capsys, how):
    out = tmp_path / "two"
    process = started(fleet, out, "--workers", "1")
    wait_for(lambda: done(out) >= 2, process)
    process.send_signal(how)
    _, said = process.communicate(timeout=600)
    there = done(out)
    assert 2 <= there < done(fleet / "one")
    if how == signal.SIGKILL:
        assert process.returncode == -how
    else:
        assert process.returncode == 128 + how
        assert said.startswith("narxcal: interrupted; ")
        assert said.endswith(f" of {FILES + 2} files are in {out}; the same command goes on\n")
    before = parts(out)
    assert main(["fleet", str(fleet / "fleet.toml"), "--out", str(out)]) == 0
    assert f"of {FILES + 2} files are in {out} already" in capsys.readouterr().out
    after = parts(out)
    assert after == parts(fleet / "one")
    assert {name for name in before if before[name] != after[name] and "logs/" in name} == set()
