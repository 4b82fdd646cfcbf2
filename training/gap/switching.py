r"""Coloured noise with a shift that is on or off: the noise's own model, and the best on/off path.

The noise of a channel is a first-order Markov process, a random walk and white noise,

    x[k] = phi x[k-1] + v,   d[k] = d[k-1] + w,   r[k] = x[k] + d[k] + shift on[k] + e

so that a Kalman filter whitens it. The walk stands for drift and heat soak: where there is much of
it, only the edges of a window tell, not how the level is between them. The path `on` is found by
dynamic programming in which each state carries the filter of its best path (per-survivor
processing, Raheli, Polydoros and Tzou, *IEEE Trans. Commun.* 43, 1995). Innovations cost what
Student's t says, for a lever move that the mask missed must not look like a switch. While the
engine takes up a change it may be anywhere on its way.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import percentile_filter
from scipy.optimize import nnls
from scipy.stats import chi2

from narxcal.kernels import compiled

FloatArray = NDArray[np.float64]
FREEDOM = 4.0  # of Student's t
FOLLOW = 3  # blocks in which the engine takes up a change
_TAUS = np.geomspace(3.0, 48.0, 9)  # blocks
_LAGS = (1, 2, 3, 5, 8, 13, 21, 34, 55, 89, 144)
_DIFFUSE = 100.0  # of a channel's variance, for a level that nothing is known about
_QUANTILE, _NEAR = 0.7, 61  # blocks
_LEAST = 1e-4  # of a channel's noise: no component is less


@dataclass(frozen=True, eq=False)
class Noise:
    """Of each channel, `(channels,)`: `phi` per block, and the variances of v, w and e.

    `correlation` (channels, channels) is that of the innovations, `loud` (flights, blocks) how much
    the noise's deviation is there against the rule: manoeuvres are loud, cruise is quiet.
    """

    phi: FloatArray
    markov: FloatArray
    walk: FloatArray
    white: FloatArray
    correlation: FloatArray
    loud: FloatArray

    def of(self, rows: Sequence[int]) -> Noise:
        """The noise of some of the flights."""
        return replace(self, loud=self.loud[list(rows)])


@dataclass(frozen=True, eq=False)
class Gains:
    """Kalman gains (flights, blocks, channels, 2) and variances of the innovations, one axis less.

    `late_gain` and `late_variance` hold for a block before which FOLLOW blocks were left out;
    where nothing is known gains are 0 and variances infinite.
    """

    gain: FloatArray
    variance: FloatArray
    late_gain: FloatArray
    late_variance: FloatArray


def fit_noise(residual: FloatArray, share: FloatArray) -> Noise:
    """Fit to `residual` (flights, blocks, channels), known where `share` is positive.

    The robust variogram, half the square of 1.48 median |r[k+h] - r[k]|, hardly sees rare steps.
    """
    channels = residual.shape[2]
    found = np.array([_one_channel(residual[..., c], share[..., c] > 0.0) for c in range(channels)])
    phi, markov, walk, white = found.T.copy()
    noise = Noise(phi, markov, walk, white, np.eye(channels), np.ones(residual.shape[:2]))
    loud = _loudness(whiten(residual, gains(noise, share), noise), share)
    noise = replace(noise, loud=loud)
    innovations = whiten(residual, gains(noise, share), noise)
    bounded = np.clip(innovations[(share > 0.0).all(axis=-1)], -2.5, 2.5)
    if len(bounded) < 10 * channels:
        return noise
    correlation = np.corrcoef(bounded.T).reshape(channels, channels)
    # Half of it is believed: a combination of channels that happens to be quiet proves little.
    half = 0.5 * (np.nan_to_num(correlation) + np.eye(channels))
    return replace(noise, correlation=half)


def _loudness(innovations: FloatArray, share: FloatArray) -> FloatArray:
    """Upper quantile of the innovations near each block against that of normal ones, at least half.

    A quantile hardly sees the few blocks of an edge.
    """
    loud, channels = np.ones(share.shape[:2]), share.shape[2]
    normal = np.sqrt(chi2.ppf(_QUANTILE, channels))
    for f in range(len(loud)):
        known = (share[f] > 0.0).all(axis=1)
        if np.count_nonzero(known) < 2:
            continue
        size = np.sqrt((innovations[f, known] ** 2).sum(axis=1))
        local = percentile_filter(size, 100.0 * _QUANTILE, size=_NEAR, mode="nearest") / normal
        where = np.flatnonzero(known)
        loud[f] = np.interp(np.arange(len(loud[f])), where, np.maximum(local, 0.5))
    return loud


def _one_channel(values: FloatArray, known: NDArray[np.bool_]) -> tuple[float, float, float, float]:
    """Phi and the variances of v, w and e that fit the variogram best, relative to its values."""
    lags, gamma = [], []
    for lag in _LAGS:
        both = known[:, lag:] & known[:, :-lag]
        if np.count_nonzero(both) >= 30:
            steps = (values[:, lag:] - values[:, :-lag])[both]
            lags.append(lag)
            gamma.append(0.5 * (1.4826 * float(np.median(np.abs(steps)))) ** 2)
    if not lags or not max(gamma) > 0.0:
        return 0.0, 1e-12, 1e-12, 1e-12
    h, measured = np.array(lags), np.maximum(np.array(gamma), 1e-6 * max(gamma))
    best, chosen = np.inf, (0.0, np.zeros(3))
    for tau in _TAUS:
        shapes = np.stack([1.0 - np.exp(-h / tau), 0.5 * h, np.ones(len(h))], axis=1)
        amount, error = nnls(shapes / measured[:, None], np.ones(len(h)))
        if error < best:
            best, chosen = error, (float(np.exp(-1.0 / tau)), amount)
    phi, (markov, walk, white) = chosen
    least = _LEAST * float(measured[0])
    return phi, max((1.0 - phi**2) * markov, least), max(walk, least), max(white, least)


def gains(noise: Noise, share: FloatArray) -> Gains:
    """Run the Riccati recursion over blocks; `share` (flights, blocks, channels) of each is known.

    Fewer samples make a block noisier. Gains depend on what is known, not on values or path.
    """
    model = np.stack([noise.phi, noise.markov, noise.walk, noise.white])
    return Gains(*_riccati(share, model, noise.loud**2))


@compiled
def _ahead(spread: FloatArray, phi: float, markov: float, walk: float) -> FloatArray:
    """Covariance (x x, x d, d d) one block later."""
    return np.array([phi**2 * spread[0] + markov, phi * spread[1], spread[2] + walk])


@compiled
def _riccati(
    share: FloatArray, model: FloatArray, loud: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    flights, blocks, channels = share.shape
    gain, late_gain = np.zeros((2, flights, blocks, channels, 2))
    variance, late_variance = np.full((2, flights, blocks, channels), np.inf)
    for f in range(flights):
        for c in range(channels):
            phi, markov, walk, white = model[:, c]
            rest = markov * loud[f, 0] / (1.0 - phi**2)
            start = np.array([rest, 0.0, _DIFFUSE * (rest + white * loud[f, 0])])
            after = np.empty((blocks, 3))
            for k in range(blocks):
                v, w, e = markov * loud[f, k], walk * loud[f, k], white * loud[f, k]
                ahead = start if k == 0 else _ahead(after[k - 1], phi, v, w)
                late = start if k <= FOLLOW else after[k - 1 - FOLLOW]
                for _ in range(FOLLOW + 1):
                    late = _ahead(late, phi, v, w)
                after[k] = ahead
                if share[f, k, c] > 0.0:
                    on = np.array([ahead[0] + ahead[1], ahead[1] + ahead[2]])
                    variance[f, k, c] = on[0] + on[1] + e / share[f, k, c]
                    gain[f, k, c] = on / variance[f, k, c]
                    after[k, 0] -= gain[f, k, c, 0] * on[0]
                    after[k, 1] -= gain[f, k, c, 0] * on[1]
                    after[k, 2] -= gain[f, k, c, 1] * on[1]
                    on = np.array([late[0] + late[1], late[1] + late[2]])
                    late_variance[f, k, c] = on[0] + on[1] + e / share[f, k, c]
                    late_gain[f, k, c] = on / late_variance[f, k, c]
    return gain, variance, late_gain, late_variance


def whiten(values: FloatArray, found: Gains, noise: Noise) -> FloatArray:
    """Innovations of `values` (flights, blocks, channels) in standard deviations, 0 if unknown."""
    return _filtered(values, (found.gain, np.sqrt(found.variance)), noise.phi, undo=False)


def colour(innovations: FloatArray, found: Gains, noise: Noise) -> FloatArray:
    """Undo `whiten`: noise with these innovations, 0 where unknown."""
    return _filtered(innovations, (found.gain, np.sqrt(found.variance)), noise.phi, undo=True)


@compiled
def _filtered(
    values: FloatArray, filters: tuple[FloatArray, FloatArray], phi: FloatArray, undo: bool
) -> FloatArray:
    gain, deviation = filters
    flights, blocks, channels = values.shape
    out = np.zeros_like(values)
    for f in range(flights):
        for c in range(channels):
            x = d = 0.0
            for k in range(blocks):
                x *= phi[c]
                if np.isfinite(deviation[f, k, c]):
                    innovation = values[f, k, c] - x - d
                    out[f, k, c] = innovation / deviation[f, k, c]
                    if undo:
                        innovation = values[f, k, c] * deviation[f, k, c]
                        out[f, k, c] = x + d + innovation
                    x += gain[f, k, c, 0] * innovation
                    d += gain[f, k, c, 1] * innovation
    return out


def cost(innovations: FloatArray, noise: Noise) -> FloatArray:
    """What Student's t says (flights, blocks) of innovations (flights, blocks, channels)."""
    inverse = np.linalg.inv(noise.correlation)
    square = np.einsum("fbc,cd,fbd->fb", innovations, inverse, innovations)
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


@compiled
def _price(z: FloatArray, inverse: FloatArray) -> float:
    """Student's t of the innovations (channels,) of one block of one flight."""
    square = 0.0
    for c in range(len(z)):
        for d in range(len(z)):
            square += z[c] * inverse[c, d] * z[d]
    return (FREEDOM + len(z)) * math.log1p(square / FREEDOM)


@compiled
def _under_way(z: FloatArray, toward: FloatArray, inverse: FloatArray) -> float:
    """The same where the engine is anywhere on its way, a share of `toward` (channels,)."""
    along = across = 0.0
    for c in range(len(z)):
        for d in range(len(z)):
            along += toward[c] * inverse[c, d] * z[d]
            across += toward[c] * inverse[c, d] * toward[d]
    share = min(1.0, max(0.0, along / across)) if across > 0.0 else 0.0
    return _price(z - share * toward, inverse)


@compiled
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


@compiled
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
