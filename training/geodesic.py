"""Bent steps for Levenberg-Marquardt in long valleys, and damping that lets strong weights move.

Weights of a feedback path move a free run far more than others do. Damping scaled by the full
diagonal (Marquardt, 1963) holds each of them back by as much as it moves the run, and the descent
creeps along the valley that they share; without any scaling (Levenberg, 1944) weak weights wander.
The root of the diagonal lies between the two.

Source of the second order: Transtrum and Sethna (2012), Improvements to the Levenberg-Marquardt
algorithm for nonlinear least-squares minimization, arXiv 1201.5885: with the step v, the
acceleration a solves (H + D) a = -J' r'' / 2, r'' the second derivative of the residuals along v,
and v + a is taken if 2 |a| <= 0.75 |v|, both measured by the damping D.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from typing import Protocol

import numpy as np
from scipy.linalg import LinAlgError, cho_factor, cho_solve

from narxcal.support.arrays import FloatArray
from training import levenberg_marquardt
from training.levenberg_marquardt import Damping, Problem, Step

_MOST_BEND = 0.75


class CurvedProblem(Problem, Protocol):
    """A problem that also knows how its residuals bend."""

    def curvature(self, theta: FloatArray, step: FloatArray) -> FloatArray:
        """J' r'' (P,), with r'' the second derivative of the residuals along `step`."""


def minimise(
    problem: CurvedProblem, theta: FloatArray, decay: float = 0.0, damping: Damping | None = None
) -> Iterator[Step]:
    """Yield accepted steps downhill, as `training.levenberg_marquardt.minimise` does."""
    propose = partial(_bent, problem)
    return levenberg_marquardt.minimise(problem, theta, decay, damping, propose)


def _bent(
    problem: CurvedProblem,
    theta: FloatArray,
    slopes: tuple[FloatArray, FloatArray],
    damping: float,
) -> tuple[FloatArray, FloatArray]:
    """The straight step v and v + a; twice nothing where v bends too much to be trusted."""
    gradient, hessian = slopes
    nothing = np.zeros_like(gradient), np.zeros_like(gradient)
    scale = _scale(np.diag(hessian))
    try:
        factor = cho_factor(hessian + damping * np.diag(scale))
    except LinAlgError:
        return nothing
    straight = cho_solve(factor, -gradient)
    curvature = problem.curvature(theta, straight)
    if not np.isfinite(curvature).all():
        return nothing
    bend = -0.5 * cho_solve(factor, curvature)
    if 4.0 * float(bend**2 @ scale) > _MOST_BEND**2 * float(straight**2 @ scale):
        return nothing
    return straight, straight + bend


def _scale(diagonal: FloatArray) -> FloatArray:
    """Root of the diagonal (P,), in its units; never so little that a weight is undamped."""
    floored = np.maximum(diagonal, 1e-9 * diagonal.max() + 1e-30)
    return np.asarray(np.sqrt(floored * floored.mean()))
