"""Finds when an unlogged load or bleed was on, and what it shifts.

What a switch leaves in the residual is one shift of several channels at once, the same in every
window, with sharp edges. Everything else there is noise with colour: drift, heat soak, the rest of
lever moves. So the shift is taken from the sharpest edges in turn, the best on/off path under it
is found (`switching`), the shift is estimated again from that path, and so on; the start that
explains most is kept. It counts if it explains more than the same search finds in noise of the
same colour, made from the residual's own innovations with blocks of them drawn at random.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from narxcal.errors import DataError
from training.gap.blocks import (
    EDGE,
    Blocks,
    blocks_of,
    centred,
    common_shift,
    drawn_anew,
    moment,
    settled,
    sharpest_edges,
    whitened,
)
from training.gap.finding import Interval
from training.gap.switching import (
    FOLLOW,
    FloatArray,
    Gains,
    Noise,
    best_path,
    colour,
    cost,
    fit_noise,
    gains,
    whiten,
)

_Z90 = 1.645
_HALF_S = 0.7  # from a switch to half of its effect (narxcal.effects.steady)
_EULER = 0.5772
_CHI90 = 2.71  # of chi squared with one degree of freedom
_SEEN = 150  # blocks to either side in which an edge may lie
_TAKEN = np.array([0.37, 0.77, 0.92])  # mean share of a change in the blocks that follow it


@dataclass(frozen=True)
class Options:
    """How windows are sought.

    `groups` are rows of flights that share their windows, as the engines of one aircraft do; a
    flight in no group stands alone. `rising` is a channel that being on raises, such as a
    temperature; without it, on is what there is less of. A claim has to exceed what happens in
    noise with probability `level`, known from `draws` searches. With `at_rest`, most edges have to
    lie where the residual is known before and after; that is not to be asked where the driver is
    fuel flow, which a load moves itself.
    """

    groups: tuple[tuple[int, ...], ...] = ()
    rising: int | None = None
    at_rest: bool = True
    shortest_s: float = 5.0
    block_s: float = 1.0
    level: float = 0.01
    draws: int = 24
    starts: int = 6
    rounds: int = 4
    seed: int = 0


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


@dataclass(frozen=True, eq=False)
class _Search:
    """A shift (channels,), its paths (flights, blocks), and what they gain over none."""

    shift: FloatArray
    paths: NDArray[np.int8]
    gain: float


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
    size = max(1, round(options.block_s / dt_s))
    blocks = blocks_of(residual, known, size, options.groups)
    silent = _nothing(residual)
    if blocks.residual.shape[1] < 4 * EDGE or not (blocks.share > 0.0).any():
        return silent
    noise, best = _refined(blocks, options)
    best = replace(best, paths=_merged(best.paths, options))
    if best.gain <= 0.0:
        return silent
    threshold = _threshold(blocks, noise, best, options)
    if best.gain <= threshold or (options.at_rest and _mostly_hidden(best.paths, blocks)):
        return replace(silent, gain=best.gain, threshold=threshold)
    return _told(residual, known, dt_s, (blocks, noise, best, threshold, options))


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


def _refined(blocks: Blocks, options: Options) -> tuple[Noise, _Search]:
    """Search, then again with the noise that is left once the windows found are taken out."""
    noise = fit_noise(blocks.residual, blocks.share)
    best = _search(blocks, noise, options)
    for _ in range(2):
        if best.gain <= 0.0:
            break
        blocks = centred(blocks, best.paths)
        rest = blocks.residual - (best.paths == 1)[..., None] * best.shift
        noise = fit_noise(rest, settled(blocks.share, best.paths))
        best = _search(blocks, noise, options, [best.shift])
    return noise, best


def _merged(paths: NDArray[np.int8], options: Options) -> NDArray[np.int8]:
    """On throughout where it is off between two windows for less than the shortest one."""
    merged = paths.copy()
    for row in merged:
        for (_, stop), (start, _) in pairwise(_runs(row)):
            off = np.count_nonzero(row[stop:start] == 0)
            if off * options.block_s < options.shortest_s:
                row[stop:start] = 1
    return merged


def _mostly_hidden(paths: NDArray[np.int8], blocks: Blocks) -> bool:
    """Whether most edges lie next to blocks of which nothing is known.

    A load is switched at any time. What comes and goes with moves of the lever is an error that
    depends on power.
    """
    seen, hidden = 0, 0
    for group in blocks.groups:
        path = paths[group[0]]
        heard: NDArray[np.bool_] = np.all(blocks.share[list(group)] > 0.0, axis=(0, 2))
        for start, stop in _runs(path):
            zones = [k for k in (start - FOLLOW, stop) if 0 < k < len(path) - FOLLOW]
            clear = [bool(heard[max(0, k - FOLLOW) : k + 2 * FOLLOW].all()) for k in zones]
            seen, hidden = seen + sum(clear), hidden + len(clear) - sum(clear)
    return seen <= hidden


def _search(
    blocks: Blocks, noise: Noise, options: Options, starts: Sequence[FloatArray] | None = None
) -> _Search:
    """The best of all starts."""
    found = gains(noise, blocks.share)
    if starts is None:
        starts = sharpest_edges(blocks, noise, options.starts)
        if options.rising is not None:
            starts = [-start if start[options.rising] < 0.0 else start for start in starts]
    none = np.zeros(blocks.residual.shape[:2], dtype=np.int8)
    best = _Search(np.zeros(blocks.residual.shape[2]), none, 0.0)
    plain = _walk(replace(blocks, switch=np.inf), best.shift, found, noise)[0]
    for start in starts:
        tried = _climb(blocks, (noise, found, plain), start, options)
        if tried.gain > best.gain:
            best = tried
    return best


def _climb(
    blocks: Blocks, known: tuple[Noise, Gains, float], shift: FloatArray, options: Options
) -> _Search:
    """Path and shift in turn, until the path stays."""
    noise, found, plain = known
    best = _Search(shift, np.zeros(blocks.residual.shape[:2], dtype=np.int8), 0.0)
    for _ in range(options.rounds):
        total, paths = _walk(blocks, shift, found, noise)
        if plain - total <= best.gain:
            break
        same = np.array_equal(paths, best.paths)
        best = _Search(shift, paths, plain - total)
        if same or not (paths == 1).any():
            break
        shift = common_shift(blocks, paths, noise)[0]
        shift, paths = _signed(shift, paths, blocks, options.rising)
        best = replace(best, shift=shift, paths=paths)
    return best


def _signed(
    shift: FloatArray, paths: NDArray[np.int8], blocks: Blocks, rising: int | None
) -> tuple[FloatArray, NDArray[np.int8]]:
    """On and off change places where on would be the rule, or lower what it has to raise."""
    known = blocks.share.any(axis=2)
    rule = (paths == 1)[known].sum() > (paths == 0)[known].sum()
    if rule if rising is None else shift[rising] < 0.0:
        return -shift, np.where(paths >= 0, 1 - paths, paths).astype(np.int8)
    return shift, paths


def _walk(
    blocks: Blocks, shift: FloatArray, found: Gains, noise: Noise
) -> tuple[float, NDArray[np.int8]]:
    """Cost and path (flights, blocks) of all groups."""
    total, paths = 0.0, np.zeros(blocks.residual.shape[:2], dtype=np.int8)
    for group in blocks.groups:
        rows = list(group)
        part = Gains(*(getattr(found, name)[rows] for name in Gains.__dataclass_fields__))
        price, path = best_path(blocks.residual[rows], shift, part, noise, blocks.switch)
        total += price
        paths[rows] = path
    return total, paths


def _threshold(blocks: Blocks, noise: Noise, best: _Search, options: Options) -> float:
    """Gain that noise of this colour reaches with probability `level` (Gumbel's law)."""
    random = np.random.default_rng(options.seed)
    rest = centred(blocks, best.paths).residual - (best.paths == 1)[..., None] * best.shift
    share = settled(blocks.share, best.paths)
    innovations = whiten(rest, gains(noise, share), noise)
    found = gains(noise, blocks.share)
    reached = []
    for _ in range(options.draws):
        drawn = drawn_anew(innovations, share, random)
        made = replace(blocks, residual=colour(drawn, found, noise))
        made = centred(made, np.zeros_like(best.paths))
        reached.append(_search(made, fit_noise(made.residual, made.share), options).gain)
    scale = max(float(np.std(reached)) * np.sqrt(6.0) / np.pi, 0.5 * blocks.switch)
    return float(np.mean(reached) + scale * (-np.log(-np.log1p(-options.level)) - _EULER))


_All = tuple[Blocks, Noise, _Search, float, Options]


def _told(residual: FloatArray, known: FloatArray, dt_s: float, found: _All) -> Windows:
    """Windows on the raster, with their own shifts."""
    blocks, noise, best, threshold, options = found
    blocks = centred(blocks, best.paths)
    shift, deviation = common_shift(blocks, best.paths, noise)
    on, windows = np.zeros(residual.shape[:2]), []
    size = max(1, round(options.block_s / dt_s))
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
