"""What the best of many hypotheses gains where there is nothing to find.

Criteria that count parameters claim an effect on every null (GAP, section 5), because residuals
are coloured and many hypotheses compete. So the residuals themselves, shifted in time and with
random signs, are put through the same linear step and jackknife for every hypothesis, and the
best one's gain is kept: its upper quantile is what a claim has to exceed.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from narxcal.support.arrays import FloatArray
from training.gap.fitting import Fit
from training.gap.quadratic import Misfit

_RIDGE = 1e-6


def null_gains(
    fits: Sequence[Fit], misfit: Misfit, residual: FloatArray, draws: int, seed: int
) -> FloatArray:
    """Gain in Q of the best hypothesis on each of `draws` pseudo-nulls: (draws,).

    `residual` (flights, time, outputs) is what the best model leaves; `fits` are all hypotheses.
    What it says where nothing is known, as behind the end of a shorter flight, is no residual.
    """
    random, known = np.random.default_rng(seed), misfit.weights > 0.0
    flown = [_end(rows) for rows in known]
    left = np.where(known, residual, 0.0)
    directions = [_Directions(fit.slopes, misfit) for fit in fits]
    gains = np.zeros(draws)
    for k in range(draws):
        shuffled = _shuffled(left, flown, random)
        gains[k] = max(direction.gain(shuffled) for direction in directions)
    return gains


def _end(known: NDArray[np.bool_]) -> int:
    """Samples up to the last of which anything is known (time, outputs)."""
    rows = np.flatnonzero(known.any(axis=1))
    return int(rows[-1]) + 1 if len(rows) else len(known)


def _shuffled(
    residual: FloatArray, flown: Sequence[int], random: np.random.Generator
) -> FloatArray:
    """Each flight's residual, turned in time by at least a tenth of it, with a random sign."""
    moved = np.zeros_like(residual)
    for f, steps in enumerate(flown):
        shift = int(random.integers(steps // 10, max(steps - steps // 10, steps // 10 + 1)))
        own = np.roll(residual[f, :steps], shift, axis=0)
        moved[f, :steps] = random.choice((-1.0, 1.0)) * own
    return moved


class _Directions:
    """The directions in which one hypothesis can move, ready for many residuals."""

    def __init__(self, slopes: FloatArray, misfit: Misfit) -> None:
        weighted = slopes * misfit.weights
        hessian = misfit.inner(slopes, slopes)
        on = np.einsum("pftn,fktn->fpk", weighted, misfit.nuisances, optimize=True)
        through = np.einsum("fpk,fkl->fpl", on, misfit.solved)
        # What is left of each direction once the nuisances are taken out, weighted.
        taken = np.einsum("fpk,fktn->pftn", through, misfit.nuisances, optimize=True)
        self._toward = weighted - taken * misfit.weights
        self._scale = np.sqrt(np.maximum(np.einsum("fpp->p", hessian), 1e-300))
        self._hessian = hessian / np.outer(self._scale, self._scale)

    def gain(self, residual: FloatArray) -> float:
        """Fall of Q over all flights, each predicted by the others."""
        toward = np.einsum("pftn,ftn->fp", self._toward, residual, optimize=True) / self._scale
        total, gain = self._hessian.sum(axis=0), 0.0
        for f in range(len(toward)):
            ridge = _RIDGE * np.eye(len(total))
            step = np.linalg.solve(total - self._hessian[f] + ridge, toward.sum(axis=0) - toward[f])
            gain += 2.0 * step @ toward[f] - step @ self._hessian[f] @ step
        return float(gain)
