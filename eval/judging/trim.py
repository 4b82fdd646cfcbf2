"""Trim: what a practitioner adjusts before a flight is judged, from its first minutes alone.

Fuel meters and temperature probes differ between flights and engines. From the quasi-steady
samples of the first part of a log, an offset of every output is estimated as a function of the
power level and the altitude, and added to the model over the rest of the log; only that rest is
scored.

The offset is a Gaussian process (Rasmussen and Williams 2006, section 2.2; the same as ridge
regression with documented prior widths) over the level x and the pressure altitude h:

    offset ~ N(0, width^2 (common^2 + exp(-(x - x')^2 / (2 length^2) - (h - h')^2 / (2 H^2))))

An offset at ground idle thus does not apply at cruise: where there is no sample at a similar level
and altitude, the offset goes back to the common part, which is small. What a steady-state model
misses at one altitude it need not miss at another: in that case, an offset that is taken for one of
the log does harm. H is the altitude over which a third of the pressure at sea
level goes. The level x is the steady-state value of the first output between its 1 % and 99 %
quantiles in the training logs.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from pydantic import Field

from narxcal.support.arrays import BoolArray, FloatArray
from narxcal.support.errors import ConfigError
from narxcal.support.settings import Section
from training.records import LEAST_WIDTHS

_BIN = 0.1
_ALTITUDE_FT = LEAST_WIDTHS["ALT_ft"]  # H
_BIN_FT = 0.5 * _ALTITUDE_FT  # of samples, and apart from each other where offsets are kept
# A larger error is no offset but a model that is wrong at this level: it must not spread to other
# levels through the common part.
_MOST_WIDTHS = 4.0


class OffsetPrior(Section):
    """What is assumed of one channel's offset before the log is seen.

    `width` is its standard deviation in the channel's unit, `common` the share of it that is the
    same at every level, `length` the correlation length in level.
    """

    width: float = Field(gt=0.0)
    common: float = Field(default=0.1, ge=0.0)
    length: float = Field(default=0.1, gt=0.0)


# Fuel meters a year apart differ by 2 to 3 %, and not alike at all flows; 1 % of fuel flow moves
# N1 by 0.3 % and N2 by 0.2 %. A temperature probe and the build of an engine make 15 K, and reach
# further in level. Round values, good for two measured flights in both directions; neighbouring
# values are nearly as good.
PRIORS = {
    "N1_pct": OffsetPrior(width=0.5),
    "N2_pct": OffsetPrior(width=0.3),
    "EGT_C": OffsetPrior(width=15.0, common=0.25, length=0.2),
}


class TrimConfig(Section):
    """Table [evaluate.trim]: the priors of the offsets.

    `priors` (channel -> prior) adds to and overrides the built-in ones; a channel without one is
    not trimmed. Quasi-steady errors count as one independent observation, as uncertain as the
    prior, per `correlation_s` seconds. Offsets are kept at evenly spaced levels `spacing` apart
    from 0, idle, to 1, full power, and at altitudes 5,000 ft apart; they are linear in between.
    """

    priors: Mapping[str, OffsetPrior] = Field(default_factory=dict)
    correlation_s: float = Field(default=60.0, gt=0.0)
    spacing: float = Field(default=0.1, gt=0.0, le=1.0)

    def prior(self, channel: str) -> OffsetPrior | None:
        """Prior of the channel's offset; None if it is not trimmed."""
        return {**PRIORS, **self.priors}.get(channel)

    @property
    def nodes(self) -> FloatArray:
        return np.linspace(0.0, 1.0, round(1.0 / self.spacing) + 1)


@dataclass(frozen=True, eq=False)
class Trim:
    """The offsets to be added to a model, (altitudes, nodes, channel) in the channels' units.

    They were estimated from `samples` (channel,) quasi-steady samples of the first `until` rows.
    """

    nodes: FloatArray
    altitudes_ft: FloatArray
    offsets: FloatArray
    samples: tuple[int, ...]
    until: int

    def at(self, level: FloatArray, altitude_ft: FloatArray) -> FloatArray:
        """Offsets (time, channel) at (time,) values, constant outside the outermost nodes."""
        height = np.clip(altitude_ft, self.altitudes_ft[0], self.altitudes_ft[-1])
        apart = np.abs(height[:, None] - self.altitudes_ft) / _BIN_FT
        share = np.maximum(0.0, 1.0 - apart)
        found = np.zeros((len(level), self.offsets.shape[2]))
        for k, table in enumerate(np.moveaxis(self.offsets, 2, 0)):
            by_altitude = [np.interp(level, self.nodes, row) for row in table]
            found[:, k] = np.sum(share * np.stack(by_altitude, axis=1), axis=1)
        return found


@dataclass(frozen=True, eq=False)
class TrimSamples:
    """What a trim is estimated from, one row per `dt_s`.

    `error` (time, channel) is measured minus model; `level`, `altitude_ft` and `quasi_steady` are
    (time,).
    """

    error: FloatArray
    level: FloatArray
    altitude_ft: FloatArray
    quasi_steady: BoolArray
    dt_s: float

    def altitudes_ft(self) -> FloatArray:
        """Altitudes at which offsets are kept, around those of the log."""
        ends = self.altitude_ft.min() / _BIN_FT, self.altitude_ft.max() / _BIN_FT
        return _BIN_FT * np.arange(np.floor(ends[0]), np.ceil(ends[1]) + 1.0)


def rows_for_trim(fraction: float, samples: int) -> int:
    """How many of the first rows `--trim FRACTION` takes; `ConfigError` unless 0 < it < 1."""
    if not 0.0 < fraction < 1.0:
        raise ConfigError(
            f"the trim fraction has to lie between 0 and 1, found {fraction:g}",
            hint="0.2 takes the first 20 % of each log and scores the rest",
        )
    return round(fraction * samples)


def estimate_trim(
    seen: TrimSamples, until: int, channels: tuple[str, ...], config: TrimConfig
) -> Trim:
    """Estimate the offsets from the first `until` rows alone.

    A channel without quasi-steady samples there, or without a prior width, gets no offset.
    """
    nodes, altitudes_ft = config.nodes, seen.altitudes_ft()
    offsets = np.zeros((len(altitudes_ft), len(nodes), len(channels)))
    counts = []
    for k, name in enumerate(channels):
        rows = np.flatnonzero(seen.quasi_steady[:until] & np.isfinite(seen.error[:until, k]))
        prior = config.prior(name)
        counts.append(0 if prior is None else len(rows))
        if prior is None or not len(rows):
            continue
        place = np.column_stack([seen.level, seen.altitude_ft / _ALTITUDE_FT])[rows]
        points = _binned(place, seen.error[rows, k], seen.dt_s / config.correlation_s)
        for number, altitude_ft in enumerate(altitudes_ft.tolist()):
            wanted = np.column_stack([nodes, np.full(len(nodes), altitude_ft / _ALTITUDE_FT)])
            offsets[number, :, k] = _posterior(wanted, points, prior)
    return Trim(nodes, altitudes_ft, offsets, tuple(counts), until)


class _Points(NamedTuple):
    """Mean places (points, 2), median errors and independent observations `many` (points,)."""

    place: FloatArray
    error: FloatArray
    many: FloatArray


def _binned(place: FloatArray, error: FloatArray, weight: float) -> _Points:
    """One point per bin of level and altitude that has samples; `weight` is that of a sample."""
    bins = np.floor(place / [_BIN, _BIN_FT / _ALTITUDE_FT])
    _, number = np.unique(bins, axis=0, return_inverse=True)
    rows = [np.flatnonzero(number.ravel() == k) for k in range(int(number.max()) + 1)]
    return _Points(
        np.array([place[chosen].mean(axis=0) for chosen in rows]),
        np.array([float(np.median(error[chosen])) for chosen in rows]),
        np.array([weight * len(chosen) for chosen in rows]),
    )


def _posterior(wanted: FloatArray, points: _Points, prior: OffsetPrior) -> FloatArray:
    """Mean of the Gaussian process at `wanted` places (nodes, 2), given the points."""
    most = _MOST_WIDTHS * prior.width
    error = np.clip(points.error, -most, most)

    def covariance(a: FloatArray, b: FloatArray) -> FloatArray:
        apart = (a[:, None, :] - b[None, :, :]) / [prior.length, 1.0]
        alike = np.exp(-0.5 * np.sum(apart**2, axis=2))
        return np.asarray(prior.width**2 * (prior.common**2 + alike))

    noise = np.diag(prior.width**2 / points.many)
    weights = np.linalg.solve(covariance(points.place, points.place) + noise, error)
    return np.asarray(covariance(wanted, points.place) @ weights)
