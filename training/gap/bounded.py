"""Least squares within bounds, from inner products alone.

Stark & Parker, *Bounded-Variable Least-Squares: an Algorithm and Applications*, Computational
Statistics 10 (1995).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from scipy.optimize import lsq_linear

from narxcal.effects.base import Parameter
from narxcal.support.arrays import FloatArray

_RIDGE: Final = 1e-6
_THIN: Final = 1e-9  # least width of a bound
_ALIKE: Final = 1.0 + 1e-6  # cosine of two directions, at most
_TELLING: Final = 1e-3  # of what all flights say of a parameter: less is next to nothing


def room(theta: FloatArray, parameters: Sequence[Parameter]) -> FloatArray:
    """How far each parameter can still go, down and up: (p, 2)."""
    bounds = np.array([(p.low, p.high) for p in parameters]).reshape(-1, 2)
    return np.asarray(bounds - theta[:, None])


def without(
    inner: tuple[FloatArray, FloatArray], flight: int, bounded: int = 0
) -> tuple[FloatArray, FloatArray]:
    """Hessian (p, p) and gradient (p,) of all flights but one, of `inner` (flights, p, ...).

    A switch that one flight alone moves is nearly nothing to the others: what they make of its
    amplitude is noise, of any size. So a thousandth of what all flights say of a parameter holds
    it where it is, but for the first ones, that are narrowly `bounded`.
    """
    hessian, toward = inner
    whole = hessian.sum(axis=0)
    held = _TELLING * np.diag(whole)
    held[:bounded] = 0.0
    return whole - hessian[flight] + np.diag(held), toward.sum(axis=0) - toward[flight]


def least_within(hessian: FloatArray, toward: FloatArray, bounds: FloatArray) -> FloatArray:
    """Least of `x' H x - 2 x' b` (p,) within bounds (p, 2): `H = L L'`, `|L' x - L^-1 b|^2`.

    A direction in which nothing moves is not gone.
    """
    moves = np.diag(hessian) > 0.0
    scale = np.sqrt(np.where(moves, np.diag(hessian), 1.0))
    root = _root(np.where(np.outer(moves, moves), hessian / np.outer(scale, scale), 0.0))
    low, high = bounds[:, 0] * scale, bounds[:, 1] * scale
    target = np.linalg.solve(root, np.where(moves, toward / scale, 0.0))
    found = lsq_linear(root.T, target, (low, np.maximum(high, low + _THIN)), method="bvls")
    return np.clip(np.where(moves, found.x / scale, 0.0), bounds[:, 0], bounds[:, 1])


def _root(scaled: FloatArray) -> FloatArray:
    """Give L with `L L' = H + ridge`, (p, p); of an H that is indefinite by rounding, the nearest.

    Differences of large sums may leave more off the diagonal than on it, which nothing that moves
    can (Cauchy and Schwarz): that is rounding alone.
    """
    try:
        return np.asarray(np.linalg.cholesky(scaled + _RIDGE * np.eye(len(scaled))))
    except np.linalg.LinAlgError:
        values, vectors = np.linalg.eigh(np.where(np.abs(scaled) > _ALIKE, 0.0, scaled))
        return np.asarray(vectors * np.sqrt(np.maximum(values, _RIDGE)))
