"""The same function over many items, in processes of one thread each."""

from __future__ import annotations

import warnings
from typing import TYPE_CHECKING, TypeVar

from joblib import Parallel, delayed, parallel_config

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator

S = TypeVar("S")
T = TypeVar("T")


def in_processes(
    function: Callable[[S], T], items: Iterable[S], jobs: int, *, ordered: bool = True
) -> Iterator[T]:
    """Yield `function(item)` of every item, computed in `jobs` processes (-1: all cores).

    In the order of the items, or as they come where `ordered` is false. `function` has to be one
    of a module, or a partial of one, and what it raises is raised here. One job needs no process.
    A caller that stops early stops the processes without a word.
    """
    if jobs == 1:
        yield from map(function, items)
        return
    how = "generator" if ordered else "generator_unordered"
    with parallel_config(backend="loky", inner_max_num_threads=1):
        results = Parallel(n_jobs=jobs, return_as=how)(delayed(function)(item) for item in items)
    try:
        for result in results:  # noqa: UP028  `yield from` would close them, which warns
            yield result
    finally:
        with warnings.catch_warnings():
            # Joblib tells of the results that it throws away; so does whoever pressed Ctrl-C.
            warnings.simplefilter("ignore", UserWarning)
            results.close()
