"""Finds when an unlogged load or bleed was on, and what it shifts.

What a switch leaves in the residual is one shift of several channels at once, the same in every
window, with sharp edges. Everything else there is noise with colour: drift, heat soak, the rest of
lever moves. So the shift is taken from the sharpest edges in turn, the best on/off path under it
is found (`switching`), the shift is estimated again from that path, and so on; the start that
explains most is kept. It counts if it explains more than the same search finds in noise of the
same colour, made from the residual's own innovations with blocks of them drawn at random.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import minimum_filter1d
from scipy.stats import binom

from narxcal.support.arrays import FloatArray, spans
from narxcal.support.errors import DataError
from training.gap.blocks import EDGE, Blocks, blocks_of
from training.gap.coloured_noise import FOLLOW
from training.gap.path_windows import Searched, Windows, no_windows, told
from training.gap.window_search import Options, gains_in_noise, rarely_reached, refined

_SEEN_EDGES, _BY_CHANCE = 2, 0.1  # least edges at rest; how rarely as many are hidden by chance


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
    blocks = blocks_of(residual, known, options.samples(dt_s), options.groups)
    silent = no_windows(residual)
    if _too_little(blocks):
        return silent
    noise, best = refined(blocks, options)
    best = replace(best, paths=_merged(best.paths, options))
    if best.gain <= 0.0:
        return silent
    by_chance = gains_in_noise(blocks, noise, best, options)
    threshold = rarely_reached(by_chance, options.level, 0.5 * blocks.switch)
    if best.gain <= threshold or (options.at_rest and _with_the_lever(best.paths, blocks)):
        return replace(silent, gain=best.gain, threshold=threshold)
    return told(residual, known, dt_s, Searched(blocks, noise, best, threshold, options))


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


def _merged(paths: NDArray[np.int8], options: Options) -> NDArray[np.int8]:
    """On throughout where it is off between two windows for less than the shortest one."""
    merged = paths.copy()
    for row in merged:
        for (_, stop), (start, _) in pairwise(spans(row == 1)):
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
        for start, stop in spans(path == 1):
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
