"""Searches residuals for a shift that is on or off: the shift and the on/off paths, in turn."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from narxcal.support.arrays import FloatArray
from training.gap.blocks import (
    Blocks,
    centred,
    common_shift,
    drawn_anew,
    settled,
    sharpest_edges,
)
from training.gap.coloured_noise import Gains, Noise, colour, fit_noise, gains, whiten
from training.gap.switching import best_path

_EULER = 0.5772


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

    def samples(self, dt_s: float) -> int:
        """Samples of a block."""
        return max(1, round(self.block_s / dt_s))


@dataclass(frozen=True, eq=False)
class Search:
    """A shift (channels,), its paths (flights, blocks), and what they gain over none."""

    shift: FloatArray
    paths: NDArray[np.int8]
    gain: float


def refined(blocks: Blocks, options: Options) -> tuple[Noise, Search]:
    """Search, then again with the noise that is left once the windows found are taken out."""
    noise = fit_noise(blocks.residual, blocks.share)
    best = search(blocks, noise, options)
    for _ in range(2):
        if best.gain <= 0.0:
            break
        blocks = centred(blocks, best.paths)
        rest = blocks.residual - (best.paths == 1)[..., None] * best.shift
        noise = fit_noise(rest, settled(blocks.share, best.paths))
        best = search(blocks, noise, options, [best.shift])
    return noise, best


def search(
    blocks: Blocks, noise: Noise, options: Options, starts: Sequence[FloatArray] | None = None
) -> Search:
    """The best of all starts."""
    found = gains(noise, blocks.share)
    if starts is None:
        starts = sharpest_edges(blocks, noise, options.starts)
        if options.rising is not None:
            starts = [-start if start[options.rising] < 0.0 else start for start in starts]
    none = np.zeros(blocks.residual.shape[:2], dtype=np.int8)
    best = Search(np.zeros(blocks.residual.shape[2]), none, 0.0)
    plain = _walk(replace(blocks, switch=np.inf), best.shift, found, noise)[0]
    for start in starts:
        tried = _climb(blocks, (noise, found, plain), start, options)
        if tried.gain > best.gain:
            best = tried
    return best


def _climb(
    blocks: Blocks, known: tuple[Noise, Gains, float], shift: FloatArray, options: Options
) -> Search:
    """Path and shift in turn, until the path stays."""
    noise, found, plain = known
    best = Search(shift, np.zeros(blocks.residual.shape[:2], dtype=np.int8), 0.0)
    for _ in range(options.rounds):
        total, paths = _walk(blocks, shift, found, noise)
        if plain - total <= best.gain:
            break
        same = np.array_equal(paths, best.paths)
        best = Search(shift, paths, plain - total)
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


def gains_in_noise(blocks: Blocks, noise: Noise, best: Search, options: Options) -> list[float]:
    """Search noise of this colour, made of what the windows leave, `draws` times."""
    random = np.random.default_rng(options.seed)
    rest = centred(blocks, best.paths).residual - (best.paths == 1)[..., None] * best.shift
    share = settled(blocks.share, best.paths)
    innovations = whiten(rest, gains(noise, share), noise)
    found = gains(noise, blocks.share)
    made = []
    for _ in range(options.draws):
        drawn = drawn_anew(innovations, share, random)
        one = replace(blocks, residual=colour(drawn, found, noise))
        one = centred(one, np.zeros_like(best.paths))
        made.append(search(one, fit_noise(one.residual, one.share), options).gain)
    return made


def rarely_reached(values: Sequence[float], level: float, least: float = 0.0) -> float:
    """What is exceeded with probability `level`, by Gumbel's law of at least scale `least`."""
    scale = max(float(np.std(values)) * np.sqrt(6.0) / np.pi, least)
    return float(np.mean(values) + scale * (-np.log(-np.log1p(-level)) - _EULER))
