r"""The gap and the inner product in which hypotheses are compared.

A vector v (flights, time, outputs) is split into orthogonal bands by means over blocks of 8, of 8
such, and of 8 such again; in each band it is divided by the standard deviation of what is neither
effect nor nuisance there,

    <a, b> = sum_b sum a_b b_b / V_cb(t).

One band with `V = noise^2 + (0.001 range)^2` is the measure where nothing was learned. Columns are
in the order of units (flights, or blocks of a few long ones), so that a unit is left out by
leaving its Gram matrix out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from narxcal.effects.running import Flights
from narxcal.support.arrays import FloatArray, IntArray

TOLERANCE = 1e-3  # of a channel's range: what nobody would call a gap
STRETCH_S = 480.0  # a flight of the calibration
BLOCK = 8  # samples of a band that make one of the next slower


@dataclass(frozen=True, eq=False)
class Record:
    """Flights with what was recorded, (flights, time, outputs), NaN where unknown.

    `noise` (outputs,) is its standard deviation on the raster; `unit` (flights, time) the number
    of the unit that each sample belongs to, -1 beyond a flight's end; `group` (flights,) says which
    logs are of engines of one flight; `fast` (outputs,) is the mean squared gap of the logs that
    means over the raster's steps have lost; `names` are the logs'.
    """

    flights: Flights
    real: FloatArray
    noise: FloatArray
    unit: IntArray
    group: tuple[int, ...] = ()
    fast: FloatArray | float = 0.0
    names: tuple[str, ...] = ()

    @property
    def known(self) -> np.ndarray[tuple[int, ...], np.dtype[np.bool_]]:
        """Where the gap is known."""
        return np.asarray(np.isfinite(self.real) & (self.unit >= 0)[..., None])

    @property
    def difference(self) -> FloatArray:
        """Recorded less simulated, (flights, time, outputs), NaN where unknown."""
        return self.real - self.flights.y

    @property
    def gap(self) -> FloatArray:
        """The difference, zero where unknown."""
        return np.where(self.known, self.difference, 0.0)

    @property
    def span(self) -> FloatArray:
        """Range of each output in the simulator's logs, (outputs,)."""
        signals = self.flights.signals
        return np.maximum(signals.high - signals.low, 1e-9)

    @property
    def variance(self) -> FloatArray:
        """Of white noise and of what nobody would call a gap, (outputs,)."""
        return self.noise**2 + (TOLERANCE * self.span) ** 2

    @property
    def units(self) -> int:
        """How many units there are."""
        return int(self.unit.max()) + 1

    @property
    def independent(self) -> float:
        """Effective samples: 25 in eight minutes, for the errors of a simulator are slow."""
        seconds = float((self.unit >= 0).sum()) * self.flights.signals.dt_s
        return 25.0 * seconds / 480.0

    def stretches(self, most: int) -> Record:
        """Stretches as flights and units, those with most of the gap."""
        at, lengths = stretches(self.flights, ((self.gap / self.span) ** 2).sum(axis=2), most)
        inside = np.arange(at[1].shape[1]) < lengths[:, None]
        unit = np.where(inside, np.arange(len(lengths))[:, None], -1)
        return Record(few(self.flights, at, lengths), self.real[at], self.noise, unit)

    def some(self, rows: Sequence[int]) -> Record:
        """Some of the flights, their units numbered anew."""
        at, flights = list(rows), self.flights
        few = replace(flights, u=flights.u[at], y=flights.y[at], lengths=flights.lengths[at])
        known, numbers = np.unique(self.unit[at], return_inverse=True)
        unit = numbers.reshape(self.unit[at].shape) - int(known[0] < 0)
        group = tuple(self.group[k] for k in at) if self.group else ()
        return Record(few, self.real[at], self.noise, unit, group)


def stretches(
    flights: Flights, weight: FloatArray, most: int
) -> tuple[tuple[IntArray, IntArray], IntArray]:
    """Flights and times (n, size) of stretches of about `STRETCH_S`, those with most `weight`.

    `weight` is (flights, time), nothing beyond a flight's end. With the lengths (n,) of these.
    """
    steps = weight.shape[1]
    size = -(-steps // max(1, round(steps * flights.signals.dt_s / STRETCH_S)))
    starts = np.arange(0, steps, size)
    own = np.clip(flights.lengths[:, None] - starts, 0, size)
    order = np.argsort(-np.add.reduceat(weight, starts, axis=1), axis=None, kind="stable")
    f, k = np.unravel_index(np.sort(order[: min(most, int((own > 0).sum()))]), own.shape)
    return (f[:, None], np.minimum(starts[k][:, None] + np.arange(size), steps - 1)), own[f, k]


def few(flights: Flights, at: tuple[IntArray, IntArray], lengths: IntArray) -> Flights:
    """The stretches `at` of flights as flights."""
    return replace(flights, u=flights.u[at], y=flights.y[at], lengths=lengths)


class Metric:
    """Whitens vectors; `variance` is one array (flights, time or fewer, outputs) per band."""

    def __init__(self, record: Record, variance: Sequence[FloatArray]) -> None:
        self._bands = len(variance)
        known = record.known
        roots, units = [], []
        for b, each in enumerate(variance):
            size = BLOCK**b
            share = block_means(known.astype(np.float64), size)
            roots.append(np.where(share > 0.5, np.sqrt(size * share / each), 0.0))
            middle = np.minimum(np.arange(each.shape[1]) * size + size // 2, known.shape[1] - 1)
            unit = np.broadcast_to(record.unit[:, middle, None], each.shape)
            units.append(np.where(share > 0.5, unit, -1))
        unit = np.concatenate([each.reshape(-1) for each in units])
        root = np.concatenate([each.reshape(-1) for each in roots])
        order = np.argsort(unit, kind="stable")
        self._order = order[unit[order] >= 0]
        self._root = root[self._order]
        ends = np.searchsorted(unit[self._order], np.arange(record.units + 1))
        self.slices = tuple(slice(a, b) for a, b in pairwise(ends.tolist()))
        self._known = known
        places = [np.indices(each.shape) for each in variance]
        cells = [at[2] + b * record.real.shape[2] for b, at in enumerate(places)]
        cell = np.concatenate([each.reshape(-1) for each in cells])
        flight = np.concatenate([at[0].reshape(-1) for at in places])
        self.cell, self.flight = cell[self._order], flight[self._order]

    def whiten(self, v: FloatArray) -> FloatArray:
        """Whitened columns (n, m) of vectors `v` (n, flights, time, outputs)."""
        found = np.empty((len(v), len(self._order)))
        for k, each in enumerate(v):
            parts = bands_of(np.where(self._known, each, 0.0), self._bands)
            flat = np.concatenate([part.reshape(-1) for part in parts])
            found[k] = flat[self._order] * self._root
        return found

    def gram(self, a: FloatArray, b: FloatArray) -> FloatArray:
        """Inner products (units, n, k) of whitened `a` (n, m) and `b` (k, m)."""
        return np.stack([a[:, s] @ b[:, s].T for s in self.slices])


def bands_of(v: FloatArray, count: int) -> list[FloatArray]:
    """Parts (flights, time / 8^b, outputs) of `v` (flights, time, outputs), fastest first.

    The last of `count` bands is all that is slower; one band is `v` itself.
    """
    parts, slow = [], v
    for _ in range(count - 1):
        means = block_means(slow, BLOCK)
        back = np.repeat(means, BLOCK, axis=1)[:, : slow.shape[1]]
        parts.append(slow - back)
        slow = means
    return [*parts, slow]


def block_means(v: FloatArray, size: int) -> FloatArray:
    """Means over blocks of `size` along time; the last block may be shorter."""
    starts = np.arange(0, v.shape[1], size)
    lengths = np.diff(np.append(starts, v.shape[1]))
    return np.asarray(np.add.reduceat(v, starts, axis=1) / lengths[None, :, None])


def assumed_variance(record: Record) -> list[FloatArray]:
    """One band: white noise and what nobody would call a gap."""
    return [np.broadcast_to(record.variance, record.real.shape).copy()]
