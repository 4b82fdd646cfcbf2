r"""An unlogged load: an effect whose windows are latent.

A load or a bleed that no channel records is on (w = 1) or off in every block of about two seconds;
while it is on, every output is shifted by a_c. For given windows the shifts are linear, as those
of any other effect; for given shifts the windows of a flight are the best path of

    sum_t w_t l_t / 2 - log(n) / 2 (number of switches)

with l_t = sum_c (2 e_c a_c - a_c^2) / (tau V_c), e what the nuisances leave and
n = |e|^2 / (tau V) the effective samples of a flight, by Viterbi's recursion: a switch costs what
one parameter does by Schwarz's criterion. Both in turn, from several first guesses. Every switch
counts as a parameter where probabilities are made of it. Engines of one flight may be loaded
together: then their windows are one path, of which a switch counts once; what leaves less is found.
"""

from __future__ import annotations

from itertools import product
from math import log
from typing import Final

import numpy as np
from scipy.signal import lfilter

from narxcal.effects.operators import lag
from narxcal.effects.running import with_load
from narxcal.effects.steady import FOLLOW_S, UNLOGGED_SWITCH
from narxcal.support.arrays import BoolArray, FloatArray
from narxcal.support.compiled import compiled
from training.diagnosis.dictionary import Node
from training.diagnosis.fit import Frame, Single, Solved

_BLOCK_S: Final = 2.0  # about what an engine takes to follow, twice
_ROUNDS: Final = 6
_MOST: Final = 0.9  # of a flight: a load that is always on is a difference of build


def found(frame: Frame) -> list[Single]:
    """The likeliest windows of an unlogged load in a gap, fitted as any effect; empty without any.

    The windows are in `node.on` (flights, time).
    """
    alone = tuple(range(len(frame.record.gap)))
    blocks = _Blocks(frame)
    best: list[tuple[float, Single]] = []
    for groups in dict.fromkeys((alone, frame.record.group or alone)):
        blocks.groups = np.array(groups)
        best += blocks.best()
    return [min(best, key=lambda pair: pair[0])[1]] if best else []


def windows_of(frame: Frame, shift: FloatArray) -> BoolArray:
    """Where (flights, time) a load of known `shift` (outputs,) is on in a gap."""
    blocks = _Blocks(frame)
    return blocks.spread(blocks.climb(shift, known=True))


def edges(frame: Frame, one: Single) -> list[list[tuple[float, float]]]:
    """90 % intervals of every edge of the windows of a fit, per flight, in steps: on, off, on, ...

    An edge between two others is where the likelihood of the followed windows puts it, with the
    sizes of the fit and a flat prior between the middles to its neighbours.
    """
    record, shift, on = frame.record, one.theta, one.node.on
    if on is None:
        return []
    left = frame.cleaned(one.solved)
    weight = record.known / record.variance / one.solved.tau
    lag = FOLLOW_S / record.flights.signals.dt_s
    found = []
    for f, row in enumerate(on):
        at = np.flatnonzero(np.diff(row.astype(int), prepend=0))
        ends = [0, *at.tolist(), int(record.flights.lengths[f])]
        found.append(
            [
                _edge(
                    (left[f], weight[f], shift, lag),
                    (ends[k] + ends[k + 1]) // 2,
                    ends[k + 1],
                    (ends[k + 1] + ends[k + 2]) // 2,
                    rising=bool(row[ends[k + 1]]),
                )
                for k in range(len(at))
            ]
        )
    return found


def _edge(
    seen: tuple[FloatArray, FloatArray, FloatArray, float],
    first: int,
    at: int,
    last: int,
    *,
    rising: bool,
) -> tuple[float, float]:
    """Interval of one edge that was put at step `at`, between `first` and `last`."""
    left, weight, shift, lag = seen
    places = np.arange(first, last + 1)
    gain = (left[first:last] * weight[first:last]) @ shift
    price = weight[first:last] @ shift**2
    toward = 2.0 * _following(gain, lag) - _following(price, lag, squared=True)
    if not rising:
        toward = 2.0 * _leaving(gain, lag) - _leaving(price, lag, squared=True)
    chance = np.exp(0.5 * (toward - toward.max()))
    total = np.cumsum(chance) / chance.sum()
    low, high = (int(places[np.searchsorted(total, level)]) for level in (0.05, 0.95))
    return float(min(low, at)), float(max(high, at))


def _following(values: FloatArray, lag: float, *, squared: bool = False) -> FloatArray:
    """Sums (n + 1,) of `values` (n,) from every step p on, times 1 - exp(-(k - p + 1) / lag)."""
    after = np.append(np.cumsum(values[::-1])[::-1], 0.0)
    if squared:
        return after - 2.0 * _decayed(values, lag) + _decayed(values, 0.5 * lag)
    return after - _decayed(values, lag)


def _leaving(values: FloatArray, lag: float, *, squared: bool = False) -> FloatArray:
    """Sums (n + 1,) of `values` (n,) before every step p, and after it times exp(...)."""
    before = np.append(0.0, np.cumsum(values))
    return before + _decayed(values, 0.5 * lag if squared else lag)


def _decayed(values: FloatArray, lag: float) -> FloatArray:
    """Sums (n + 1,) of `values` (n,) from every step p on, times exp(-(k - p + 1) / lag)."""
    kept = np.exp(-1.0 / lag)
    return np.append(lfilter([kept], [1.0, -kept], values[::-1])[::-1], 0.0)


def _penalty(frame: Frame) -> float:
    """Log likelihood that a switch costs: half the log of the effective samples of a flight."""
    effective = float(frame.none.rss.sum()) / frame.none.tau / len(frame.record.gap)
    return 0.5 * log(max(effective, 2.0))


class _Blocks:
    """What the nuisances leave of a gap, (flights, blocks, outputs), and its weights.

    Flights of one number in `groups` (flights,) share their windows.
    """

    def __init__(self, frame: Frame) -> None:
        record = frame.record
        self._frame, self.groups = frame, np.arange(len(record.gap))
        self._size = max(1, round(_BLOCK_S / record.flights.signals.dt_s))
        self._steps = record.gap.shape[1]
        self._starts = np.arange(0, self._steps, self._size)
        self._known, self._tau = record.known, frame.none.tau
        self._count = self._sums(record.known.astype(float))
        self._weight = self._count / record.variance
        self._switch = _penalty(frame)
        self._gap = self._means(frame.gap)
        self._nuisances = np.stack([self._means(each) for each in frame.nuisances.columns])
        self.left = self._left(frame.none)

    def _sums(self, v: FloatArray) -> FloatArray:
        return np.asarray(np.add.reduceat(v, self._starts, axis=1))

    def _means(self, v: FloatArray) -> FloatArray:
        return self._sums(np.where(self._known, v, 0.0)) / np.maximum(self._count, 1.0)

    def _left(self, one: Solved) -> FloatArray:
        """Block means of the gap less the nuisances of a fit."""
        return np.asarray(self._gap - np.tensordot(one.nu, self._nuisances, axes=1))

    def best(self) -> list[tuple[float, Single]]:
        """The best fit of a load with its price, empty without any.

        It is in the windows that every first guess leads to, or in what is between them: a flight's
        offset makes one of the other, of a load that is off in windows, with the other sign.
        Windows then follow the shifts, nuisances and misfit of their joint fit, as long as that
        leaves less; those of a round are fitted in one pass, and none twice.
        """
        begun = [on for on in map(self.climb, self.guesses()) if on.any()]
        begun += [~on & on.any(axis=1, keepdims=True) for on in begun]
        best: list[tuple[float, Single]] = []
        followed: dict[bytes, tuple[float, BoolArray]] = {}  # windows: their price, the next ones
        going = [(np.inf, on) for on in begun]
        for _ in range(1 + _ROUNDS):
            going = [(before, on) for before, on in going if on.any()]
            new = {on.tobytes(): on for _, on in going if on.tobytes() not in followed}
            fits = self._frame.fits([self._node(on) for on in new.values()])
            for key, one in zip(new, fits, strict=True):
                price, left = self.price(one), self._left(one.solved)
                followed[key] = price, self._best(left, one.theta, one.solved.tau)
                if not best or price < best[-1][0]:
                    best = [(price, one)]
            here = [(before, *followed[on.tobytes()]) for before, on in going]
            going = [(price, then) for before, price, then in here if price < before]
        return best

    def _node(self, on: BoolArray) -> Node:
        """A load in windows (flights, blocks)."""
        flights = self._frame.record.flights
        signals, inside = flights.signals, self.spread(on).astype(float)
        own = [np.flatnonzero(self.groups == g)[0] for g in np.unique(self.groups)]
        switches = int(np.abs(np.diff(on[own].astype(int), axis=1)).sum() + on[own, 0].sum())
        effect = UNLOGGED_SWITCH
        parameters = tuple(
            p for p in effect.parameters(with_load(flights, inside).signals) if p.linear
        )
        rows = np.zeros((1 + len(parameters), *flights.y.shape), dtype=np.float32)
        follows = lag(inside, np.full(len(on), FOLLOW_S), signals.dt_s)
        for k in range(len(parameters)):
            rows[1 + k, ..., k] = follows
        box = np.array([(p.low, p.high) for p in parameters])
        zero, free = np.zeros(len(parameters)), tuple(range(len(parameters)))
        return Node(effect, parameters, zero, free, rows, box, self.spread(on), switches)

    def spread(self, on: BoolArray) -> BoolArray:
        """Windows (flights, time) of windows by blocks."""
        return np.asarray(np.repeat(on, self._size, axis=1)[:, : self._steps])

    def guesses(self) -> list[FloatArray]:
        """First guesses of the shifts: outputs alone and their main direction, of either sign."""
        level = np.median(self.left, axis=1, keepdims=True)
        scaled = (self.left - level) * np.sqrt(self._weight)
        rows = scaled.reshape(-1, scaled.shape[-1])
        size = np.sqrt(np.mean(rows**2, axis=0)) / np.maximum(
            np.sqrt(self._weight.mean(axis=(0, 1))), 1e-12
        )
        _, _, directions = np.linalg.svd(rows, full_matrices=False)
        shapes = [*np.eye(len(size)), np.sign(directions[0]) * (np.abs(directions[0]) > 0.2)]
        return [sign * 2.0 * size * shape for sign, shape in product((1.0, -1.0), shapes)]

    def climb(self, shift: FloatArray, *, known: bool = False) -> BoolArray:
        """Windows (flights, blocks) and shifts in turn, from a guess of the shifts, or `known`."""
        level = np.median(self.left, axis=1, keepdims=True)
        on = np.zeros(self.left.shape[:2], dtype=np.bool_)
        for _ in range(_ROUNDS):
            new = self._best(self.left - level, shift, self._tau)
            if (new == on).all() or not new.any():
                return new
            on = new
            level, fitted = self._sizes(on)
            shift = shift if known else fitted
        return on

    def _sizes(self, on: BoolArray) -> tuple[FloatArray, FloatArray]:
        """Levels of the flights and common shifts that fit the windows best."""
        w, e = self._weight, self.left
        off, inside = w * ~on[..., None], w * on[..., None]
        n, m = off.sum(axis=1), inside.sum(axis=1)
        level = (off * e).sum(axis=1) / np.maximum(n, 1e-12)
        over = (inside * e).sum(axis=1) / np.maximum(m, 1e-12) - level
        both = n * m / np.maximum(n + m, 1e-12)
        shift = (both * over).sum(axis=0) / np.maximum(both.sum(axis=0), 1e-12)
        return level[:, None], shift

    def _best(self, left: FloatArray, shift: FloatArray, tau: float) -> BoolArray:
        gain = (self._weight * (2.0 * left - shift) * shift).sum(axis=-1)
        for g in np.unique(self.groups):
            gain[self.groups == g] = gain[self.groups == g].sum(axis=0)
        on = np.stack([_viterbi(0.5 / tau * row, self._switch) for row in gain])
        on[on.mean(axis=1) > _MOST] = False
        return on

    def price(self, one: Single) -> float:
        """What is left of the gap, with the penalty of the switches."""
        return one.solved.cost + 2.0 * one.solved.tau * self._switch * one.node.switches


@compiled
def _viterbi(gain: FloatArray, penalty: float) -> BoolArray:
    """The path of zeros and ones with the most `gain` where it is one, less `penalty` a switch."""
    n = len(gain)
    came = np.zeros((n, 2), dtype=np.int64)
    off, on = 0.0, -penalty
    for t in range(n):
        if t > 0:
            came[t, 0] = 1 if on - penalty > off else 0
            came[t, 1] = 0 if off - penalty > on else 1
            off, on = max(off, on - penalty), max(on, off - penalty)
        on += gain[t]
    path = np.zeros(n, dtype=np.bool_)
    state = 1 if on > off else 0
    for t in range(n - 1, -1, -1):
        path[t] = state == 1
        state = came[t, state]
    return path
