r"""Coloured noise of residuals, block by block: its model, its fit, and what whitens it.

The noise of a channel is a first-order Markov process, a random walk and white noise,

    x[k] = phi x[k-1] + v,   d[k] = d[k-1] + w,   r[k] = x[k] + d[k] + e

so that a Kalman filter whitens it. The walk stands for drift and heat soak.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import percentile_filter
from scipy.optimize import nnls
from scipy.stats import chi2

from narxcal.support.arrays import FloatArray
from narxcal.support.compiled import compiled

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


@compiled(exact=False)
def _ahead(spread: FloatArray, phi: float, markov: float, walk: float) -> FloatArray:
    """Covariance (x x, x d, d d) one block later."""
    return np.array([phi**2 * spread[0] + markov, phi * spread[1], spread[2] + walk])


@compiled(exact=False)
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


@compiled(exact=False)
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
