r"""The budget: which cause takes how much of the gap's energy, by Shapley values.

What a set S of causes takes is `v(S) = |d|^2 - |d - sum_S c_i|^2`, each channel over its range
squared, where the component c_i is what a cause does in a flight by the joint fit to the others
(`joint`). A cause's share is the mean of what it adds over all orders in which causes enter, for
fixed components

    c_i' (2 d - sum c);    c_i' (2 d - c_i) where it enters first, and last c_i' (2 r + c_i)

with r = d - sum c. Components fitted for each set anew would let differences of build, which mimic
every effect, take a third of what an effect does.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from narxcal.support.arrays import FloatArray


@dataclass(frozen=True, eq=False)
class Split:
    """What each cause takes, (causes, ...): on the mean of all orders, first, and last."""

    shares: FloatArray
    first: FloatArray
    last: FloatArray


def split(gap: FloatArray, components: Sequence[FloatArray]) -> Split:
    """Split the squared `gap` (...) between fixed `components` of it, sample by sample."""
    parts = np.stack(components)
    rest = gap - parts.sum(axis=0)
    return Split(parts * (gap + rest), parts * (2.0 * gap - parts), parts * (2.0 * rest + parts))
