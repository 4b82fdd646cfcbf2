"""`in_processes` on a Dask cluster: a real scheduler and real workers in processes of their own."""

import os
import re
import signal
import time
from contextlib import ExitStack
from functools import partial
from pathlib import Path

import pytest

from narxcal.cli import main
from narxcal.support.errors import ConfigError
from narxcal.support.parallel import WorkerDied, cluster, identity, in_processes
from tests.dask_servers import Servers

pytestmark = pytest.mark.slow
ROOT = Path(__file__).parents[2]


def square(item, pause_s=0.0):
    time.sleep(pause_s)
    return item * item


def process_id(_):
    return os.getpid()


def deadly(item):
    if item == 3:
        os.kill(os.getpid(), signal.SIGKILL)
    return item


def refuse(item):
    message = f"no {item}"
    raise LookupError(message)


def samples_of_the_stack(_):
    from distributed import get_worker  # noqa: PLC0415 -- an extra

    time.sleep(0.1)
    return get_worker().profile_recent["count"]


@pytest.fixture
def servers():
    with ExitStack() as stack:
        yield Servers(stack)


@pytest.fixture
def impatient(monkeypatch):
    """Dask's own patience, in this process."""
    import dask  # noqa: PLC0415 -- an extra

    with dask.config.set({"distributed.comm.timeouts.connect": "3s"}):
        yield


@pytest.fixture
def another(tmp_path):
    """Where Python finds another version of narxcal."""
    other = tmp_path / "narxcal-0.0.7.dist-info"
    other.mkdir()
    (other / "METADATA").write_text("Metadata-Version: 2.1\nName: narxcal\nVersion: 0.0.7\n")
    return f"{tmp_path}:{ROOT}"


def test_new_workers_compute_every_item_once_and_in_order():
    with cluster(workers=2):
        assert list(in_processes(square, range(30), 1)) == [n * n for n in range(30)]
        with cluster(workers=1):  # of another command on this machine
            assert list(in_processes(square, range(3), 1)) == [0, 1, 4]
        found = list(in_processes(square, range(30), 1, ordered=False))
        assert sorted(found) == [n * n for n in range(30)]
        apart = set(in_processes(process_id, range(20), 1))
        assert os.getpid() not in apart
        assert not any(in_processes(samples_of_the_stack, range(2), 1))  # they would be kept
        with pytest.raises(LookupError, match=r"no \d"):
            list(in_processes(refuse, range(5), 1))
        results = in_processes(partial(square, pause_s=0.1), range(50), 1)
        assert next(results) == 0
        results.close()
        assert list(in_processes(square, [], 1)) == []
    assert set(in_processes(process_id, range(3), 1)) == {os.getpid()}


def test_an_item_of_which_workers_die_is_one_error_and_the_cluster_goes_on():
    with cluster(workers=2):
        with pytest.raises(WorkerDied, match="4 workers died with the same work") as died:
            list(in_processes(deadly, range(6), 1))
        assert died.value.item in range(6)  # Dask blames what waited on the worker, too
        assert list(in_processes(square, range(4), 1)) == [0, 1, 4, 9]


def test_a_worker_that_is_killed_costs_nothing(servers):
    servers.scheduler()
    first, _ = servers.worker(), servers.worker()
    with cluster(servers.address):
        results = in_processes(partial(square, pause_s=0.1), range(30), 1)
        found = [next(results) for _ in range(5)]
        first.kill()
        assert found + list(results) == [n * n for n in range(30)]


def test_a_scheduler_that_goes_away(servers):
    scheduler = servers.scheduler()
    servers.worker()
    gone = f"the scheduler {servers.address} went away. What was written stays; the same command "
    with cluster(servers.address):
        results = in_processes(partial(square, pause_s=0.1), range(100), 1)
        next(results)
        scheduler.kill()
        with pytest.raises(ConfigError, match=re.escape(gone)):
            list(results)


@pytest.mark.usefixtures("impatient")
def test_a_scheduler_that_does_not_answer(servers, tmp_path, capsys):
    out = ["fly", "demo", "--out", str(tmp_path / "out"), "--scheduler", servers.address]
    assert main(out) == 2
    said = capsys.readouterr().err
    assert said.startswith(
        f"narxcal: error: the scheduler {servers.address} does not answer: "
        "Timed out trying to connect"
    )
    assert said.endswith("Start it with 'dask scheduler', or correct --scheduler tcp://HOST:PORT\n")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("address", ["bogus", "pigeon://x:1", "tcp://x"])
def test_an_address_that_is_none(address):
    message = f"the scheduler {address} does not answer: "
    with pytest.raises(ConfigError, match=message), cluster(address):
        pass


@pytest.mark.usefixtures("impatient")
def test_a_scheduler_without_workers(servers):
    servers.scheduler()
    message = (
        f"the scheduler {servers.address} has had no worker for 3 s. "
        f"Start some: dask worker {servers.address} --nthreads 1"
    )
    with pytest.raises(ConfigError, match=re.escape(message)), cluster(servers.address):
        pass


def test_a_worker_of_another_version_is_refused_and_both_are_named(servers, another):
    servers.scheduler()
    servers.worker(PYTHONPATH=another)
    own = identity()["narxcal"]
    message = (
        rf"worker tcp://\S+ has narxcal 0.0.7, this command narxcal {re.escape(own)}\. Install"
    )
    with pytest.raises(ConfigError, match=message), cluster(servers.address):
        pass


def test_a_worker_of_another_version_that_joins_later_is_refused(servers, another):
    servers.scheduler()
    servers.worker()
    with cluster(servers.address):
        results = in_processes(partial(square, pause_s=0.05), range(2000), 1, ordered=False)
        next(results)
        servers.worker(PYTHONPATH=another)
        with pytest.raises(ConfigError, match=r"worker tcp://\S+ has narxcal 0.0.7, this command"):
            list(results)


def test_a_worker_of_several_threads_is_refused(servers):
    servers.scheduler()
    servers.worker(threads=3)
    message = r"worker tcp://\S+ runs 3 threads, expected 1\. Start it anew: dask worker \S+ --nwor"
    with pytest.raises(ConfigError, match=message), cluster(servers.address):
        pass


def test_a_scheduler_without_narxcal_is_refused(servers, tmp_path):
    (tmp_path / "narxcal").mkdir()
    (tmp_path / "narxcal/__init__.py").write_text("", "utf-8")
    servers.scheduler(PYTHONPATH=str(tmp_path))
    servers.worker()
    message = rf"the scheduler {servers.address} cannot import narxcal \(.*\)\. Install there what"
    with pytest.raises(ConfigError, match=message), cluster(servers.address):
        pass
