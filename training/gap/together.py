"""Two effects at once, before they are fitted: as each was found by itself, added up."""

from __future__ import annotations

import numpy as np

from narxcal.effects.dynamic import AccelLimit
from narxcal.effects.steady import HeatSoak
from narxcal.support.arrays import FloatArray
from training.gap.fitting import Fit
from training.gap.quadratic import Misfit

_OWN_LIMIT = 0.25  # of the simulator's acceleration that a build may have more or less


def is_heat(one: Fit) -> bool:
    """Whether a fit is a heat soak and nothing else."""
    return len(one.effects) == 1 and isinstance(one.effects[0], HeatSoak)


def is_expected(one: Fit) -> bool:
    """Whether a fit is what most engines have against a simulator: heat, or a limit of their own.

    What a control's limit leaves to accelerate with is the difference of two large torques, so that
    builds of one type, and a worn one, differ in it by up to a quarter.
    """
    return is_heat(one) or _is_near_limit(one)


def _is_near_limit(one: Fit) -> bool:
    alone = len(one.effects) == 1 and isinstance(one.effects[0], AccelLimit)
    return alone and abs(float(one.theta[0]) - 1.0) <= _OWN_LIMIT


def in_order(first: Fit, second: Fit) -> tuple[Fit, Fit]:
    """Two fits as they are named: what is to be expected last, and a heat soak at the very end.

    Heat follows anything slow, so that beside an effect of moves it is the one that may only be
    what else is wrong: of 15 such pairs in blind cases where one of the two was there, it was once.
    """
    swapped = is_heat(first) or (is_expected(first) and not is_expected(second))
    return (second, first) if swapped else (first, second)


def added(first: Fit, second: Fit) -> Fit:
    """Both effects as each was found by itself: their responses added up."""
    return Fit(
        effects=(*first.effects, *second.effects),
        parameters=(*first.parameters, *second.parameters),
        theta=np.concatenate([first.theta, second.theta]),
        left=np.minimum(first.left, second.left),
        held_out=np.minimum(first.held_out, second.held_out),
        others=np.concatenate([first.others, second.others], axis=1),
        response=first.response + second.response,
        slopes=np.concatenate([first.slopes, second.slopes]),
        sizes=(*first.sizes, *second.sizes),
    )


def taken(measure: Misfit, first: Fit, second: Fit) -> float:
    """Q that two effects take off together, if their responses add up and scale."""
    both = np.stack([first.response, second.response])
    slopes: FloatArray = np.concatenate([both, first.slopes, second.slopes])
    hessian = measure.inner(slopes, slopes).sum(axis=0)
    toward = measure.inner(slopes, measure.gap[None]).sum(axis=0)[:, 0]
    scale = np.sqrt(np.maximum(np.diag(hessian), 1e-300))
    ridge = hessian / np.outer(scale, scale) + 1e-3 * np.eye(len(scale))
    return float(toward / scale @ np.linalg.solve(ridge, toward / scale))
