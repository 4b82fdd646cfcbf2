"""Noise of a gap at moves of the lever and at rest: there it is loud, here it is quiet.

Where a lever moves, an error of the simulator's dynamics is in the gap, and the level after it may
be another. How much louder that makes the noise is taken from the gap itself, over how fast the
driver moves or moved a moment ago.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.stats import chi2

from narxcal.effects.running import Flights
from narxcal.support.arrays import FloatArray
from training.gap.coloured_noise import Noise, fit_noise, gains, whiten

_FADE_S = 3.0  # how long a move is heard
_REST = 1e-4  # of the driver's range a second: slower is no move
_BINS, _FEW = 10, 10  # of the blocks by how the driver moves, and too few of them
_QUANTILE, _LEAST = 0.7, 0.5
_ROUNDS = 2


def restless(flights: Flights, size: int) -> FloatArray:
    """How fast the driver moves or just moved, (flights, blocks) of `size` samples.

    As shares of its range in a second, on a logarithmic scale.
    """
    signals = flights.signals
    driver = flights.u[..., signals.u(signals.driver)]
    blocks, block_s = driver.shape[1] // size, size * signals.dt_s
    span = max(signals.lever[1] - signals.lever[0], 1e-9)
    way = np.abs(np.diff(driver, axis=1, prepend=driver[:, :1])) / span
    rate = way[:, : blocks * size].reshape(len(way), blocks, size).sum(axis=2) / block_s
    fade = np.exp(-block_s / _FADE_S)
    for k in range(1, blocks):
        rate[:, k] = np.maximum(rate[:, k], fade * rate[:, k - 1])
    return np.asarray(np.log(rate + _REST))


def noise_at_moves(rest: FloatArray, share: FloatArray, moving: FloatArray) -> Noise:
    """Noise of what is left (flights, blocks, channels), louder where it is `moving`.

    `share` has its shape and is 0 where nothing is known; `moving` (flights, blocks) as of
    `restless`.
    """
    noise = fit_noise(rest, share)
    noise = replace(noise, loud=np.ones(share.shape[:2]))
    for _ in range(_ROUNDS):
        innovations = whiten(rest, gains(noise, share), noise)
        noise = replace(noise, loud=noise.loud * _loudness(innovations, share, moving))
    return noise


def _loudness(innovations: FloatArray, share: FloatArray, moving: FloatArray) -> FloatArray:
    """Upper quantile of innovations of blocks that move alike against that of normal ones.

    (flights, blocks); what moves more is no quieter.
    """
    known = (share > 0.0).all(axis=2)
    size = np.sqrt((innovations[known] ** 2).sum(axis=1))
    order = np.argsort(moving[known], kind="stable")
    if len(order) < _BINS * _FEW:
        return np.ones(share.shape[:2])
    parts = np.array_split(order, _BINS)
    middle = [float(np.median(moving[known][part])) for part in parts]
    normal = np.sqrt(chi2.ppf(_QUANTILE, innovations.shape[2]))
    loud = [max(float(np.quantile(size[part], _QUANTILE)) / normal, _LEAST) for part in parts]
    return np.interp(moving, middle, np.maximum.accumulate(loud))
