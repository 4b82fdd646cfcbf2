r"""The budget: which cause takes how much of the gap's energy, by Shapley values.

The worth of a set of causes is the energy that they take together, each channel over its range
squared, `v(S) = |d|^2 - |d - C(S)|^2`, where `C(S)` is what they do when they alone are fitted. A
cause's share is the mean of what it adds over all orders in which the causes enter; shares of all
causes, noise and what is unexplained add up to the whole.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from math import factorial

import numpy as np

from narxcal.support.arrays import FloatArray

Worth = Callable[[frozenset[int]], FloatArray]  # what a set of causes takes, of any shape


@dataclass(frozen=True, eq=False)
class Split:
    """Shares of each cause, (causes, ...): by Shapley, entering first, and entering last."""

    shares: FloatArray
    first: FloatArray
    last: FloatArray


def shapley(causes: int, worth: Worth) -> Split:
    """Shapley values of `causes` by the worth of all their sets.

    `first` is what a cause takes alone, `last` what it adds to all others.
    """
    whole = frozenset(range(causes))
    known: Mapping[frozenset[int], FloatArray] = {
        frozenset(s): worth(frozenset(s)) for n in range(causes + 1) for s in combinations(whole, n)
    }
    shares = []
    for i in range(causes):
        rest = sorted(whole - {i})
        total = np.zeros_like(known[whole])
        for n in range(causes):
            weight = factorial(n) * factorial(causes - n - 1) / factorial(causes)
            for s in combinations(rest, n):
                total = total + weight * (known[frozenset({*s, i})] - known[frozenset(s)])
        shares.append(total)
    first = np.stack([known[frozenset({i})] for i in range(causes)]) if causes else np.zeros(0)
    last = np.stack([known[whole] - known[whole - {i}] for i in range(causes)]) if causes else first
    return Split(np.stack(shares) if causes else first, first, last)


def additive(gap: FloatArray, components: Sequence[FloatArray]) -> FloatArray:
    """Shapley values (causes, ...) of fixed components of a gap: `c_i (2 d - sum c)`."""
    rest = 2.0 * gap - sum(components, np.zeros_like(gap))
    return np.stack([each * rest for each in components])
