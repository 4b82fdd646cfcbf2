"""Compiles the engine's functions by numba; to their callers they stay what they were."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

from numba import njit

Function = TypeVar("Function", bound=Callable[..., Any])


def compiled(function: Function) -> Function:
    """Compile `function`, which may call other compiled ones and take named tuples of floats.

    Sums keep their order: the balances of the cycle are closed to rounding.
    """
    built: Any = njit(cache=True, nogil=True, error_model="numpy")(function)
    same: Function = built
    return same
