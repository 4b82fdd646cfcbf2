r"""When a load was switched: how likely every moment is, by what the gap does before and after.

Of a gap in blocks, less what each flight may have for itself, a switch at time s leaves

    r[k] = shift size sign share(k - s) + noise[k]

with noise that is coloured, and loud where the lever moves (`load_noise`); so a move hides a
switch as far as it hides the level, and the interval says how far. The size of each change is its
own, near that of all of them. How an engine and its sensors take up a load is the same at every
edge, and these edges together tell which of some shapes it is. A Kalman filter whitens noise and
shape alike; innovations cost what Student's t says.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.special import logsumexp

from narxcal.effects.steady import FOLLOW_S
from narxcal.support.arrays import FloatArray
from training.gap.coloured_noise import Gains, Noise, gains, whiten
from training.gap.load_noise import noise_at_moves
from training.gap.switching import cost

_TAIL = 0.05  # on either side of an interval
_STEP_S, _COARSE_S = 0.1, 1.0  # between moments that are tried
_MANY = 60  # moments of the second look
_AFTER_S, _AROUND_S = 30.0, 3.0  # what tells of a change after it; second look beyond the first
_UNLIKELY = 12.0  # of the logarithm: not looked at again
_FAST_S = 1e-3
# Two lags in a row that an engine and its sensors may be, s.
_LAGS = (
    *((first, _FAST_S) for first in (0.3, 0.7, 1.2, 2.0, 3.5, 6.0, 10.0)),
    *((first, 0.5 * first) for first in (0.7, 1.2, 2.0, 3.5, 6.0)),
)
_PLAIN = ((FOLLOW_S, _FAST_S),)
_SHARED = 0.7  # how likely an edge has the shape of the others
_UNSURE = 0.2  # of its lags: standard deviation of what a shape leaves open
_SIZES, _SIZE_SD = np.array([0.5, 0.75, 1.0, 1.25, 1.5]), 0.3  # of one change, in shifts

Lags = Sequence[tuple[float, float]]


class Change(NamedTuple):
    """A change of all flights in `rows`, up (1) or down (-1): about `at_s`, surely in between."""

    rows: tuple[int, ...]
    at_s: float
    sign: float
    low_s: float
    high_s: float


class Moment(NamedTuple):
    """When a change was: a 90 % interval and its middle, in seconds."""

    low_s: float
    at_s: float
    high_s: float


@dataclass(frozen=True, eq=False)
class Heard:
    """Mean of the gap (flights, blocks, channels) in blocks of `block_s`, known to a `share`.

    `begin` (flights,) is 1 where the load is on from the start, `shift` (channels,) what it adds.
    """

    mean: FloatArray
    share: FloatArray
    begin: FloatArray
    shift: FloatArray
    block_s: float


class _Filter(NamedTuple):
    """What whitens the gap, and the path (flights, blocks) that is thought of."""

    noise: Noise
    found: Gains
    path: FloatArray


class _Likely(NamedTuple):
    """Log likelihoods (lags, moments, sizes) of the moments `tried` (moments,)."""

    tried: FloatArray
    table: FloatArray


def moments(heard: Heard, changes: Sequence[Change], moving: FloatArray) -> list[Moment]:
    """When each of the changes was; `moving` (flights, blocks) is how restless the driver is."""
    if not changes:
        return []
    path = _path(heard, changes)
    noise = noise_at_moves(heard.mean - path[..., None] * heard.shift, heard.share, moving)
    model = _Filter(noise, gains(noise, heard.share), path)
    likely = [_likely(heard, model, each) for each in changes]
    shapes = sum((logsumexp(each.table, axis=(1, 2)) for each in likely), np.zeros(len(_LAGS)))
    end = heard.block_s * heard.mean.shape[1]
    return [Moment(*np.clip(_quantiles(each, shapes), 0.0, end).tolist()) for each in likely]


def _quantiles(likely: _Likely, shapes: FloatArray) -> FloatArray:
    """Low, middle and high (3,) over all sizes and shapes.

    `shapes` (lags,) are the log likelihoods by all edges.
    An edge may have a shape of its own, as at idle, where an engine is slow. What begins slowly
    by less than is modelled, or a sensor's delay, is no error of the noise: it goes with the lag.
    """
    shared = np.exp(shapes - logsumexp(shapes))
    alone = logsumexp(likely.table, axis=2)
    alone += np.log(_SHARED * shared + (1.0 - _SHARED) / len(shared))[:, None]
    share = np.exp(alone - alone.max())
    lag = float(share.sum(axis=1) @ np.sum(_LAGS, axis=1)) / float(share.sum())
    step = likely.tried[1] - likely.tried[0]
    spread = _spread(share.sum(axis=0), _UNSURE * lag / step)
    upto = np.concatenate([[0.0], np.cumsum(spread / spread.sum())])
    edges = likely.tried[0] + step * (np.arange(len(upto)) - 0.5 * len(spread))
    edges += 0.5 * step * (len(likely.tried) - 1)
    return np.asarray(np.interp([_TAIL, 0.5, 1.0 - _TAIL], upto, edges))


def _spread(share: FloatArray, deviation: float) -> FloatArray:
    """Shares of equal steps with a normal error of `deviation` steps, longer on either side."""
    reach = int(np.ceil(3.0 * deviation))
    error = np.exp(-0.5 * (np.arange(-reach, reach + 1) / max(deviation, 1e-9)) ** 2)
    return np.asarray(np.convolve(share, error))


def _path(heard: Heard, changes: Sequence[Change]) -> FloatArray:
    """Share of the load in every block, (flights, blocks)."""
    path = np.repeat(heard.begin[:, None], heard.mean.shape[1], axis=1)
    for change in changes:
        path[list(change.rows)] += _step(heard, change)
    return path


def _step(heard: Heard, change: Change) -> FloatArray:
    ends = heard.block_s * np.arange(1, heard.mean.shape[1] + 1)
    return change.sign * taken(ends - change.at_s, _PLAIN[0], heard.block_s)


def taken(since: FloatArray, lags: tuple[float, float], width: float) -> FloatArray:
    """Mean share of a change in blocks of `width` s that end `since` s after it, of two lags."""

    def area(time: FloatArray) -> FloatArray:
        """Integral of the step response of two lags in a row."""
        one, two = (lag**2 * -np.expm1(-time / lag) for lag in lags)
        return np.asarray(time - (one - two) / (lags[0] - lags[1]))

    return (area(np.maximum(since, 0.0)) - area(np.maximum(since - width, 0.0))) / width


def _likely(heard: Heard, model: _Filter, change: Change) -> _Likely:
    """All moments at first, then more closely those that are not out of the question."""
    last = heard.block_s * heard.mean.shape[1]
    low, high = max(change.low_s, 0.0), min(change.high_s, last)
    tried = np.arange(low + 0.5 * _COARSE_S, max(high, low + 2.0 * _COARSE_S), _COARSE_S)
    total = logsumexp(_tables(heard, model, change, tried, _PLAIN), axis=(0, 2))
    near = tried[total > total.max() - _UNLIKELY]
    first, end = max(low, near[0] - _AROUND_S), min(last, near[-1] + _AROUND_S)
    step = max(_STEP_S, (end - first) / _MANY)
    closely = np.arange(first, end + 0.5 * step, step)
    return _Likely(closely, _tables(heard, model, change, closely, _LAGS))


def _tables(
    heard: Heard, model: _Filter, change: Change, tried: FloatArray, lags: Lags
) -> FloatArray:
    """Log likelihood (lags, moments, sizes) of a change at the moments `tried`."""
    begin = int(tried[0] / heard.block_s)
    end = min(heard.mean.shape[1], int((tried[-1] + _AFTER_S) / heard.block_s) + 1)
    end = min(end, max(int(change.high_s / heard.block_s), begin + 1))
    ends = heard.block_s * np.arange(begin + 1, end + 1)
    table = np.tile(-0.5 * ((_SIZES - 1.0) / _SIZE_SD) ** 2, (len(lags), len(tried), 1))
    for f in change.rows:
        before = heard.mean[f] - (model.path[f] - _step(heard, change))[:, None] * heard.shift
        own = Gains(*(each[[f]] for each in model.found.__dict__.values()))
        noise = model.noise.of([f])
        without = whiten(before[None], own, noise)[:, begin:end]
        for j, each in enumerate(lags):
            shape = taken(ends - tried[:, None], each, heard.block_s)
            answer = _answers(shape, own, noise, begin) * (change.sign * heard.shift)
            for k, size in enumerate(_SIZES):
                table[j, :, k] -= 0.5 * cost(without - size * answer, noise).sum(axis=1)
    return table


def _answers(shape: FloatArray, own: Gains, noise: Noise, begin: int) -> FloatArray:
    """What the filter of one flight makes of shapes (moments, blocks) of size 1 from `begin` on."""
    count, blocks = shape.shape
    parts = (each[:, begin : begin + blocks] for each in own.__dict__.values())
    same = Gains(*(np.repeat(each, count, axis=0) for each in parts))
    channels = len(noise.phi)
    return whiten(np.repeat(shape[..., None], channels, axis=2), same, noise)
