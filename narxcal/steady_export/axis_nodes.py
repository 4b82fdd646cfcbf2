"""The best nodes of one axis: those that leave the smallest error of linear interpolation.

A curve sampled at `M` candidates is to be read off by straight lines between `n` of them. The
worst error is that of the worst segment, so the best choice follows from a shortest path over
segments (dynamic programming; Bellman 1961, Communications of the ACM 4(6), on the
approximation of curves by line segments).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numba import njit
from numpy.typing import NDArray

from narxcal.steady_state import Floats

_MOST = 64


@dataclass(frozen=True, eq=False)
class AxisNodes:
    """Best nodes of an axis for each number of them.

    `errors[k]` is the worst error with `k` segments (infinite where the nodes asked for do
    not allow it), `before[k, j]` the node before candidate `j` on the best way to it.
    """

    candidates: Floats
    errors: Floats
    before: NDArray[np.int64]

    @property
    def fewest(self) -> int:
        """The smallest number of segments that holds all nodes asked for."""
        return int(np.flatnonzero(np.isfinite(self.errors))[0])

    def finer(self, segments: int) -> int | None:
        """The next number of segments with a smaller error, None where there is none."""
        better = np.flatnonzero(self.errors[segments:] < self.errors[segments] * (1.0 - 1e-9))
        return segments + int(better[0]) if len(better) else None

    def nodes(self, segments: int) -> Floats:
        """The best nodes for `segments`: `(segments + 1,)`."""
        place = len(self.candidates) - 1
        path = [place]
        for count in range(segments, 0, -1):
            place = int(self.before[count, place])
            path.append(place)
        return self.candidates[path[::-1]]


def best_nodes(candidates: Floats, values: Floats, asked: Sequence[float]) -> AxisNodes:
    """Plan an axis from curves `values` (M, curves) at `candidates` (M,).

    The nodes `asked` for are always among the chosen.
    """
    error = segment_errors(candidates, values)
    for place in np.flatnonzero(np.isin(candidates, asked)):
        error[:place, place + 1 :] = np.inf
    count = min(len(candidates) - 1, _MOST)
    worst = np.full((count + 1, len(candidates)), np.inf)
    before = np.zeros(worst.shape, dtype=np.int64)
    worst[0, 0] = 0.0
    for segments in range(1, count + 1):
        through = np.maximum(worst[segments - 1][:, None], error)
        before[segments] = through.argmin(axis=0)
        worst[segments] = through.min(axis=0)
    return AxisNodes(candidates, worst[:, -1], before)


def segment_errors(candidates: Floats, values: Floats) -> Floats:
    """Worst error (M, M) of the straight line from candidate i to candidate j, inf for j <= i."""
    found: Floats = _run(candidates, np.ascontiguousarray(values))
    return found


def _errors(candidates: Floats, values: Floats) -> Floats:
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


_run: Any = njit(cache=True, nogil=True)(_errors)


def curves(
    function: Callable[[Floats], Floats], others: Floats, column: int, candidates: Floats
) -> Floats:
    """Sample `function` `(n, axes) -> (n, n_out)` along one column: (M, lines * n_out).

    `others` (lines, axes) says where the other inputs stand.
    """
    points = np.repeat(others[None], len(candidates), axis=0)
    points[:, :, column] = candidates[:, None]
    found = function(points.reshape(-1, others.shape[1]))
    return found.reshape(len(candidates), -1)


def grow(
    axes: Mapping[str, AxisNodes], others: int, goal: float, most: int
) -> tuple[dict[str, int], Literal["size", "nodes"] | None]:
    """Refine the axis with the largest error until all errors together are at most `goal`.

    `others` are the rows that the axes not refined multiply by, `most` the rows allowed.
    Returns the segments of each axis and, where the goal was not reached, whether the `size`
    or the lack of further `nodes` was the reason.
    """
    segments = {name: axis.fewest for name, axis in axes.items()}
    open_axes, too_many = set(axes), False

    def error(name: str) -> float:
        return float(axes[name].errors[segments[name]])

    while sum(map(error, axes)) > goal:
        if not open_axes:
            return segments, "size" if too_many else "nodes"
        name = max(sorted(open_axes), key=error)
        finer = axes[name].finer(segments[name])
        tried = {**segments, name: finer or 0}
        rows = others * int(np.prod([count + 1 for count in tried.values()], dtype=np.int64))
        if finer is None or rows > most:
            open_axes.remove(name)
            too_many = too_many or finer is not None
        else:
            segments = tried
    return segments, None
