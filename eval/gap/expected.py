r"""How far the gap is expected to shrink on other flights, before what was recorded there is seen.

On the flights at hand the effects take `before - left` of the squared gap, each flight by what the
others give. Further flights may be like these, or have more of what the effects do, and then more
of the gap that they explain: what they change there follows from the inputs, and what they leave
comes at some rate per sample, so that

    share = moved / (moved + rest),   moved = change' * sum(before - left) / sum(change)

and `rest` is the rate of what is left, times the samples. Which of the two holds, or how much of
either, is told by flights that are predicted by the others, as is the interval: in the logarithm of
what is left, which no effect makes less than nothing and other misfit can make any amount of.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations
from typing import NamedTuple

import numpy as np
from scipy.stats import t

from eval.gap.data import GapData
from eval.gap.realised import pooled_share, squares
from narxcal.support.arrays import FloatArray
from training.budget.result import Interval
from training.gap.quadratic import TOLERANCE

_AT_ONCE = 2  # flights that are predicted by the others
_LEVEL = 0.95  # of Student's distribution: a 90 % interval
_FINE = 0.1  # of the gap: a share that is added to what is left, so that little is as good as none
_NONE = 1e-9


class Sums(NamedTuple):
    """Sums of squares over the noise's per flight, (flights,) each.

    `before` and `left` are of the gap above the noise without and with effects, `change` of what
    they do to the outputs, `samples` how many are known.
    """

    before: FloatArray
    left: FloatArray
    change: FloatArray
    samples: FloatArray

    def of(self, rows: Sequence[int]) -> Sums:
        """Those of some of the flights."""
        return Sums(*(each[list(rows)] for each in self))


class Other(NamedTuple):
    """What is known of flights unseen, (flights,) each: see `Sums`."""

    change: FloatArray
    samples: FloatArray


def seen(data: GapData, after: FloatArray, by_others: FloatArray | None) -> Sums:
    """Sum up flight by flight what `after` (flights, time, outputs) changes and leaves.

    With `by_others` added it is what the parameters do that the other flights give: what each
    flight would have left if it had taken no part.
    """
    unfitted = after if by_others is None else after + by_others
    return Sums(*squares(data, unfitted), *unseen(data, after))


def unseen(data: GapData, after: FloatArray) -> Other:
    """What `after` changes, and where anything was recorded, whatever that is."""
    known = np.isfinite(data.real)
    change = (after - data.flights.y) ** 2 / (data.noise**2 + (TOLERANCE * data.span) ** 2)
    samples = known.sum(axis=(1, 2)).astype(np.float64)
    return Other(np.sum(change, axis=(1, 2), where=known), samples)


def expected(found: Sums, other: Other | None = None) -> Interval:
    """Share of the squared gap that effects will take off flights unseen, with a 90 % interval.

    Flights that nothing is known of are like those they were `found` in. One flight says nothing of
    the scatter between them.
    """
    count = len(found.before)
    alike = _if_alike(found)
    if count < 2:
        return Interval(alike, -1.0, 1.0)
    tried, out = _by_others(found)
    true = _log_left(tried[:, 2])
    part = 0.0 if other is None else _part(*(tried[:, :2] - tried[:, 2:]).T)
    ways = np.array([alike, alike if other is None else _by_change(found, other)])
    many = _AT_ONCE if other is None else len(other.change)
    # Errors vary as the mean of the flights predicted, and as that of those that predict them; and
    # as the two ways do from their mixture.
    scatter = (1.0 / many + 1.0 / count) / (1.0 / out + 1.0 / (count - out))
    squared = [np.mean((_log_left(tried[:, way]) - true) ** 2) for way in (0, 1)]
    apart = float(np.ptp(_log_left(ways)))
    spread = scatter * ((1.0 - part) * squared[0] + part * squared[1])
    spread += part * (1.0 - part) * apart**2
    value = float((1.0 - part) * ways[0] + part * ways[1])
    return _within(value, float(t.ppf(_LEVEL, count - 1) * np.sqrt(spread)))


def _by_others(found: Sums) -> tuple[FloatArray, int]:
    """Shares (sets, 3) of sets of flights by the others in both ways, and true; size of a set."""
    count = len(found.before)
    out = min(_AT_ONCE, count - 1)
    rows = []
    for chosen in combinations(range(count), out):
        rest = found.of([f for f in range(count) if f not in chosen])
        one = found.of(chosen)
        there = Other(one.change, one.samples)
        rows.append((_if_alike(rest), _by_change(rest, there), _if_alike(one)))
    return np.array(rows), out


def _if_alike(found: Sums) -> float:
    """Share that is taken off these flights, and off any in which all is as in them."""
    return max(-1.0, pooled_share(found.before, found.left))


def _by_change(found: Sums, other: Other) -> float:
    """Share that is taken off flights in which the effects do what they do there."""
    taken = float((found.before - found.left).sum()) / max(float(found.change.sum()), _NONE)
    moved = taken * float(other.change.sum())
    rate = float(found.left.sum()) / max(float(found.samples.sum()), 1.0)
    whole = moved + max(rate * float(other.samples.sum()), 0.0)
    return float(np.clip(moved / max(whole, _NONE), -1.0, 1.0))


def _part(alike: FloatArray, by_change: FloatArray) -> float:
    """Part of the second prediction in the mixture of least squared errors (sets,)."""
    apart = by_change - alike
    return float(np.clip(-(alike @ apart) / max(float(apart @ apart), _NONE), 0.0, 1.0))


def _log_left(share: FloatArray) -> FloatArray:
    return np.asarray(np.log(1.0 - share + _FINE))


def _within(share: float, reach: float) -> Interval:
    """The share with the ends at which so much more or less is left."""
    left = 1.0 - share + _FINE
    low, high = (1.0 + _FINE - left * float(np.exp(way * reach)) for way in (1.0, -1.0))
    return Interval(share, max(-1.0, low), min(1.0, high))
