"""A shift in coloured noise that is on or off: the best path of on and off, block by block.

The noise is that of `coloured_noise`: where much of it is a random walk, only the edges of a window
tell, not how the level is between them. The path is found by dynamic programming in which each
state carries the filter of its best path (per-survivor processing, Raheli, Polydoros and Tzou,
*IEEE Trans. Commun.* 43, 1995). Innovations cost what Student's t says, for a lever move that the
mask missed must not look like a switch. While the engine takes up a change it may be anywhere on
its way.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from narxcal.support.arrays import FloatArray
from narxcal.support.compiled import compiled
from training.gap.coloured_noise import FOLLOW, Gains, Noise

FREEDOM = 4.0  # of Student's t


def cost(innovations: FloatArray, noise: Noise) -> FloatArray:
    """What Student's t says (flights, blocks) of innovations (flights, blocks, channels)."""
    inverse = np.linalg.inv(noise.correlation)
    square = ((innovations @ inverse) * innovations).sum(axis=2)
    return np.asarray((FREEDOM + innovations.shape[2]) * np.log1p(square / FREEDOM))


def trusted(innovations: FloatArray, inverse: FloatArray) -> FloatArray:
    """Weights (flights, blocks) of least squares at which Student's t is most likely, 1 at 0."""
    square = np.einsum("fbc,cd,fbd->fb", innovations, inverse, innovations)
    return np.asarray(FREEDOM / (FREEDOM + square))


def best_path(
    residual: FloatArray, shift: FloatArray, found: Gains, noise: Noise, switch: float
) -> tuple[float, NDArray[np.int8]]:
    """Cost and best on/off path (blocks,) of flights that share it; -1 while a change goes on.

    `residual` (flights, blocks, channels) and `found` are those of the flights that share it,
    `shift` (channels,) is what being on adds, `switch` what a change costs.
    """
    filters = (found.gain, found.variance, found.late_gain, found.late_variance)
    inverse: FloatArray = np.linalg.inv(noise.correlation).astype(np.float64)
    total, came = _paths(residual, shift, filters, (noise.phi, inverse), switch)
    total[1] += switch  # and will be switched off
    last = int(total[1] < total[0])
    path, k, on = np.zeros(residual.shape[1], dtype=np.int8), residual.shape[1] - 1, last
    while k >= 0:
        path[k] = on
        if came[on, k]:
            path[k - FOLLOW : k] = -1
            k, on = k - FOLLOW, 1 - on
        k -= 1
    return float(total[last]), path


@compiled(exact=False)
def _price(z: FloatArray, inverse: FloatArray) -> float:
    """Student's t of the innovations (channels,) of one block of one flight."""
    square = 0.0
    for c in range(len(z)):
        for d in range(len(z)):
            square += z[c] * inverse[c, d] * z[d]
    return (FREEDOM + len(z)) * math.log1p(square / FREEDOM)


@compiled(exact=False)
def _under_way(z: FloatArray, toward: FloatArray, inverse: FloatArray) -> float:
    """The same where the engine is anywhere on its way, a share of `toward` (channels,)."""
    along = across = 0.0
    for c in range(len(z)):
        for d in range(len(z)):
            along += toward[c] * inverse[c, d] * z[d]
            across += toward[c] * inverse[c, d] * toward[d]
    share = min(1.0, max(0.0, along / across)) if across > 0.0 else 0.0
    return _price(z - share * toward, inverse)


@compiled(exact=False)
def _jump(
    told: FloatArray,
    shift: FloatArray,
    level: FloatArray,
    late: FloatArray,
    model: tuple[FloatArray, FloatArray],
) -> float:
    """Cost of FOLLOW blocks under way and the first one after, `told` (FOLLOW + 1, channels).

    Later blocks are known less well, for nothing has been heard since the last one; what that
    takes off the likelihood is in the cost, else any outlier would be cheaper as a change.

    `level` (channels, 2) is the filter's last one; `late` (2, FOLLOW + 1, channels) are variances
    then, and without a change.
    """
    phi, inverse = model
    total, x = 0.0, level[:, 0].copy()
    for j in range(FOLLOW + 1):
        for c in range(told.shape[1]):
            if np.isfinite(late[0, j, c]):
                total += math.log(late[0, j, c] / late[1, j, c])
    for j in range(FOLLOW):
        x = x * phi
        deviation = np.sqrt(late[0, j])
        total += _under_way((told[j] - x - level[:, 1]) / deviation, shift / deviation, inverse)
    arrived = told[FOLLOW] - shift - phi * x - level[:, 1]
    return total + _price(arrived / np.sqrt(late[0, FOLLOW]), inverse)


@compiled(exact=False)
def _paths(
    residual: FloatArray,
    shift: FloatArray,
    filters: tuple[FloatArray, FloatArray, FloatArray, FloatArray],
    model: tuple[FloatArray, FloatArray],
    switch: float,
) -> tuple[FloatArray, NDArray[np.int8]]:
    """Cost of either last state, and whether the best path came to (state, block) by a change."""
    gain, variance, late_gain, late_variance = filters
    phi, inverse = model
    flights, blocks, channels = residual.shape
    level = np.zeros((2, blocks + 1, flights, channels, 2))  # of the block before, thus one more
    total = np.zeros((2, blocks + 1))
    total[1, 0] = switch  # what is on at the start was switched on, too
    came = np.zeros((2, blocks), dtype=np.int8)
    sign = np.array([-1.0, 1.0])
    variances = np.stack((late_variance, variance))
    for k in range(blocks):
        first = k - FOLLOW
        for on in range(2):
            away, stay, jump = 1 - on, total[on, k], np.inf
            for f in range(flights):
                z = (
                    residual[f, k]
                    - on * shift
                    - phi * level[on, k, f, :, 0]
                    - level[on, k, f, :, 1]
                )
                stay += _price(z / np.sqrt(variance[f, k]), inverse)
            if first > 0:
                jump = total[away, first] + switch
                for f in range(flights):
                    told = residual[f, first : k + 1] - away * shift
                    late = variances[:, f, first : k + 1]
                    jump += _jump(told, sign[on] * shift, level[away, first, f], late, model)
            total[on, k + 1] = min(stay, jump)
            came[on, k] = jump < stay
            for f in range(flights):
                before, g, fade = level[on, k, f], gain[f, k], phi
                if jump < stay:
                    before, g, fade = level[away, first, f], late_gain[f, k], phi ** (FOLLOW + 1)
                x, d = fade * before[:, 0], before[:, 1]
                rest = residual[f, k] - on * shift - x - d
                level[on, k + 1, f, :, 0] = x + g[:, 0] * rest
                level[on, k + 1, f, :, 1] = d + g[:, 1] * rest
    return total[:, -1], came
