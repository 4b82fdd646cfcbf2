"""`narxcal fleet` on a real Dask cluster: killed, interrupted, restarted, and the same bytes."""

import os
import signal
import subprocess
import sys
import time
from contextlib import ExitStack

import numpy as np
import pandas as pd
import pytest

from narxcal.calibration.bundle import save_bundle
from narxcal.cli import main
from narxcal.support.files import log_csv
from tests.dask_servers import ROOT, Servers

pytestmark = pytest.mark.slow
FILES, BATCH = 40, 4
CONFIG = 'schema = "narxcal.fleet/1"\nflights = "flights"\nrun = "run"\nbatch = {batch}\n'
# A file system of which a worker dies when it reads `deadly.csv` again, after it was hashed.
DEADLY = """\
import os, signal
from fsspec import register_implementation
from fsspec.implementations.local import LocalFileSystem

class Deadly(LocalFileSystem):
    protocol = ("sftp",)

    @classmethod
    def _strip_protocol(cls, path):
        return super()._strip_protocol(str(path).removeprefix("sftp://"))

    def get(self, source, target, **options):
        if source.endswith("deadly.csv") and os.path.exists(source + ".hashed"):
            os.kill(os.getpid(), signal.SIGKILL)
        if source.endswith("deadly.csv"):
            open(source + ".hashed", "w").close()
        return super().get(source, target, **options)

register_implementation("sftp", Deadly, clobber=True)
"""


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


@pytest.fixture
def servers():
    with ExitStack() as stack:
        yield Servers(stack)


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
    deadline = time.monotonic() + 120.0
    while not condition():
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < deadline
        time.sleep(0.01)


@pytest.mark.parametrize("how", [("--workers", "2"), ("--jobs", "2")])
def test_a_cluster_and_processes_give_the_bytes_of_one_process(fleet, tmp_path, how):
    out = tmp_path / "two"
    assert main(["fleet", str(fleet / "fleet.toml"), "--out", str(out), *how, "--quiet"]) == 0
    assert parts(out) == parts(fleet / "one")


def test_a_worker_killed_in_the_middle_costs_nothing(fleet, servers, tmp_path):
    servers.scheduler()
    first, _ = servers.worker(), servers.worker()
    process = started(fleet, tmp_path / "two", "--scheduler", servers.address)
    wait_for(lambda: done(tmp_path / "two") >= 2, process)
    os.kill(first.pid, signal.SIGKILL)
    _, said = process.communicate(timeout=120)
    assert process.returncode == 0, said
    assert parts(tmp_path / "two") == parts(fleet / "one")


@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_an_interrupted_client_goes_on_to_the_same_dataset(fleet, tmp_path, how):
    out = tmp_path / "two"
    process = started(fleet, out, "--workers", "1")
    wait_for(lambda: done(out) >= 2, process)
    process.send_signal(how)
    _, said = process.communicate(timeout=60)
    there = done(out)
    assert 2 <= there < done(fleet / "one")
    if how == signal.SIGKILL:
        assert process.returncode == -how
    else:
        assert process.returncode == 128 + how
        assert said.startswith("narxcal: interrupted; ")
        assert said.endswith(f" of {FILES + 2} files are in {out}; the same command goes on\n")
    before = parts(out)
    again = started(fleet, out, "--workers", "2")
    said, _ = again.communicate(timeout=120)
    assert again.returncode == 0
    assert f"of {FILES + 2} files are in {out} already" in said
    after = parts(out)
    assert after == parts(fleet / "one")
    assert {name for name in before if before[name] != after[name] and "logs/" in name} == set()


def test_a_scheduler_that_is_killed_and_started_anew(fleet, servers, tmp_path):
    out = tmp_path / "two"
    scheduler = servers.scheduler()
    servers.worker()
    process = started(fleet, out, "--scheduler", servers.address)
    wait_for(lambda: done(out) >= 2, process)
    os.kill(scheduler.pid, signal.SIGKILL)
    scheduler.wait()
    _, said = process.communicate(timeout=60)
    assert process.returncode == 2
    assert f"the scheduler {servers.address} went away. What was written stays" in said
    assert 2 <= done(out) < done(fleet / "one")
    servers.scheduler()
    servers.worker()
    again = started(fleet, out, "--scheduler", servers.address)
    _, said = again.communicate(timeout=120)
    assert again.returncode == 0, said
    assert parts(out) == parts(fleet / "one")


def test_a_log_of_which_workers_die_is_a_row(fleet, servers, tmp_path, monkeypatch):
    (tmp_path / "deadly_files.py").write_text(DEADLY, "utf-8")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    folder = tmp_path / "flights/N0"
    folder.mkdir(parents=True)
    for number in range(4):
        file = f"f{number:02d}.csv"
        (folder / file).write_bytes((fleet / f"flights/N{number % 2}/{file}").read_bytes())
    (folder / "deadly.csv").write_bytes((fleet / "flights/N0/f04.csv").read_bytes())
    text = CONFIG.format(batch=3).replace('"flights"', f'"sftp://{tmp_path}/flights"')
    (tmp_path / "fleet.toml").write_text(text.replace('"run"', f'"{fleet}/run"'), "utf-8")
    monkeypatch.syspath_prepend(str(tmp_path))
    import deadly_files  # noqa: F401, PLC0415 -- registers its file system

    servers.scheduler()
    preload = ("--preload", "deadly_files")
    servers.worker(preload, nanny=True, PYTHONPATH=f"{ROOT}:{tmp_path}")
    out = ["--out", str(tmp_path / "two"), "--scheduler", servers.address, "--quiet"]
    assert main(["fleet", str(tmp_path / "fleet.toml"), *out, "--traceback"]) == 0
    logs = pd.read_parquet(tmp_path / "two/logs").set_index("file")
    assert sorted(logs.index) == ["N0/deadly.csv", *(f"N0/f{n:02d}.csv" for n in range(4))]
    row = logs.loc["N0/deadly.csv"]
    assert row["status"] == "failed"
    assert row["reason"].startswith("4 workers died with the same work, the last one tcp://")
    assert (logs["status"] == "good").sum() == 4
