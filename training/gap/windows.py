"""Finds when an unlogged load or bleed was on, and what it shifts.

What a switch leaves in the residual is one shift of several channels at once, the same in every
window, with sharp edges. Everything else there is noise with colour: drift, heat soak, the rest of
lever moves. So the shift is taken from the sharpest edges in turn, the best on/off path under it
is found (`switching`), the shift is estimated again from that path, and so on; the start that
explains most is kept. It counts if it explains more than the same search finds in noise of the
same colour, made from the residual's own innovations with blocks of them drawn at random.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import minimum_filter1d
from scipy.stats import binom

from narxcal.errors import DataError
from training.gap.blocks import (
    EDGE,
    Blocks,
    blocks_of,
    centred,
    common_shift,
    moment,
    whitened,
)
from training.gap.finding import Interval
from training.gap.switching import (
    FOLLOW,
    FloatArray,
    Noise,
    cost,
    fit_noise,
    gains,
    whiten,
)
from training.gap.window_search import (
    Null,
    Options,
    Search,
    nulls,
    rarely_reached,
    refined,
    search,
)

__all__ = ["Options", "Window", "Windows", "find_windows", "windows_of_shift"]
_Z90 = 1.645
_HALF_S = 0.7  # from a switch to half of its effect (narxcal.effects.steady)
_CHI90 = 2.71  # of chi squared with one degree of freedom
_SEEN = 150  # blocks to either side in which an edge may lie
_SEEN_EDGES, _BY_CHANCE = 2, 0.1  # least edges at rest; how rarely as many are hidden by chance
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
    it has to exceed. Where there is nothing, `on` is 0 throughout and `found` is empty. `nulls` are
    the searches of noise that the threshold comes from.
    """

    on: FloatArray
    found: tuple[Window, ...]
    shift: tuple[Interval, ...]
    gain: float
    threshold: float
    nulls: tuple[Null, ...] = ()


def find_windows(
    residual: FloatArray,
    weights: FloatArray,
    dt_s: float,
    options: Options | None = None,
    steady: NDArray[np.bool_] | None = None,
) -> Windows:
    """Find the windows in `residual`, recorded less simulated, (flights, time, outputs).

    `weights` of its shape are 0 where nothing is known; `steady` (flights, time) is False where
    the engine is moving and the residual is not to be trusted. Raises `DataError` where shapes
    differ or a weighted sample is not finite.
    """
    options = options or Options()
    known = _checked(residual, weights, steady)
    blocks = blocks_of(residual, known, _size(options, dt_s), options.groups)
    silent = _nothing(residual)
    if _too_little(blocks):
        return silent
    noise, best = refined(blocks, options)
    best = replace(best, paths=_merged(best.paths, options))
    if best.gain <= 0.0:
        return silent
    made = nulls(blocks, noise, best, options)
    threshold = rarely_reached([null.gain for null in made], options.level, 0.5 * blocks.switch)
    if best.gain <= threshold or (options.at_rest and _with_the_lever(best.paths, blocks)):
        return replace(silent, gain=best.gain, threshold=threshold)
    told = _told(residual, known, dt_s, (blocks, noise, best, threshold, options))
    return replace(told, nulls=tuple(made))


def windows_of_shift(
    residual: FloatArray,
    weights: FloatArray,
    dt_s: float,
    shift: FloatArray,
    more: tuple[Options, NDArray[np.bool_]],
) -> Windows:
    """Windows in which `residual` shows a `shift` (outputs,) that is known from elsewhere.

    `more` are options and where the engine is steady. What explains more than its switches cost
    is told; raises as `find_windows`.
    """
    options, steady = more
    known = _checked(residual, weights, steady)
    blocks = blocks_of(residual, known, _size(options, dt_s), options.groups)
    silent = _nothing(residual)
    if _too_little(blocks):
        return silent
    once = replace(options, rounds=1, rising=None)
    noise = fit_noise(blocks.residual, blocks.share)
    best = search(blocks, noise, once, [shift])
    if best.gain <= 0.0:
        return silent
    best = Search(shift, _merged(best.paths, options), best.gain)
    return _told(residual, known, dt_s, (blocks, noise, best, 0.0, options))


def _size(options: Options, dt_s: float) -> int:
    return max(1, round(options.block_s / dt_s))


def _too_little(blocks: Blocks) -> bool:
    return blocks.residual.shape[1] < 4 * EDGE or not (blocks.share > 0.0).any()


def _checked(
    residual: FloatArray, weights: FloatArray, steady: NDArray[np.bool_] | None
) -> FloatArray:
    """Weights, none where the engine moves."""
    if residual.ndim != 3 or weights.shape != residual.shape:
        raise DataError(
            "expected residual and weights of one shape (flights, time, outputs), found "
            f"{residual.shape} and {weights.shape}"
        )
    if steady is not None and steady.shape != residual.shape[:2]:
        raise DataError(f"expected steady {residual.shape[:2]}, found {steady.shape}")
    known = weights if steady is None else np.where(steady[..., None], weights, 0.0)
    if not np.isfinite(residual[known > 0.0]).all():
        raise DataError("the residual is not finite at samples of positive weight")
    return known


def _nothing(residual: FloatArray) -> Windows:
    none = tuple(Interval(0.0, 0.0, 0.0) for _ in range(residual.shape[2]))
    return Windows(np.zeros(residual.shape[:2]), (), none, 0.0, 0.0)


def _merged(paths: NDArray[np.int8], options: Options) -> NDArray[np.int8]:
    """On throughout where it is off between two windows for less than the shortest one."""
    merged = paths.copy()
    for row in merged:
        for (_, stop), (start, _) in pairwise(_runs(row)):
            off = np.count_nonzero(row[stop:start] == 0)
            if off * options.block_s < options.shortest_s:
                row[stop:start] = 1
    return merged


def _with_the_lever(paths: NDArray[np.int8], blocks: Blocks) -> bool:
    """Whether more edges than by chance lie next to blocks of which nothing is known.

    A load is switched at any time. What comes and goes with moves of the lever is an error that
    depends on power, or on how the engine gets there.
    """
    edges, hidden, chance = 0, 0, []
    for group in blocks.groups:
        path = paths[group[0]]
        heard: NDArray[np.bool_] = np.all(blocks.share[list(group)] > 0.0, axis=(0, 2))
        clear = minimum_filter1d(heard, 3 * FOLLOW, origin=FOLLOW - 3 * FOLLOW // 2)
        for start, stop in _runs(path):
            zones = [k for k in (start - FOLLOW, stop) if 0 < k < len(path) - FOLLOW]
            edges += len(zones)
            hidden += sum(not clear[k] for k in zones)
        chance.append(~clear[: _last(heard)])
    expected = float(np.mean(np.concatenate(chance))) if chance else 0.0
    if edges - hidden < _SEEN_EDGES:
        return True
    return bool(binom.sf(hidden - 1, edges, expected) < _BY_CHANCE)


def _last(heard: NDArray[np.bool_]) -> int:
    """One more than the last block of which anything is known."""
    return int(np.flatnonzero(heard).max(initial=0)) + 1


_All = tuple[Blocks, Noise, Search, float, Options]


def _told(residual: FloatArray, known: FloatArray, dt_s: float, found: _All) -> Windows:
    """Windows on the raster, with their own shifts."""
    blocks, noise, best, threshold, options = found
    blocks = centred(blocks, best.paths)
    shift, deviation = common_shift(blocks, best.paths, noise)
    on, windows = np.zeros(residual.shape[:2]), []
    size = _size(options, dt_s)
    for group in blocks.groups:
        for first, last in _runs(best.paths[group[0]]):
            rows = list(group)
            half = round(_HALF_S / dt_s)
            start = moment(residual[rows], known[rows], (first - FOLLOW, size, half))
            stop = moment(residual[rows], known[rows], (last, size, half))
            if (stop - start) * dt_s < options.shortest_s:
                continue
            on[rows, start:stop] = 1.0
            told = [_window(blocks, best.paths, noise, (f, first, last)) for f in rows]
            model = (shift, noise.of(rows))
            where = [_span(blocks, best.paths, (rows, edge), model) for edge in (first, last)]
            ends = [(low * options.block_s, high * options.block_s) for low, high in where]
            spans = _around(ends[0], start * dt_s), _around(ends[1], stop * dt_s)
            windows += [
                Window(f, start * dt_s, stop * dt_s, own, score, *spans)
                for f, (own, score) in zip(rows, told, strict=True)
            ]
    if not windows:
        return replace(_nothing(residual), gain=best.gain, threshold=threshold)
    common = _intervals(shift, deviation)
    return Windows(on, tuple(windows), common, best.gain, threshold)


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


def _runs(path: NDArray[np.int8]) -> list[tuple[int, int]]:
    """First and last but one block of each run of on."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], path == 1, [0]])))
    return list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))
