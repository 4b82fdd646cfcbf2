"""`in_processes`: the numbers, the order, the threads, and leaving early."""

from __future__ import annotations

import os
import signal
import time
import warnings
from functools import partial

import pytest

from narxcal.support.errors import ConfigError
from narxcal.support.parallel import in_processes

ITEMS = range(6)


def _square(item: int) -> int:
    return item * item


def _slow_square(item: int, slow: int) -> int:
    time.sleep(0.3 * (item == slow))
    return item * item


def _surroundings(_: int) -> tuple[int, str | None]:
    return os.getpid(), os.environ.get("OMP_NUM_THREADS")


def _die(item: int) -> None:
    if item == 2:
        os.kill(os.getpid(), signal.SIGKILL)


def _refuse(item: int) -> int:
    message = f"no {item}"
    raise LookupError(message)


@pytest.mark.parametrize("jobs", [1, 2, -1])
@pytest.mark.parametrize("ordered", [True, False])
def test_every_item_is_computed_once_whatever_the_jobs(jobs, ordered):
    found = list(in_processes(_square, ITEMS, jobs, ordered=ordered))
    assert (found if ordered else sorted(found)) == [item * item for item in ITEMS]


def test_results_come_in_order_even_where_the_first_is_slow():
    found = list(in_processes(partial(_slow_square, slow=0), ITEMS, 2))
    assert found == [item * item for item in ITEMS]


def test_one_job_stays_in_this_process_and_two_get_others_of_one_thread():
    assert {pid for pid, _ in in_processes(_surroundings, ITEMS, 1)} == {os.getpid()}
    apart = list(in_processes(_surroundings, ITEMS, 2))
    assert os.getpid() not in {pid for pid, _ in apart}
    assert {threads for _, threads in apart} == {"1"}


@pytest.mark.parametrize("jobs", [1, 2])
def test_what_a_task_raises_is_raised_here(jobs):
    with pytest.raises(LookupError, match=r"no \d"):
        list(in_processes(_refuse, ITEMS, jobs))


def test_a_process_that_is_killed_is_one_error():
    with pytest.raises(ConfigError, match="a process ended in the middle of its work"):
        list(in_processes(_die, ITEMS, 2))
    assert list(in_processes(_square, ITEMS, 2)) == [item * item for item in ITEMS]


@pytest.mark.parametrize("ordered", [True, False])
def test_a_caller_that_stops_early_hears_nothing_of_the_rest(ordered):
    results = in_processes(_square, range(50), 2, ordered=ordered)
    next(results)
    time.sleep(0.5)  # by now there are results that nobody has taken
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        results.close()


_KEPT: list[bytearray] = []


def _keep(item: int) -> int:
    """Keep 200 MB for ever, as long as Joblib's workers look at their memory once a second."""
    _KEPT.append(bytearray(200_000_000))
    time.sleep(0.6)
    return item


@pytest.mark.slow
def test_workers_that_joblib_starts_anew_for_their_memory_lose_nothing():
    """It says so by a warning in a thread, which as an error would end the thread: all would wait.

    Joblib measures memory where psutil is installed, as with the extra `fleet`.
    """
    pytest.importorskip("psutil")
    assert list(in_processes(_keep, range(14), 2)) == list(range(14))
