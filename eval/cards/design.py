"""Choose what to measure next: Bayesian optimal designs out of candidates, within a budget.

Information of independent measurements adds up,

    M = M_0 + sum of the M_k of those chosen

M_0 is the information before: the prior's precision. Each candidate is measured once: a repeated
one would repeat the error of the model, too. What may be measured several times is listed so often.

| criterion | value, which a design maximises |
|---|---|
| D | ln det M: volume of the parameters' credible ellipsoid |
| I | -tr(A M^-1): mean predictive variance, A the mean outer product of its slopes |

A design begins with the candidate of the largest gain per cost, again and again while one fits the
budget. Then a chosen one is exchanged for another wherever that raises the criterion, so that it
never falls. Sources: Chaloner and Verdinelli, Statistical Science 10 (1995); Fedorov, *Theory of
Optimal Experiments* (1972).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np

from narxcal.support.arrays import FloatArray, IntArray

# Value (...,) of the information (..., P, P) that measurements add to what is known before.
Criterion = Callable[[FloatArray], FloatArray]
_ROUNDING: Final = 1e-9  # of a value: less is no rise


@dataclass(frozen=True, eq=False)
class Candidates:
    """What can be measured: `information` (n, P, P) and `cost` (n,) of each."""

    information: FloatArray
    cost: FloatArray

    def total(self, chosen: list[int]) -> FloatArray:
        found: FloatArray = self.information[chosen].sum(axis=0)
        return found

    def open(self, budget: float, chosen: list[int]) -> IntArray:
        """Numbers of those that are not chosen and fit what these leave of the budget."""
        left = budget - float(self.cost[chosen].sum())
        fits = self.cost <= left + _ROUNDING
        fits[chosen] = False
        return np.flatnonzero(fits)


def d_optimal(prior: FloatArray) -> Criterion:
    """Give ln det (M_0 + M) with M_0 = `prior` (P, P), positive definite."""
    return lambda added: np.asarray(np.linalg.slogdet(prior + added)[1])


def i_optimal(prior: FloatArray, spread: FloatArray) -> Criterion:
    """Give -tr(A (M_0 + M)^-1) with M_0 = `prior` and A = `spread`, both (P, P)."""
    return lambda added: -np.einsum("ij,...ji->...", spread, np.linalg.inv(prior + added))


def design(candidates: Candidates, budget: float, value: Criterion) -> list[int]:
    """Numbers of the candidates to measure; [] where none fits."""
    chosen = filled(candidates, budget, value, [])
    return exchanged(candidates, budget, value, chosen)


def filled(candidates: Candidates, budget: float, value: Criterion, chosen: list[int]) -> list[int]:
    """Add the candidate of the largest gain per cost while one fits and raises the criterion."""
    chosen = list(chosen)
    while len(fits := candidates.open(budget, chosen)):
        total = candidates.total(chosen)
        gain = value(total + candidates.information[fits]) - value(total)
        best = int(np.argmax(gain / candidates.cost[fits]))
        if not gain[best] > _ROUNDING:
            break
        chosen.append(int(fits[best]))
    return chosen


def exchanged(
    candidates: Candidates, budget: float, value: Criterion, chosen: list[int]
) -> list[int]:
    """Exchange one for another, and fill what becomes free, while the criterion rises."""
    chosen = list(chosen)
    while True:
        before = float(value(candidates.total(chosen)))
        for place in range(len(chosen)):
            chosen = _better(candidates, budget, value, chosen, place)
        chosen = filled(candidates, budget, value, chosen)
        if not value(candidates.total(chosen)) > before + _ROUNDING * (1.0 + abs(before)):
            return chosen


def _better(
    candidates: Candidates, budget: float, value: Criterion, chosen: list[int], place: int
) -> list[int]:
    """With the best affordable candidate at `place`; unchanged where none raises the criterion."""
    rest = chosen[:place] + chosen[place + 1 :]
    fits = candidates.open(budget, rest)
    values = value(candidates.total(rest) + candidates.information[fits])
    now = float(value(candidates.total(chosen)))
    if not len(fits) or not values.max() > now + _ROUNDING * (1.0 + abs(now)):
        return chosen
    return [*chosen[:place], int(fits[np.argmax(values)]), *chosen[place + 1 :]]
