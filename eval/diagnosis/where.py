"""Where the gap lies: its energy above the noise floor, bin by bin, and how sure that is.

The energy of a sample is its squared gap over `noise^2 + (0.001 range)^2` of the channel, the
weights by which effects are fitted; what noise alone would give is taken off bin by bin. Further
measures are shares of bands of frequencies and Theil's split. Intervals are by bootstrap over
flights.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import pandas as pd
from scipy.signal import csd, welch

from data_prep.events import Event
from eval.diagnosis.expected import time_errors
from eval.diagnosis.flights import MOVES, events_of, moves_of, regimes_of
from narxcal.effects.running import Flights
from narxcal.support.arrays import FloatArray, IntArray, bridge_gaps
from training.diagnosis.budget import Interval
from training.diagnosis.metric import Record
from training.diagnosis.nuisances import steady_maps

_ALONE = 0.6  # share of one channel from which on the others may just not have been hit


class Sides(NamedTuple):
    """Shares of input, process and sensor side; they add up to 1, or to 0 where there is no gap."""

    input: float
    process: float
    sensor: float


NOWHERE = Sides(0.0, 0.0, 0.0)


def side_of(data: Record, gap: FloatArray, channels: FloatArray) -> Sides:
    """Judge by evidence: `gap` (flights, time, outputs), `channels` (outputs,) shares of energy."""
    if channels.sum() <= 0.0:
        return NOWHERE
    alone = float(channels.max() / channels.sum())
    sensor = float(np.clip((alone - _ALONE) / (1.0 - _ALONE), 0.0, 1.0)) if len(channels) > 1 else 0
    shifted = (1.0 - sensor) * _common_shift(data, gap)
    return Sides(shifted, max(0.0, 1.0 - sensor - shifted), sensor)


def _common_shift(data: Record, gap: FloatArray) -> float:
    """Part of the gap's energy that one shift in time of all channels explains."""
    scale = np.sqrt(data.variance)
    slope = -np.gradient(data.flights.y, data.flights.signals.dt_s, axis=1) / scale
    known = np.isfinite(gap)
    seen = np.where(known, gap, 0.0) / scale
    slope = np.where(known, slope, 0.0)
    energy, both = float((seen**2).sum()), float((seen * slope).sum())
    moving = float((slope**2).sum())
    floor = float((known * (data.noise / scale) ** 2).sum())
    if moving <= 0.0 or energy <= floor:
        return 0.0
    return float(np.clip(both**2 / moving / (energy - floor), 0.0, 1.0))


CORE = 0.7  # the smallest set of bins that holds this share
_DRAWS = 300
_MAP = 0.03  # of a range: prior of a flight's steady map
_SIGMAS = 3.0  # a bin's energy has to stand out of white noise's by this much
_PARTS = 6  # of a flight, where there are too few flights to draw from
_LISTED = 0.005  # of what effects do: a bin that has so much of it is listed without a gap there


@dataclass(frozen=True)
class Row:
    """One bin: its share of all energy above the floor, with a 90 % interval.

    `regimes` is how that share divides: altitude, Mach, power, bleed -> level -> part. `core`
    marks the smallest set of bins that holds 70 %. `explained` is the bin's share of the energy of
    what the claimed effects do, whatever else the gap holds; None without a claim.
    """

    channel: str
    direction: str
    phase: str
    share: Interval
    core: bool
    regimes: Mapping[str, Mapping[str, float]]
    explained: float | None


@dataclass(frozen=True, eq=False)
class Where:
    """All that can be said on where the gap is, without naming an effect.

    `rows` are a partition of the energy, largest first; `channels` their totals, and `regimes` how
    it divides over the levels of each regime. `excess` is the part of the squared gap that is above
    the floor, per channel.
    """

    rows: tuple[Row, ...]
    channels: Mapping[str, Interval]
    excess: Mapping[str, float]
    theil: Mapping[str, Theil]
    bands: Mapping[str, tuple[Band, ...]]
    times: Mapping[str, pd.DataFrame]
    side: Sides
    events: tuple[tuple[Event, ...], ...]
    regimes: Mapping[str, Mapping[str, Interval]] = field(default_factory=dict)


def locate(data: Record, explained: FloatArray | None = None) -> Where:
    """Say where the gap lies.

    `explained` (flights, time, outputs) is what effects change, zero for none: nuisances that fit
    beside them are then taken out of the gap. Without it nothing is known of what is nuisance and
    what is gap, and all of it counts.
    """
    events = events_of(data)
    move = moves_of(data, events)
    gap = data.difference if explained is None else without_nuisances(data, explained)
    energy = _Energy(data, move, gap)
    shares = energy.drawn()
    outputs = data.flights.signals.outputs
    totals = shares.sum(axis=2)
    return Where(
        rows=_rows(energy, shares, outputs, _explained(data, move, explained)),
        channels={name: _interval(totals[:, k]) for k, name in enumerate(outputs)},
        excess=dict(zip(outputs, energy.excess_share().tolist(), strict=True)),
        theil=theil_of(data),
        bands=bands_of(data, gap),
        times=time_errors(data, data.flights.y, events),
        side=side_of(data, gap, shares[0].sum(axis=1)),
        events=events,
        regimes=energy.drawn_regimes(),
    )


def _explained(data: Record, move: IntArray, change: FloatArray | None) -> FloatArray | None:
    if change is None:
        return None
    energy = change**2 / data.variance
    known = np.where(np.isfinite(data.difference), energy, 0.0)
    parts = np.stack([known[move == k].sum(axis=0) for k in range(len(MOVES))], axis=1)
    whole = float(parts.sum())
    return np.asarray(parts / whole) if whole > 0.0 else None


def without_nuisances(data: Record, explained: FloatArray) -> FloatArray:
    """The gap (flights, time, outputs) less maps of power per flight that fit beside `explained`.

    Their prior is 3 % of a channel's range.
    """
    known = np.isfinite(data.difference)
    columns = np.swapaxes(steady_maps(data.flights, _MAP * data.span), 0, 1)
    weighted = columns * (known / data.variance)[:, None]
    gram = np.einsum("fktn,fltn->fkl", weighted, columns, optimize=True)
    left = np.where(known, data.difference - explained, 0.0)
    on = np.einsum("fktn,ftn->fk", weighted, left)
    best = np.linalg.solve(gram + np.eye(columns.shape[1]), on[..., None])[..., 0]
    return np.asarray(data.difference - np.einsum("fk,fktn->ftn", best, columns))


class _Energy:
    """Energies (units, outputs, moves) above what noise gives, and the latter's spread."""

    def __init__(self, data: Record, move: IntArray, gap: FloatArray) -> None:
        self.move, self.levels = move, regimes_of(data)
        scale = np.sqrt(data.variance)
        self.floor = (data.noise / scale) ** 2
        self.sample = (gap / scale) ** 2  # NaN where unknown
        self.units = _units(data)
        count = int(self.units.max()) + 1
        self.weights = _drawn(count)
        shape = (count, len(scale), len(MOVES))
        self.total, self.samples = np.zeros(shape), np.zeros(shape)
        for k in range(len(scale)):
            known = np.isfinite(self.sample[..., k]) & (move >= 0)
            at = (self.units[known], move[known])
            np.add.at(self.total[:, k], at, self.sample[..., k][known])
            np.add.at(self.samples[:, k], at, 1.0)

    def excess_share(self) -> FloatArray:
        """Part of each output's squared gap that is above the floor: (outputs,)."""
        total, samples = self.total.sum(axis=(0, 2)), self.samples.sum(axis=(0, 2))
        above = np.maximum(total - samples * self.floor, 0.0)
        return np.asarray(above / np.maximum(total, 1e-300))

    def shares(self, weights: FloatArray) -> FloatArray:
        """Shares (outputs, moves) of the energy of units that count `weights` (units,) times."""
        total = np.tensordot(weights, self.total, axes=1)
        samples = np.tensordot(weights, self.samples, axes=1)
        floor = self.floor[:, None]
        excess = total - samples * floor
        excess[excess < _SIGMAS * floor * np.sqrt(2.0 * samples)] = 0.0
        whole = excess.sum()
        return np.asarray(excess / whole if whole > 0.0 else excess)

    def drawn(self) -> FloatArray:
        """Shares (1 + draws, outputs, moves): those found, then those of resampled flights."""
        return np.stack([self.shares(each) for each in self.weights])

    def drawn_regimes(self) -> dict[str, dict[str, Interval]]:
        """Share of all energy in each level of each regime; none where nothing is above noise."""
        above = np.nansum(self.sample - self.floor, axis=-1)
        inside = self.move >= 0
        found = {}
        for name, (levels, index) in self.levels.items():
            parts = np.zeros((len(self.total), len(levels)))
            np.add.at(parts, (self.units[inside], index[inside]), above[inside])
            shares = _shares(self.weights @ parts)
            found[name] = {level: _interval(shares[:, k]) for k, level in enumerate(levels)}
        return found

    def regimes(self, output: int, move: int) -> dict[str, dict[str, float]]:
        """How the energy of one bin divides over the levels of each regime."""
        inside = (self.move == move) & np.isfinite(self.sample[..., output])
        above = self.sample[..., output][inside] - self.floor[output]
        found = {}
        for name, (levels, index) in self.levels.items():
            parts = np.bincount(index[inside], weights=above, minlength=len(levels))
            parts = np.maximum(parts, 0.0)
            whole = float(parts.sum())
            if whole > 0.0:
                found[name] = dict(zip(levels, (parts / whole).tolist(), strict=True))
        return found


def _units(data: Record) -> np.ndarray[tuple[int, ...], np.dtype[np.int64]]:
    """What is drawn in the bootstrap, (flights, time): flights, or parts of too few of them."""
    count, steps = data.flights.u.shape[:2]
    flight = np.repeat(np.arange(count)[:, None], steps, axis=1)
    if count >= 3:
        return flight
    part = np.arange(steps) * _PARTS // data.flights.lengths[:, None]
    return np.asarray(flight * _PARTS + np.minimum(part, _PARTS - 1))


def _drawn(count: int) -> FloatArray:
    """How often each of `count` units counts, (1 + draws, units): as found, then drawn anew."""
    draws = np.random.default_rng(0).multinomial(count, np.full(count, 1.0 / count), size=_DRAWS)
    return np.concatenate([np.ones((1, count)), draws])


def _shares(energies: FloatArray) -> FloatArray:
    """Energies (draws, parts) as shares of what each draw holds; none where it holds nothing."""
    above = np.maximum(energies, 0.0)
    return np.asarray(above / np.maximum(above.sum(axis=1, keepdims=True), 1e-300))


def _interval(draws: FloatArray) -> Interval:
    """First value with the 90 % interval of the others, which it belongs to."""
    low, high = np.percentile(draws[1:], (5.0, 95.0))
    value = float(draws[0])
    return Interval(value, min(float(low), value), max(float(high), value))


def _rows(
    energy: _Energy, shares: FloatArray, outputs: Sequence[str], explained: FloatArray | None
) -> tuple[Row, ...]:
    found = shares[0]
    order = np.argsort(-found, axis=None, kind="stable")
    before = np.cumsum(found.ravel()[order]) - found.ravel()[order]
    rows = []
    for place, held in zip(order.tolist(), before.tolist(), strict=True):
        output, move = divmod(place, found.shape[1])
        share = _interval(shares[:, output, move])
        part = None if explained is None else float(explained[output, move])
        if share.high > 0.0 or (part or 0.0) > _LISTED:
            core = held < CORE and share.value > 0.0
            regimes = energy.regimes(output, move)
            direction, phase = MOVES[move]
            rows.append(Row(outputs[output], direction, phase, share, core, regimes, part))
    return tuple(rows)


EDGES_HZ = (0.0, 0.03, 0.1, 0.3, 1.0, 1e9)
_SEGMENT_S = 128.0


class Band(NamedTuple):
    """A band of frequencies: share of the channel's gap energy above the floor, and coherence.

    `low` to `high` is the share's 90 % interval. `coherence` is the part of the gap there that a
    linear system could make of the driver.
    """

    low_hz: float
    high_hz: float
    share: float
    coherence: float
    low: float = 0.0
    high: float = 1.0


def bands_of(data: Record, gap: FloatArray) -> dict[str, tuple[Band, ...]]:
    """Bands of every output of a gap (flights, time, outputs): Welch's spectra over all flights."""
    names = data.flights.signals.outputs
    return {name: _bands(data, gap[..., k], data.noise[k]) for k, name in enumerate(names)}


def _bands(data: Record, gap: FloatArray, noise: float) -> tuple[Band, ...]:
    """Bands of one output's gap (flights, time)."""
    frequency, cross, own, driver = _spectra(data.flights, gap)
    highest_hz, lengths = 0.5 / data.flights.signals.dt_s, data.flights.lengths
    # White noise spreads its variance evenly over all frequencies up to half the rate.
    floor = noise**2 / highest_hz
    weights = lengths / lengths.sum()
    excess = weights[:, None] * (own - floor)
    edges = [edge for edge in EDGES_HZ if edge < highest_hz] + [highest_hz]
    insides = [(frequency >= low) & (frequency < high) for low, high in pairwise(edges)]
    energies = np.stack([excess[:, inside].sum(axis=1) for inside in insides], axis=1)
    shares = _shares(_drawn(len(lengths)) @ energies)
    ends = [(0.0, 1.0)] * len(insides)
    if len(own) > 1:
        ends = [(each.low, each.high) for each in map(_interval, shares.T)]
    mean = [(weights[:, None] * each).sum(axis=0) for each in (cross, own, driver)]
    return tuple(
        Band(*edge, float(share), _coherence(*(each[inside] for each in mean)), *end)
        for edge, share, inside, end in zip(pairwise(edges), shares[0], insides, ends, strict=True)
    )


def _spectra(
    flights: Flights, gap: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Frequencies, and spectra (flights, frequencies): cross, gap's, driver's."""
    signals, rate_hz = flights.signals, 1.0 / flights.signals.dt_s
    segment = int(min(_SEGMENT_S * rate_hz, flights.lengths.min()))
    levers, found = flights.u[..., signals.u(signals.driver)], []
    for own, lever, n in zip(gap, levers, flights.lengths, strict=True):
        pair = bridge_gaps(own[:n]), lever[:n] - lever[:n].mean()
        frequency, cross = csd(*pair, rate_hz, nperseg=segment, detrend=False)
        power = [welch(x, rate_hz, nperseg=segment, detrend=False)[1] for x in pair]
        found.append((cross, *power))
    cross, own, driver = (np.stack(each) for each in zip(*found, strict=True))
    return frequency, cross, own, driver


def _coherence(cross: FloatArray, own: FloatArray, driver: FloatArray) -> float:
    both = float((own * driver).sum())
    return min(1.0, float((np.abs(cross) ** 2).sum()) / both) if both > 0.0 else 0.0


class Theil(NamedTuple):
    """Shares of the mean squared gap, which add up to 1, and Theil's inequality U.

    U is 0 for equal series and at most 1.
    """

    bias: float
    variance: float
    covariance: float
    inequality: float


def theil(real: FloatArray, sim: FloatArray) -> Theil:
    """Split the gap between two series (time,); samples where either is NaN are left out."""
    known = np.isfinite(real) & np.isfinite(sim)
    a, b = real[known], sim[known]
    mean_square = float(np.mean((a - b) ** 2)) if len(a) else 0.0
    if mean_square == 0.0:
        return Theil(0.0, 0.0, 0.0, 0.0)
    bias = float(a.mean() - b.mean()) ** 2 / mean_square
    variance = float(a.std() - b.std()) ** 2 / mean_square
    size = float(np.sqrt(np.mean(a**2)) + np.sqrt(np.mean(b**2)))
    return Theil(bias, variance, 1.0 - bias - variance, float(np.sqrt(mean_square)) / size)


def theil_of(data: Record) -> dict[str, Theil]:
    """Theil's split of every output, over all flights as one series."""
    real, sim = (each.reshape(-1, each.shape[2]).T for each in (data.real, data.flights.y))
    return dict(zip(data.flights.signals.outputs, map(theil, real, sim), strict=True))
