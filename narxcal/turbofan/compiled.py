"""Compiles the engine's functions by numba; to their callers they stay what they were."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

from numba import njit

Function = TypeVar("Function", bound=Callable[..., Any])


def compiled(function: Function) -> Function:
    """Compile `function`, which may call other compiled ones and take named tuples of floats.

    Sums keep their order: the balances of the cycle are closed to rounding. Nobody calls from C,
    and leaving that wrapper out saves time of compiling. What Python calls returns no named tuple:
    a signal that arrives meanwhile would end the process (`narxcal.interrupt`).
    """
    build: Any = njit  # whose type does not name all its options
    same: Function = build(cache=True, nogil=True, error_model="numpy", no_cfunc_wrapper=True)(
        function
    )
    return same
