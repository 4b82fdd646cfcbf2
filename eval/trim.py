"""Trim: what a practitioner adjusts before a flight is judged, from its first minutes alone.

Fuel meters and temperature probes differ between flights and engines. From the quasi-steady
samples of the first part of a log, an offset of every output is estimated as a function of the
power level, and added to the model over the rest of the log; only that rest is scored.

The offset is a Gaussian process over the level (Rasmussen and Williams 2006, section 2.2; the
same as ridge regression with documented prior widths):

    offset(x) ~ N( 0, width^2 (common^2 + exp(-(x - x')^2 / (2 length^2))) )

An offset at ground idle thus does not apply at cruise: where there is no sample of a similar level,
the offset goes back to the common part, which is small. The level x is the steady-state
value of the first output between its 1 % and 99 % quantiles in the training logs.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from pydantic import Field

from narxcal.support.arrays import BoolArray, FloatArray
from narxcal.support.errors import ConfigError
from narxcal.support.settings import Section

_BIN = 0.1
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
    from 0, idle, to 1, full power, and are linear in between.
    """

    priors: Mapping[str, OffsetPrior] = Field(default_factory=dict)
    correlation_s: float = Field(default=60.0, gt=0.0)
    spacing: float = Field(default=0.1, gt=0.0, le=1.0)

    def prior(self, channel: str) -> OffsetPrior | None:
        """Prior of the channel's offset; None if it is not trimmed."""
        return {**PRIORS, **self.priors}.get(channel)

    @property
    def nodes(self) -> FloatArray:
        """Levels at which the offsets are kept, `(nodes,)`."""
        return np.linspace(0.0, 1.0, round(1.0 / self.spacing) + 1)


@dataclass(frozen=True, eq=False)
class Trim:
    """The offsets to be added to a model, (nodes, channel) in the channels' units.

    They were estimated from `samples` (channel,) quasi-steady samples of the first `until` rows.
    """

    nodes: FloatArray
    offsets: FloatArray
    samples: tuple[int, ...]
    until: int

    def at(self, level: FloatArray) -> FloatArray:
        """Offsets (time, channel) at `level` (time,), constant outside the outermost nodes."""
        columns = [np.interp(level, self.nodes, column) for column in self.offsets.T]
        return np.stack(columns, axis=1)


@dataclass(frozen=True, eq=False)
class TrimSamples:
    """What a trim is estimated from, one row per `dt_s`.

    `error` (time, channel) is measured minus model; `level` and `quasi_steady` are (time,).
    """

    error: FloatArray
    level: FloatArray
    quasi_steady: BoolArray
    dt_s: float


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
    nodes = config.nodes
    columns, counts = [], []
    for k, name in enumerate(channels):
        rows = np.flatnonzero(seen.quasi_steady[:until] & np.isfinite(seen.error[:until, k]))
        prior = config.prior(name)
        if prior is None or not len(rows):
            counts.append(0)
            columns.append(np.zeros(len(nodes)))
            continue
        counts.append(len(rows))
        points = _binned(seen.level[rows], seen.error[rows, k], seen.dt_s / config.correlation_s)
        columns.append(_posterior(nodes, points, prior))
    return Trim(nodes, np.stack(columns, axis=1), tuple(counts), until)


def _binned(level: FloatArray, error: FloatArray, weight: float) -> FloatArray:
    """Rows (mean level, median error, independent observations), one per bin of levels."""
    bins = np.floor(level / _BIN)
    rows = []
    for each in np.unique(bins):
        chosen = bins == each
        count = float(chosen.sum()) * weight
        rows.append((float(level[chosen].mean()), float(np.median(error[chosen])), count))
    return np.array(rows)


def _posterior(nodes: FloatArray, points: FloatArray, prior: OffsetPrior) -> FloatArray:
    """Mean of the Gaussian process at the nodes, given the points."""
    at, error, count = points.T
    error = np.clip(error, -_MOST_WIDTHS * prior.width, _MOST_WIDTHS * prior.width)

    def covariance(a: FloatArray, b: FloatArray) -> FloatArray:
        apart = (a[:, None] - b[None, :]) / prior.length
        return np.asarray(prior.width**2 * (prior.common**2 + np.exp(-0.5 * apart**2)))

    noise = np.diag(prior.width**2 / count)
    weights = np.linalg.solve(covariance(at, at) + noise, error)
    return np.asarray(covariance(nodes, at) @ weights)
