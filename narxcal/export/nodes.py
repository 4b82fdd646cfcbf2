"""The fewest nodes between which straight lines follow a function within a tolerance."""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Callable, Sequence

import numpy as np

from narxcal.support.arrays import FloatArray
from narxcal.support.compiled import compiled


def candidates(nodes: Sequence[float], most: int) -> FloatArray:
    """Candidates for nodes: `nodes` and round numbers between them, at most about `most`."""
    low, high = nodes[0], nodes[-1]
    step = _round_up((high - low) / most)
    between = step * np.arange(math.ceil(low / step), math.floor(high / step) + 1)
    # Multiples of 0.01 as they are written, without the rounding error of 7 * 0.01.
    between = np.array([float(f"{value:.9g}") for value in between])
    apart = np.abs(between[:, None] - np.array(nodes)).min(axis=1) > 0.3 * step
    return np.union1d(np.array(nodes), between[apart])


def _round_up(step: float) -> float:
    power = 10.0 ** math.floor(math.log10(step))
    return next(m * power for m in (1.0, 2.0, 2.5, 5.0, 10.0) if m * power >= step * (1.0 - 1e-9))


def fewest_nodes(candidates: FloatArray, errors: FloatArray, allowed: float) -> FloatArray:
    """Fewest of candidates (M,) between which no straight line is off by more than `allowed`.

    Of as many nodes, those with the smallest error. `errors` (M, M) are those of `segment_errors`,
    infinite across a node that has to be there.
    """
    path = _shortest(errors, allowed)
    levels = np.unique(errors[errors <= allowed])
    best = bisect_left(levels, -len(path), key=lambda level: -len(_shortest(errors, level)))
    return candidates[_shortest(errors, levels[best])]


def _shortest(errors: FloatArray, allowed: float) -> list[int]:
    """Shortest path over segments (Bellman 1961, Communications of the ACM 4(6))."""
    count, before = np.zeros(len(errors)), [0] * len(errors)
    for place in range(1, len(errors)):
        steps = np.where(errors[:place, place] <= allowed, count[:place], np.inf)
        before[place] = int(steps.argmin())
        count[place] = steps[before[place]] + 1.0
    path = [len(errors) - 1]
    while path[-1]:
        path.append(before[path[-1]])
    return path[::-1]


@compiled
def segment_errors(candidates: FloatArray, values: FloatArray) -> FloatArray:
    """Largest error (M, M) of the straight line from candidate i to candidate j, inf for j <= i."""
    count, width = values.shape
    error = np.full((count, count), np.inf)
    for low in range(count - 1):
        for high in range(low + 1, count):
            worst = 0.0
            for between in range(low + 1, high):
                share = candidates[between] - candidates[low]
                share /= candidates[high] - candidates[low]
                for k in range(width):
                    line = values[low, k] + share * (values[high, k] - values[low, k])
                    worst = max(worst, abs(values[between, k] - line))
            error[low, high] = worst
    return error


def curves(
    function: Callable[[FloatArray], FloatArray],
    others: FloatArray,
    column: int,
    candidates: FloatArray,
) -> FloatArray:
    """Sample `function` `(n, axes) -> (n, n_out)` along one column: (M, lines * n_out).

    `others` (lines, axes) are the values of the other inputs.
    """
    points = np.repeat(others[None], len(candidates), axis=0)
    points[:, :, column] = candidates[:, None]
    found = function(points.reshape(-1, others.shape[1]))
    return found.reshape(len(candidates), -1)
