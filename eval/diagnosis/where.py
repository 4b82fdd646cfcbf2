"""Where the gap lies: its energy above the noise floor, bin by bin, and how sure that is.

The energy of a sample is its squared gap over `noise^2 + (0.001 range)^2` of the channel, the
weights by which effects are fitted; what noise alone would give is taken off bin by bin.
Intervals are by bootstrap over flights.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from data_prep.events import Event
from eval.diagnosis.flights import MOVES, Bins, GapData, events_of, sort_samples
from eval.diagnosis.measures import Band, Theil, TimeErrors, bands_of, theil_of, time_errors
from narxcal.support.arrays import FloatArray
from training.diagnosis.budget import Interval
from training.diagnosis.metric import TOLERANCE

_ALONE = 0.6  # share of one channel from which on the others may just not have been hit


class Sides(NamedTuple):
    """Shares of input, process and sensor side; they add up to 1, or to 0 where there is no gap."""

    input: float
    process: float
    sensor: float


NOWHERE = Sides(0.0, 0.0, 0.0)


def side_of(data: GapData, gap: FloatArray, channels: FloatArray) -> Sides:
    """Judge by evidence: `gap` (flights, time, outputs), `channels` (outputs,) shares of energy."""
    if channels.sum() <= 0.0:
        return NOWHERE
    alone = float(channels.max() / channels.sum())
    sensor = float(np.clip((alone - _ALONE) / (1.0 - _ALONE), 0.0, 1.0)) if len(channels) > 1 else 0
    shifted = (1.0 - sensor) * _common_shift(data, gap)
    return Sides(shifted, max(0.0, 1.0 - sensor - shifted), sensor)


def _common_shift(data: GapData, gap: FloatArray) -> float:
    """Part of the gap's energy that one shift in time of all channels explains."""
    scale = np.sqrt(data.noise**2 + (TOLERANCE * data.span) ** 2)
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
_OFFSET, _SLOPE, _BEND = 0.03, 0.03, 0.06  # priors of the nuisances, as shares of a range
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
    times: Mapping[str, TimeErrors]
    side: Sides
    events: tuple[tuple[Event, ...], ...]
    regimes: Mapping[str, Mapping[str, Interval]] = field(default_factory=dict)


def locate(data: GapData, explained: FloatArray | None = None, seed: int = 0) -> Where:
    """Say where the gap lies.

    `explained` (flights, time, outputs) is what effects change, zero for none: nuisances that fit
    beside them are then taken out of the gap. Without it nothing is known of what is nuisance and
    what is gap, and all of it counts.
    """
    events = events_of(data)
    bins = sort_samples(data, events)
    gap = data.gap if explained is None else without_nuisances(data, explained)
    energy = _Energy(data, bins, gap)
    shares = energy.drawn(np.random.default_rng(seed))
    outputs = data.flights.signals.outputs
    totals = shares.sum(axis=2)
    return Where(
        rows=_rows(energy, shares, outputs, _explained(data, bins, explained)),
        channels={name: _interval(totals[:, k]) for k, name in enumerate(outputs)},
        excess=dict(zip(outputs, energy.excess_share().tolist(), strict=True)),
        theil=theil_of(data),
        bands=bands_of(data, gap),
        times=time_errors(data, data.flights.y, events),
        side=side_of(data, gap, shares[0].sum(axis=1)),
        events=events,
        regimes=energy.drawn_regimes(np.random.default_rng(seed)),
    )


def _explained(data: GapData, bins: Bins, change: FloatArray | None) -> FloatArray | None:
    """Share (outputs, moves) of the energy of a `change` of the outputs; None where it is none."""
    if change is None:
        return None
    energy = change**2 / (data.noise**2 + (TOLERANCE * data.span) ** 2)
    known = np.where(np.isfinite(data.gap), energy, 0.0)
    parts = np.stack([known[bins.move == k].sum(axis=0) for k in range(len(MOVES))], axis=1)
    whole = float(parts.sum())
    return np.asarray(parts / whole) if whole > 0.0 else None


def without_nuisances(data: GapData, explained: FloatArray) -> FloatArray:
    """The gap (flights, time, outputs) less the offsets and skews that fit beside `explained`."""
    known = np.isfinite(data.gap)
    known &= (np.arange(data.gap.shape[1]) < data.flights.lengths[:, None])[..., None]
    weights = known / (data.noise**2 + (TOLERANCE * data.span) ** 2)
    shapes, priors = _nuisances(data)
    gram = np.einsum("fktn,ftn,fltn->fkl", shapes, weights, shapes, optimize=True)
    inverse = np.linalg.inv(gram + np.diag(1.0 / priors**2))
    left = np.where(known, data.gap, 0.0) - explained
    on = np.einsum("ftn,fktn->fk", left * weights, shapes)
    best = np.einsum("fkl,fl->fk", inverse, on)
    kept = left - np.einsum("fk,fktn->ftn", best, shapes) + explained
    return np.where(np.isfinite(data.gap), kept, np.nan)


def _nuisances(data: GapData) -> tuple[FloatArray, FloatArray]:
    """Maps of power per output (flights, k, time, outputs), and the priors' deviations (k,)."""
    y, span = data.flights.y, data.span
    power = data.flights.signals.power(y)
    shapes, priors = [], []
    for c in range(y.shape[2]):
        for shape, share in zip(
            (np.ones_like(power), power - 0.5, (power - 0.5) ** 2 - 1.0 / 12.0),
            (_OFFSET, _SLOPE, _BEND),
            strict=True,
        ):
            one = np.zeros_like(y)
            one[..., c] = shape
            shapes.append(one)
            priors.append(share * span[c])
    return np.stack(shapes, axis=1), np.array(priors)


class _Energy:
    """Energies (units, outputs, moves) above what noise gives, and the latter's spread."""

    def __init__(self, data: GapData, bins: Bins, gap: FloatArray) -> None:
        self.bins = bins
        scale = np.sqrt(data.noise**2 + (TOLERANCE * data.span) ** 2)
        self.floor = (data.noise / scale) ** 2
        self.sample = (gap / scale) ** 2  # NaN where unknown
        self.units = _units(data)
        count = int(self.units.max()) + 1
        shape = (count, len(scale), len(MOVES))
        self.total, self.samples = np.zeros(shape), np.zeros(shape)
        for k in range(len(scale)):
            known = np.isfinite(self.sample[..., k]) & (bins.move >= 0)
            at = (self.units[known], bins.move[known])
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

    def drawn(self, rng: np.random.Generator) -> FloatArray:
        """Shares (1 + draws, outputs, moves): those found, then those of resampled flights."""
        return np.stack([self.shares(each) for each in self._weights(rng)])

    def drawn_regimes(self, rng: np.random.Generator) -> dict[str, dict[str, Interval]]:
        """Share of all energy in each level of each regime; none where nothing is above noise."""
        above = np.nansum(self.sample - self.floor, axis=-1)
        inside = self.bins.move >= 0
        weights, found = self._weights(rng), {}
        for name, (levels, index) in self.bins.regimes.items():
            parts = np.zeros((weights.shape[1], len(levels)))
            np.add.at(parts, (self.units[inside], index[inside]), above[inside])
            drawn = np.maximum(weights @ parts, 0.0)
            shares = drawn / np.maximum(drawn.sum(axis=1, keepdims=True), 1e-300)
            found[name] = {level: _interval(shares[:, k]) for k, level in enumerate(levels)}
        return found

    def _weights(self, rng: np.random.Generator) -> FloatArray:
        """How often each unit counts, (1 + draws, units): once as found, then drawn anew."""
        count = len(self.total)
        draws = rng.multinomial(count, np.full(count, 1.0 / count), size=_DRAWS)
        return np.concatenate([np.ones((1, count)), draws])

    def regimes(self, output: int, move: int) -> dict[str, dict[str, float]]:
        """How the energy of one bin divides over the levels of each regime."""
        inside = (self.bins.move == move) & np.isfinite(self.sample[..., output])
        above = self.sample[..., output][inside] - self.floor[output]
        found = {}
        for name, (levels, index) in self.bins.regimes.items():
            parts = np.bincount(index[inside], weights=above, minlength=len(levels))
            parts = np.maximum(parts, 0.0)
            whole = float(parts.sum())
            if whole > 0.0:
                found[name] = dict(zip(levels, (parts / whole).tolist(), strict=True))
        return found


def _units(data: GapData) -> np.ndarray[tuple[int, ...], np.dtype[np.int64]]:
    """What is drawn in the bootstrap, (flights, time): flights, or parts of too few of them."""
    count, steps = data.flights.u.shape[:2]
    flight = np.repeat(np.arange(count)[:, None], steps, axis=1)
    if count >= 3:
        return flight
    part = np.arange(steps) * _PARTS // data.flights.lengths[:, None]
    return np.asarray(flight * _PARTS + np.minimum(part, _PARTS - 1))


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
