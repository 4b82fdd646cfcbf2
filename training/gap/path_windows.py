"""Windows that an on/off path of blocks stands for: when each began and ended, and its own shift.

A window's shift is estimated with all others of its flight fitted beside it. An edge that a lever
move hides may be anywhere in the blocks of which little is known; how far is told with it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from narxcal.support.arrays import FloatArray, spans
from training.budget.result import Interval
from training.gap.blocks import Blocks, centred, common_shift, moment, whitened
from training.gap.coloured_noise import FOLLOW, Noise, gains, whiten
from training.gap.switching import cost
from training.gap.window_search import Options, Search

_Z90 = 1.645
_HALF_S = 0.7  # from a switch to half of its effect (narxcal.effects.steady)
_CHI90 = 2.71  # of chi squared with one degree of freedom
_SEEN = 150  # blocks to either side in which an edge may lie
_TAKEN = np.array([0.37, 0.77, 0.92])  # mean share of a change in the blocks that follow it


@dataclass(frozen=True)
class Window:
    """One window of one flight, the shift of each output in it, and what it explains.

    `score` is twice the gain of the log likelihood by this window. `start_span_s` and
    `stop_span_s` hold the edges with 90 % probability; a lever move can hide one for long.
    """

    flight: int
    start_s: float
    stop_s: float
    shift: tuple[Interval, ...]
    score: float
    start_span_s: tuple[float, float]
    stop_span_s: tuple[float, float]


@dataclass(frozen=True, eq=False)
class Windows:
    """`on` (flights, time) is 1 within the windows; `shift` is that of all windows together.

    `gain` is twice the gain of the log likelihood less the price of the switches, `threshold` what
    it has to exceed. Where there is nothing, `on` is 0 throughout and `found` is empty.
    """

    on: FloatArray
    found: tuple[Window, ...]
    shift: tuple[Interval, ...]
    gain: float
    threshold: float


class Searched(NamedTuple):
    """What a search worked on and how, the best it found, and what that had to exceed."""

    blocks: Blocks
    noise: Noise
    best: Search
    threshold: float
    options: Options


def told(residual: FloatArray, known: FloatArray, dt_s: float, found: Searched) -> Windows:
    """Windows on the raster, with their own shifts.

    `residual` (flights, time, outputs) counts where `known`, of its shape, is positive.
    """
    blocks, noise, best, threshold, options = found
    blocks = centred(blocks, best.paths)
    shift, deviation = common_shift(blocks, best.paths, noise)
    on, windows = np.zeros(residual.shape[:2]), []
    size = options.samples(dt_s)
    for group in blocks.groups:
        for first, last in spans(best.paths[group[0]] == 1):
            rows = list(group)
            half = round(_HALF_S / dt_s)
            start = moment(residual[rows], known[rows], (first - FOLLOW, size, half))
            stop = moment(residual[rows], known[rows], (last, size, half))
            if (stop - start) * dt_s < options.shortest_s:
                continue
            on[rows, start:stop] = 1.0
            each = [_window(blocks, best.paths, noise, (f, first, last)) for f in rows]
            model = (shift, noise.of(rows))
            where = [_span(blocks, best.paths, (rows, edge), model) for edge in (first, last)]
            ends = [(low * options.block_s, high * options.block_s) for low, high in where]
            edges_s = _around(ends[0], start * dt_s), _around(ends[1], stop * dt_s)
            windows += [
                Window(f, start * dt_s, stop * dt_s, own, score, *edges_s)
                for f, (own, score) in zip(rows, each, strict=True)
            ]
    if not windows:
        return replace(no_windows(residual), gain=best.gain, threshold=threshold)
    common = _intervals(shift, deviation)
    return Windows(on, tuple(windows), common, best.gain, threshold)


def no_windows(residual: FloatArray) -> Windows:
    """Nothing found in a residual (flights, time, outputs)."""
    none = tuple(Interval(0.0, 0.0, 0.0) for _ in range(residual.shape[2]))
    return Windows(np.zeros(residual.shape[:2]), (), none, 0.0, 0.0)


def _window(
    blocks: Blocks, paths: NDArray[np.int8], noise: Noise, where: tuple[int, int, int]
) -> tuple[tuple[Interval, ...], float]:
    """Shift of one window of one flight, all others of it fitted beside, and what it explains."""
    f, first, last = where
    rows = [f]
    one = replace(blocks, residual=blocks.residual[rows], share=blocks.share[rows], groups=((0,),))
    shapes = [np.zeros((1, paths.shape[1], 1), dtype=np.bool_) for _ in range(2)]
    shapes[0][0, first:last] = True
    shapes[1][0, :, 0] = (paths[f] == 1) & ~shapes[0][0, :, 0]
    whole, own = whitened(one, paths[rows], shapes[0], noise.of(rows))
    others = whitened(one, paths[rows], shapes[1], noise.of(rows))[1]
    shift, deviation = np.zeros(whole.shape[2]), np.zeros(whole.shape[2])
    rest = whole.copy()
    for c in range(whole.shape[2]):
        design = np.stack([own[0, :, c], others[0, :, c]], axis=1)
        spread = np.linalg.pinv(design.T @ design)
        found = spread @ design.T @ whole[0, :, c]
        rest[0, :, c] -= design @ found
        heard = max(1, int(np.count_nonzero(whole[0, :, c])))
        variance = max(1.0, float((rest[0, :, c] ** 2).sum()) / heard)
        shift[c], deviation[c] = found[0], np.sqrt(spread[0, 0] * variance)
    without = cost(rest + own * shift, noise).sum()
    return _intervals(shift, deviation), float(without - cost(rest, noise).sum())


def _around(span: tuple[float, float], value: float) -> tuple[float, float]:
    return min(span[0], value), max(span[1], value)


def _span(
    blocks: Blocks,
    paths: NDArray[np.int8],
    where: tuple[list[int], int],
    model: tuple[FloatArray, Noise],
) -> tuple[int, int]:
    """Blocks between which a change of flights `rows` lies, the one that ends at block `edge`."""
    (rows, edge), (shift, noise) = where, model
    path = paths[rows[0]]
    on = (path == 1).astype(np.float64)
    if edge in (0, len(path)):
        return edge, edge
    # A change takes FOLLOW blocks; the search knows it by its end, or as off by its beginning.
    begin = edge - FOLLOW if path[edge] == 1 else edge
    after, before = float(path[edge] == 1), 1.0 - float(path[edge] == 1)
    found = gains(noise, blocks.share[rows])
    others = np.flatnonzero(path < 0)
    earlier, later = others[others < begin], others[others >= begin + FOLLOW]
    low = max(1, begin - _SEEN, int(earlier.max(initial=0)) + 1)
    high = min(len(path) - 1, begin + _SEEN, int(later.min(initial=len(path))))
    prices = []
    for k in range(low, high):
        moved = on.copy()
        moved[min(k, begin) : max(k, begin + FOLLOW)] = after if k <= begin else before
        moved[k : k + FOLLOW] = before + (after - before) * _TAKEN[: len(path) - k]
        rest = blocks.residual[rows] - moved[:, None] * shift
        prices.append(float(cost(whiten(rest, found, noise), noise).sum()))
    near = np.flatnonzero(np.array(prices) <= min(prices) + _CHI90)
    return low + int(near[0]), low + int(near[-1]) + 1


def _intervals(value: FloatArray, deviation: FloatArray) -> tuple[Interval, ...]:
    return tuple(
        Interval(float(v), float(v - _Z90 * s), float(v + _Z90 * s))
        for v, s in zip(value, deviation, strict=True)
    )
