"""The business-jet engine as its maker would hand it over: where it settles, and no more."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from narxcal.turbofan.virtual_engine import VirtualEngine


def maker_model(inputs: ArrayLike) -> NDArray[np.float64]:
    """Settled N1, N2 and EGT (..., 3) at `inputs` (..., 9), the virtual engine's.

    Raises `ModelError` naming the condition that does not converge.
    """
    return _business_jet().outputs(inputs)[..., :3]


@lru_cache(maxsize=1)
def _business_jet() -> VirtualEngine:
    """Built once: a replay asks for one row at a time."""
    return VirtualEngine("business_jet")
