"""Residuals in blocks of about a second, and what can be read off them: edges, levels, shifts."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from narxcal.support.arrays import FloatArray
from training.gap.coloured_noise import FOLLOW, Noise, gains, whiten
from training.gap.switching import trusted

EDGE = 8  # blocks on either side of an edge that say how large it is
_DRAWN = 60  # blocks that are drawn together
_REWEIGHTED = 8


@dataclass(frozen=True, eq=False)
class Blocks:
    """Means `residual` over blocks and the `share` known, (flights, blocks, channels).

    Flights of one of the `groups` share their windows; `switch` is what a change costs.
    """

    residual: FloatArray
    share: FloatArray
    groups: tuple[tuple[int, ...], ...]
    switch: float


def blocks_of(
    residual: FloatArray, known: FloatArray, size: int, groups: tuple[tuple[int, ...], ...]
) -> Blocks:
    """Means over blocks of `size` samples, weighted by `known`, less the median of each flight.

    A flight in none of the `groups` stands alone.
    """
    flights, steps, channels = residual.shape
    count = steps // size
    shape = (flights, count, size, channels)
    value = np.where(known > 0.0, residual, 0.0)[:, : count * size].reshape(shape)
    weight = known[:, : count * size].reshape(shape)
    total = weight.sum(axis=2)
    mean = (value * weight).sum(axis=2) / np.where(total > 0.0, total, 1.0)
    share = (weight > 0.0).mean(axis=2)
    share[share < 0.5] = 0.0
    taken = [f for group in groups for f in group]
    alone = tuple((f,) for f in range(flights) if f not in taken)
    heard = int(np.count_nonzero(share.any(axis=2)))
    switch = 2.0 * math.log(max(2, heard)) + channels
    blocks = Blocks(mean, share, (*groups, *alone), switch)
    return centred(blocks, np.zeros((flights, count), dtype=np.int8))


def centred(blocks: Blocks, paths: NDArray[np.int8]) -> Blocks:
    """Less the median of what is off, per flight and channel."""
    residual = blocks.residual.copy()
    for f, c in np.ndindex(residual.shape[0], residual.shape[2]):
        off = (paths[f] == 0) & (blocks.share[f, :, c] > 0.0)
        if off.any():
            residual[f, :, c] -= np.median(residual[f, off, c])
    residual[blocks.share == 0.0] = 0.0
    return replace(blocks, residual=residual)


def settled(share: FloatArray, paths: NDArray[np.int8]) -> FloatArray:
    """The share known, none where a change is under way."""
    return np.where((paths < 0)[..., None], 0.0, share)


def common_shift(
    blocks: Blocks, paths: NDArray[np.int8], noise: Noise
) -> tuple[FloatArray, FloatArray]:
    """Shift (channels,) of all windows together by least squares, and its standard deviation."""
    whole, shape = whitened(blocks, paths, (paths == 1)[..., None], noise)
    inverse: FloatArray = np.linalg.inv(noise.correlation).astype(np.float64)
    shift = np.zeros(whole.shape[2])
    trust = np.ones(whole.shape[:2])
    for _ in range(_REWEIGHTED):
        weight = trust[..., None] * shape
        shift = (weight * whole).sum(axis=(0, 1)) / np.maximum(
            (weight * shape).sum(axis=(0, 1)), 1e-12
        )
        rest = whole - shape * shift
        trust = trusted(rest, inverse)
    gram = np.maximum((trust[..., None] * shape**2).sum(axis=(0, 1)), 1e-12)
    spread = (trust[..., None] ** 2 * shape**2 * rest**2).sum(axis=(0, 1))
    return shift, np.sqrt(np.maximum(spread, gram)) / gram


def whitened(
    blocks: Blocks, paths: NDArray[np.int8], shape: NDArray[np.bool_], noise: Noise
) -> tuple[FloatArray, FloatArray]:
    """Residual and a shape (flights, blocks, 1) through the noise's filter, edges left out."""
    found = gains(noise, settled(blocks.share, paths))
    spread = np.broadcast_to(shape, blocks.residual.shape).astype(np.float64)
    return whiten(blocks.residual, found, noise), whiten(spread, found, noise)


def sharpest_edges(blocks: Blocks, noise: Noise, count: int) -> list[FloatArray]:
    """Shifts (channels,) at the sharpest edges of all flights, at most `count`."""
    found: list[tuple[float, FloatArray]] = []
    steps = [_contrast(blocks, list(group)) for group in blocks.groups]
    scale = 1.4826 * np.nanmedian(np.abs(np.concatenate(steps)), axis=0)
    inverse = np.linalg.inv(noise.correlation)
    for step in steps:
        known = np.asarray(np.isfinite(step).all(axis=1))
        z = np.where(known[:, None], step, 0.0) / np.maximum(scale, 1e-12)
        size = np.einsum("kc,cd,kd->k", z, inverse, z)
        for _ in range(count):
            k = int(np.argmax(size))
            if size[k] > 0.0:
                found.append((float(size[k]), step[k]))
            size[max(0, k - EDGE // 2) : k + EDGE // 2 + 1] = 0.0
    found.sort(key=lambda pair: -pair[0])
    return [step for _, step in found[:count]]


def _contrast(blocks: Blocks, rows: list[int]) -> FloatArray:
    """Mean over the blocks after less that over the blocks before, (blocks, channels)."""
    share = blocks.share[rows]
    value = np.cumsum(np.pad(blocks.residual[rows] * share, ((0, 0), (1, 0), (0, 0))), axis=1)
    known = np.cumsum(np.pad(share, ((0, 0), (1, 0), (0, 0))), axis=1)
    last = share.shape[1]
    at = np.arange(last)
    after = (np.minimum(at + FOLLOW, last), np.minimum(at + FOLLOW + EDGE, last))
    before = (np.maximum(at - EDGE, 0), at)
    means = []
    for low, high in (after, before):
        count = known[:, high] - known[:, low]
        enough = np.where(count >= 0.4 * EDGE, count, np.nan)
        means.append((value[:, high] - value[:, low]) / enough)
    return np.asarray((means[0] - means[1]).mean(axis=0))


def moment(residual: FloatArray, known: FloatArray, where: tuple[int, int, int]) -> int:
    """Sample of the change under way from a block on, of a `size`; it shows half at `half` later.

    The least squares step between the levels before and after, over all flights and channels.
    """
    block, size, half = where
    first, last = block * size, (block + FOLLOW) * size
    if first <= 0:
        return 0
    end: int = residual.shape[1]
    if last >= end:
        return end
    before, after = (
        slice(max(0, first - EDGE * size // 2), first),
        slice(last, last + EDGE * size // 2),
    )
    middle = slice(first, last)
    levels = [_level(residual[:, part], known[:, part]) for part in (before, after)]
    toward = np.nan_to_num(levels[1] - levels[0])[:, None]
    away = np.where(
        known[:, middle] > 0.0, residual[:, middle] - np.nan_to_num(levels[0])[:, None], 0.0
    )
    weight = known[:, middle]
    gone = (weight * away**2).sum(axis=(0, 2))
    left = (weight * (away - toward) ** 2).sum(axis=(0, 2))
    price = np.concatenate([[0.0], np.cumsum(gone)]) + np.concatenate(
        [np.cumsum(left[::-1])[::-1], [0.0]]
    )
    if not np.ptp(price) > 0.0:
        return (first + last) // 2
    least = int(np.argmin(price))
    changed: int = first + least - half
    return max(0, changed)


def _level(residual: FloatArray, known: FloatArray) -> FloatArray:
    """Weighted mean (flights, channels) over time, NaN where nothing is known."""
    total = known.sum(axis=1)
    return np.asarray(
        np.where(known > 0.0, residual * known, 0.0).sum(axis=1)
        / np.where(total > 0.0, total, np.nan)
    )


def drawn_anew(
    innovations: FloatArray, share: FloatArray, random: np.random.Generator
) -> FloatArray:
    """Blocks of innovations of any flight at any time, each with a random sign."""
    flights, count, _ = innovations.shape
    pool = innovations[np.asarray((share > 0.0).all(axis=2))]
    drawn = np.empty_like(innovations)
    for f in range(flights):
        for k in range(0, count, _DRAWN):
            size = min(_DRAWN, count - k)
            at = (int(random.integers(len(pool))) + np.arange(size)) % len(pool)
            drawn[f, k : k + size] = random.choice((-1.0, 1.0)) * pool[at]
    return drawn
