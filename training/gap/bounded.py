"""Least squares within bounds, from inner products alone.

Stark & Parker, *Bounded-Variable Least-Squares: an Algorithm and Applications*, Computational
Statistics 10 (1995).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from scipy.optimize import lsq_linear

from narxcal.effects.base import FloatArray, Parameter

_RIDGE: Final = 1e-6
_THIN: Final = 1e-9  # least width of a bound


def room(theta: FloatArray, parameters: Sequence[Parameter]) -> FloatArray:
    """How far each parameter can still go, down and up: (p, 2)."""
    bounds = np.array([(p.low, p.high) for p in parameters]).reshape(-1, 2)
    return np.asarray(bounds - theta[:, None])


def least_within(hessian: FloatArray, toward: FloatArray, bounds: FloatArray) -> FloatArray:
    """Least of `x' H x - 2 x' b` (p,) within bounds (p, 2): `H = L L'`, `|L' x - L^-1 b|^2`."""
    scale = np.sqrt(np.maximum(np.diag(hessian), 1e-300))
    root = np.linalg.cholesky(hessian / np.outer(scale, scale) + _RIDGE * np.eye(len(scale)))
    low, high = bounds[:, 0] * scale, bounds[:, 1] * scale
    target = np.linalg.solve(root, toward / scale)
    found = lsq_linear(root.T, target, (low, np.maximum(high, low + _THIN)), method="bvls")
    return np.asarray(found.x / scale)
