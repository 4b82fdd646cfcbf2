"""The same function over many items, in processes of one thread each: here, or on a Dask cluster.

`in_processes` is the one place. In the block of `cluster` it submits to the workers of that
cluster, at most `_AHEAD` items per worker at a time, so that scheduler and client hold as little
for 10^5 items as for ten. Dask does the rest: it gives the item of a worker that died to another.

Joblib's Dask backend is not used: an item at which four workers die is never reported to joblib
1.6, which waits for it for ever.
"""

from __future__ import annotations

import hashlib
import signal
import warnings
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import CancelledError
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from itertools import islice
from pathlib import Path
from typing import Any, TypeVar

from joblib import Parallel, delayed, parallel_config
from joblib.externals.loky.process_executor import TerminatedWorkerError

from narxcal.support.errors import ConfigError, NarxcalError
from narxcal.support.files import versions

S = TypeVar("S")
T = TypeVar("T")

_AHEAD = 2  # items per worker that wait there, so that no worker waits for the client
# Dask has glibc return memory at once, which also maps every array of 128 kB anew: of `prepare` in
# a worker that was a quarter of the processor time, spent in the kernel (docs/fleet.md).
_MALLOC = {"MALLOC_TRIM_THRESHOLD_": 1 << 28, "MALLOC_MMAP_THRESHOLD_": 1 << 25}
# Dask samples the stack of a worker a hundred times a second and keeps an hour of that for its
# dashboard: 2 MB more with each batch of a fleet (docs/fleet.md).
_NO_PROFILE = {"distributed.worker.profile.enabled": False}
_FLOORS = ("narxcal", "data_prep", "training", "eval")


class WorkerDied(NarxcalError):  # noqa: N818 -- an event, as KeyboardInterrupt
    """Several workers, one after the other, ended while they computed `item`, or had it waiting."""

    def __init__(self, item: Any, problem: str) -> None:
        self.item = item
        hint = "Give the workers more memory, or leave out what they died of"
        super().__init__(problem, hint=hint)


def in_processes(
    function: Callable[[S], T], items: Iterable[S], jobs: int, *, ordered: bool = True
) -> Iterator[T]:
    """Yield `function(item)` of every item, computed in `jobs` processes (-1: all cores).

    In the order of the items, or as they come where `ordered` is false. `function` has to be one
    of a module, or a partial of one, and what it raises is raised here. One job needs no process.
    A caller that stops early stops the processes without a word. Raises `ConfigError` for a process
    that was killed.

    In a block of `cluster` its workers compute, whatever `jobs` is. Then raises `WorkerDied`, and
    `ConfigError` for a scheduler that went away and for a worker of another version.
    """
    used = _cluster.get()
    if used is not None:
        yield from _on_workers(used, function, items, ordered=ordered)
        return
    if jobs == 1:
        yield from map(function, items)
        return
    # Where psutil is installed, joblib starts workers anew that have grown by 300 MB. Nothing is
    # lost. It warns in the thread that all wait for, which would end there, were that an error.
    warnings.filterwarnings("ignore", message="A worker stopped while some jobs were given")
    how = "generator" if ordered else "generator_unordered"
    with parallel_config(backend="loky", inner_max_num_threads=1):
        results = Parallel(n_jobs=jobs, return_as=how)(delayed(function)(item) for item in items)
    try:
        for result in results:  # noqa: UP028  `yield from` would close them, which warns
            yield result
    except TerminatedWorkerError:
        raise ConfigError(
            "a process ended in the middle of its work, perhaps because memory ran out",
            hint="Use fewer --jobs, or --workers, which goes on without it",
        ) from None
    finally:
        with warnings.catch_warnings():
            # Joblib tells of the results that it throws away; so does whoever pressed Ctrl-C.
            warnings.simplefilter("ignore", UserWarning)
            results.close()


# --- a cluster ---


@dataclass(frozen=True)
class _Cluster:
    """A client (`distributed.Client`) of a scheduler at `address`."""

    client: Any
    address: str

    def room(self, running: int) -> int:
        """How many more items to submit; raises `ConfigError` where the scheduler is gone."""
        try:
            return max(0, _AHEAD * max(1, len(self.client.nthreads())) - running)
        except OSError:  # the connection broke, which the client's status says only later
            raise self._gone() from None
        except (RuntimeError, AttributeError):  # of a client that has ended
            if self.client.status == "running":
                raise
            raise self._gone() from None

    def result(self, future: Any, item: object) -> Any:
        """What `item` became; raises as `in_processes`."""
        from distributed import KilledWorker  # noqa: PLC0415 -- an extra, and it takes a second

        try:
            return future.result()
        except KilledWorker as error:
            died = f"{error.allowed_failures + 1} workers died with the same work"
            raise WorkerDied(item, f"{died}, the last one {error.last_worker.address}") from None
        except CancelledError:
            raise self._gone() from None

    def _gone(self) -> ConfigError:
        hint = "What was written stays; the same command goes on"
        return ConfigError(f"the scheduler {self.address} went away", hint=hint)


_cluster: ContextVar[_Cluster | None] = ContextVar("cluster", default=None)


@contextmanager
def cluster(scheduler: str | None = None, workers: int | None = None) -> Iterator[None]:
    """Let `in_processes` use a Dask cluster in the block: at an address, or new local workers.

    Without either, nothing is changed. Raises `ConfigError` without the extra `fleet`, for a
    scheduler that does not answer or has no workers, and for workers that run several threads or
    another version of the code.
    """
    if scheduler is None and workers is None:
        yield
        return
    distributed = _distributed()
    with _local(distributed, workers) as found:
        address = scheduler or found.scheduler_address
        with _connected(distributed, address) as client:
            _check_workers(client, address)
            token = _cluster.set(_Cluster(client, address))
            try:
                yield
            finally:
                _cluster.reset(token)


def _distributed() -> Any:
    try:
        import distributed  # noqa: PLC0415 -- an extra, and it takes a second
    except ImportError:
        raise ConfigError(
            "a cluster needs dask and distributed",
            hint="Install them with: pip install 'narxcal[fleet]'",
        ) from None
    return distributed


@contextmanager
def _local(distributed: Any, workers: int | None) -> Iterator[Any]:
    """Workers of this machine, each a process of one thread; None where there are to be none."""
    if workers is None:
        yield None
        return
    import dask  # noqa: PLC0415 -- comes with distributed

    key = "distributed.nanny.pre-spawn-environ"
    quiet = {"silence_logs": "CRITICAL", "dashboard_address": None, "preload": [__name__]}
    settings = {key: {**dask.config.get(key), **_MALLOC}, **_NO_PROFILE}
    # Without a dashboard the scheduler still serves its state, by default at one port for all.
    anywhere = {"dashboard_address": "127.0.0.1:0"}
    with (
        dask.config.set(settings),
        distributed.LocalCluster(
            n_workers=workers, threads_per_worker=1, scheduler_kwargs=anywhere, **quiet
        ) as made,
    ):
        yield made


def dask_setup(_worker: object) -> None:
    """Leave Ctrl-C, which reaches the workers of this machine too, to the client."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


@contextmanager
def _connected(distributed: Any, address: str) -> Iterator[Any]:
    try:
        # A client of an address that is none takes a minute to end.
        distributed.comm.get_address_host_port(distributed.comm.normalize_address(address))
        client = distributed.Client(address, set_as_default=False)
    except (OSError, ValueError) as error:
        why = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise ConfigError(
            f"the scheduler {address} does not answer: {why}",
            hint="Start it with 'dask scheduler', or correct --scheduler tcp://HOST:PORT",
        ) from None
    with client:
        yield client


def _check_workers(client: Any, address: str) -> None:
    """Refuse a cluster without workers, and workers that would not compute the same numbers."""
    patience = client._timeout  # noqa: SLF001 -- distributed.comm.timeouts.connect, as a number
    try:
        client.wait_for_workers(1, timeout=patience)
    except TimeoutError:
        raise ConfigError(
            f"the scheduler {address} has had no worker for {patience:g} s",
            hint=f"Start some: dask worker {address} --nthreads 1",
        ) from None
    for worker, threads in client.nthreads().items():
        if threads != 1:
            raise ConfigError(
                f"worker {worker} runs {threads} threads, expected 1",
                hint=f"Start it anew: dask worker {address} --nworkers {threads} --nthreads 1",
            )
    _check_versions(client, address)


def _check_versions(client: Any, address: str) -> None:
    """Refuse workers, or a scheduler, of other versions than here, naming both."""
    own = identity()
    found = {
        f"worker {worker}": answer
        for worker, answer in client.run(identity, on_error="return").items()
    }
    try:
        found[f"the scheduler {address}"] = client.run_on_scheduler(identity)
    except Exception as error:  # noqa: BLE001 -- whatever its import raised there
        found[f"the scheduler {address}"] = error
    for where, answer in found.items():
        if isinstance(answer, Exception):
            why = f"{type(answer).__name__}: {answer}".splitlines()[0]
            hint = f"Install there what is here: {words(own)}"
            raise ConfigError(f"{where} cannot import narxcal ({why})", hint=hint)
        _check_same(own, answer, where)


def _check_same(own: dict[str, str], found: dict[str, str], where: str) -> None:
    if found != own:
        other = {name: each for name, each in found.items() if own.get(name) != each}
        ours = {name: own.get(name, "none") for name in other}
        raise ConfigError(
            f"{where} has {words(other)}, this command {words(ours)}",
            hint="Install the same version on both; results would differ",
        )


@cache
def identity() -> dict[str, str]:
    """Versions of all that decides on results, and a hash over narxcal's own code."""
    found = versions()
    for package in ("numba", "pandas", "pyarrow"):
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            found[package] = "none"
    digest = hashlib.sha256()
    root = Path(__file__).parents[2]
    for file in sorted(file for floor in _FLOORS for file in (root / floor).rglob("*.py")):
        digest.update(f"{file.relative_to(root).as_posix()}\0".encode())
        digest.update(file.read_bytes())
    return {**found, "code": digest.hexdigest()[:12]}


def words(found: dict[str, str]) -> str:
    return ", ".join(f"{name} {each}" for name, each in found.items())


def _run(function: bytes, item: bytes, own: dict[str, str]) -> Any:
    """Call a function on a worker of the same versions, also on one that joined later.

    Both are bytes until then: the scheduler, which opens what it is given, would load all that they
    are of, and need the memory for it.
    """
    distributed = _distributed()
    if identity() != own:
        _check_same(own, identity(), f"worker {distributed.get_worker().address}")
    loads = distributed.protocol.pickle.loads
    return loads(function)(loads(item))


def _on_workers(
    used: _Cluster, function: Callable[[S], T], items: Iterable[S], *, ordered: bool
) -> Iterator[T]:
    dumps = _distributed().protocol.pickle.dumps
    packed, todo = dumps(function), enumerate(items)
    running: dict[Any, tuple[int, S]] = {}
    done: dict[int, T] = {}
    following = 0
    completed = _distributed().as_completed(loop=used.client.loop)
    try:
        while True:
            for number, item in islice(todo, used.room(len(running))):
                future = used.client.submit(_run, packed, dumps(item), identity(), pure=False)
                running[future] = number, item
                completed.add(future)
            if not running:
                return
            future = next(completed)
            number, item = running.pop(future)
            done[number] = used.result(future, item)
            if not ordered:
                following = number
            while following in done:
                yield done.pop(following)
                following += 1
    finally:
        if used.client.status == "running":
            used.client.cancel(list(running))
