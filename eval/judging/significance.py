"""Which differences of free-run errors are significant, and which would have been.

Errors of one flight are alike for as long as they are correlated, and share offsets of the day; so
samples and events are no independent units. With S the sum of squared errors of a model in a unit,

    r_k = ln(RMSE_a / RMSE_b) in unit k = ln(S_a / S_b) / 2,   t = mean r / (s / sqrt K)

is compared with Student's t of K - 1 degrees of freedom. If neither model is better, a and b may be
exchanged in a unit: r is symmetric about 0, whatever the size of its errors.

| units | where |
|---|---|
| flights | of two and more; engines of one flight together |
| stretches | of a single flight, each at least 8 times as long as the errors of either model are correlated, 20 at most |

The correlation time tau is 1/2 + the sum of autocorrelations to the first that is not positive, of
the errors about their mean. Squares of first-order errors are correlated for tau / 2, so that the r
of neighbouring stretches of m tau correlate by rho = 1 / (4 m - 2): t is too large by the root of
(1 + 2 rho (1 - 1/K)) / (1 - 2 rho / K). 8 is the least m at which a table of three pairs, each at
5/3 %, claims at most 6 % at K = 20 (6.7 % at m = 5). p is of the whole table: Holm's step-down over
all pairs and channels makes 5 % the probability of any false claim. A claim also takes the lower
RMSE over all rows.
Of one flight a claim is about that flight.

**Passes of Ti and Tt** are paired by transient. Those that one model alone passes are compared with a
fair coin (McNemar's exact test) and, of several flights, the mean difference over its standard error
by flights (`training.folds.clustered`) with Student's t: the larger p counts, for few transients make
the one uncertain and flights that differ the other. p is of the whole table, by Holm.

`python -m eval.benchmarks.comparisons` of 5da55ff measured false claims and power.
"""  # noqa: E501 -- a table

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Literal

import numpy as np
from scipy.stats import binomtest
from scipy.stats import t as student

from data_prep.events import Event
from narxcal.support.arrays import BoolArray, FloatArray
from training.folds import clustered

LEVEL = 0.05  # family-wise
_POWER = 0.8
_LENGTH, _MOST = 8.0, 20  # of a stretch in correlation times, and how many
_EQUAL = 1e-9  # of the squared error: models that differ by rounding are one

UnitKind = Literal["flights", "stretches"]


@dataclass(frozen=True, eq=False)
class Recording:
    """One log: measured (time, channel) and the free run of every model.

    A model gives NaN for a channel that it does not have. `scored` (time,) are the rows that count,
    `events` those to judge Ti and Tt by. Recordings of one `flight`, their name without one, are no
    independent evidence.
    """

    name: str
    time_s: FloatArray
    channels: tuple[str, ...]
    measured: FloatArray
    outputs: Mapping[str, FloatArray]
    scored: BoolArray
    events: tuple[Event, ...] = ()
    flight: str = ""

    @property
    def unit(self) -> str:
        return self.flight or self.name


@dataclass(frozen=True)
class Difference:
    """Two models in one channel; `ratio` is the geometric mean over units of RMSE, better to worse.

    `low` and `high` bound the ratio with 95 % probability for this pair alone; `p` is of the whole
    table. `detectable` is the largest ratio below 1 that is found in 8 of 10 such tables.
    """

    channel: str
    better: str
    worse: str
    ratio: float
    low: float
    high: float
    p: float
    units: int
    unit: UnitKind
    detectable: float

    @property
    def significant(self) -> bool:
        return self.p <= LEVEL


@dataclass(frozen=True)
class PassDifference:
    """How many transients more one model passes of those that both are judged on."""

    better: str
    worse: str
    more: int
    p: float

    @property
    def significant(self) -> bool:
        return self.p <= LEVEL


def pass_differences(passed: Mapping[str, Sequence[FloatArray]]) -> list[PassDifference]:
    """Compare all pairs of models; `passed` has 1, 0 or NaN by transient, one array a flight."""
    pairs = list(combinations(passed, 2))
    gained = [[a - b for a, b in zip(passed[i], passed[j], strict=True)] for i, j in pairs]
    chances = _holm(np.array([_pass_p(each) for each in gained])).tolist()
    found = []
    for (first, second), each, p in zip(pairs, gained, chances, strict=True):
        more = round(float(np.nansum(np.concatenate(each))))
        better, worse = (first, second) if more >= 0 else (second, first)
        found.append(PassDifference(better, worse, abs(more), p))
    return found


def _pass_p(gained: Sequence[FloatArray]) -> float:
    """P of differences 1, 0, -1 or NaN by transient, one array a flight; the module says how."""
    known = np.concatenate([each[np.isfinite(each)] for each in gained])
    odd, won = int(np.count_nonzero(known)), int((known > 0.0).sum())
    alone = float(binomtest(won, odd).pvalue) if odd else 1.0
    mean, error, flights = clustered(gained)
    if flights < 2 or error == 0.0:
        return alone
    return max(alone, float(2.0 * student.sf(abs(mean) / error, flights - 1)))


@dataclass(frozen=True, eq=False)
class _Flight:
    """Errors (rows,) of two models in one channel, by engine; NaN where not scored."""

    a: tuple[FloatArray, ...]
    b: tuple[FloatArray, ...]
    dt_s: float

    def squares(self, count: int) -> FloatArray:
        """Sums of squares of a and b (stretches, 2); engines together, for they share the time."""
        parts = [
            [[np.nansum(part**2) for part in np.array_split(error, count)] for error in errors]
            for errors in (self.a, self.b)
        ]
        return np.asarray(np.sum(parts, axis=1).T)

    @property
    def stretches(self) -> int:
        longest = max(correlation_time(error, self.dt_s) for error in (*self.a, *self.b))
        shortest_s = min(len(error) for error in self.a) * self.dt_s
        return int(np.clip(shortest_s / (_LENGTH * longest), 1, _MOST))


@dataclass(frozen=True, eq=False)
class _Pair:
    """Two models in one channel over all flights."""

    channel: str
    models: tuple[str, str]
    flights: tuple[_Flight, ...]

    def units(self) -> tuple[FloatArray, UnitKind]:
        """R (units,) and what the units are."""
        if len(self.flights) > 1:
            return _log_ratios(np.concatenate([one.squares(1) for one in self.flights])), "flights"
        (one,) = self.flights
        return _log_ratios(one.squares(one.stretches)), "stretches"

    @property
    def overall(self) -> float:
        """ln(RMSE_a / RMSE_b) over all rows; 0 where the models are one."""
        a = np.concatenate([each for one in self.flights for each in one.a])
        b = np.concatenate([each for one in self.flights for each in one.b])
        first, second = float(np.nansum(a**2)), float(np.nansum(b**2))
        if np.nansum(np.abs(a**2 - b**2)) <= _EQUAL * max(first, second):
            return 0.0
        with np.errstate(divide="ignore"):
            return 0.5 * float(np.log(first) - np.log(second))


def correlation_time(error: FloatArray, dt_s: float) -> float:
    """Correlation time in s of an error (time,) about its mean; NaN is left out as zero."""
    known = np.isfinite(error)
    if not known.any():
        return dt_s
    centred = np.where(known, error - np.mean(error[known]), 0.0)
    spectrum = np.abs(np.fft.rfft(centred, 2 * len(centred))) ** 2
    covariance = np.fft.irfft(spectrum)[: len(centred)]
    if not covariance[0] > 0.0:
        return dt_s
    rho = covariance / covariance[0]
    ends = np.flatnonzero(rho <= 0.0)
    return float(dt_s * (0.5 + rho[1 : ends[0] if len(ends) else len(rho)].sum()))


def _log_ratios(sums: FloatArray) -> FloatArray:
    """R of the units (units, 2) in which both models err."""
    usable = (sums > 0.0).all(axis=1)
    return np.asarray(0.5 * np.log(sums[usable, 0] / sums[usable, 1]))


def differences(recordings: Sequence[Recording], models: Sequence[str]) -> list[Difference]:
    """Compare all pairs of models in all channels that both have, with p of the whole table."""
    pairs = [
        pair
        for first, second in combinations(models, 2)
        for channel in recordings[0].channels
        if (pair := _pair(recordings, (first, second), channel)) is not None
    ]
    tests = [(pair, *pair.units()) for pair in pairs]
    alone = np.array([_p(r) for _, r, _ in tests])
    return [_difference(test, p, len(tests)) for test, p in zip(tests, _holm(alone), strict=True)]


def _pair(recordings: Sequence[Recording], models: tuple[str, str], channel: str) -> _Pair | None:
    """Errors of two models by flight; None where one of them lacks the channel, or they are one."""
    at = recordings[0].channels.index(channel)
    flights = []
    for name in dict.fromkeys(one.unit for one in recordings):
        own = [one for one in recordings if one.unit == name]
        errors = [_errors(one, models, at) for one in own]
        errors = [both for both in errors if np.isfinite(both[0]).any()]
        if errors:
            a, b = zip(*errors, strict=True)
            flights.append(_Flight(a, b, float(np.median(np.diff(own[0].time_s)))))
    pair = _Pair(channel, models, tuple(flights))
    return pair if flights and pair.overall != 0.0 else None


def _errors(one: Recording, models: tuple[str, str], at: int) -> tuple[FloatArray, FloatArray]:
    """Errors (rows,) of two models, NaN where either is not scored."""
    a, b = (one.outputs[model][:, at] - one.measured[:, at] for model in models)
    known = one.scored & np.isfinite(a) & np.isfinite(b)
    return np.where(known, a, np.nan), np.where(known, b, np.nan)


def _p(r: FloatArray) -> float:
    if len(r) < 2:
        return 1.0
    error = float(np.std(r, ddof=1)) / np.sqrt(len(r))
    if error == 0.0:
        return 0.0 if np.mean(r) else 1.0
    return float(2.0 * student.sf(abs(float(np.mean(r))) / error, len(r) - 1))


def _holm(alone: FloatArray) -> FloatArray:
    order = np.argsort(alone)
    found = np.empty_like(alone)
    factors = len(alone) - np.arange(len(alone))
    found[order] = np.minimum(1.0, np.maximum.accumulate(factors * alone[order]))
    return found


def _difference(test: tuple[_Pair, FloatArray, UnitKind], p: float, tests: int) -> Difference:
    pair, r, kind = test
    overall, count = pair.overall, len(r)
    mean = float(np.mean(r)) if count else overall
    p = float(p) if mean * overall > 0.0 else 1.0
    first, second = pair.models
    better, worse = (first, second) if overall < 0.0 else (second, first)
    size = mean if overall < 0.0 else -mean
    if count < 2:
        ratio = float(np.exp(size))
        return Difference(pair.channel, better, worse, ratio, 0.0, np.inf, 1.0, count, kind, 0.0)
    error = float(np.std(r, ddof=1)) / np.sqrt(count)
    half = error * float(student.isf(0.5 * LEVEL, count - 1))
    reach = student.isf(0.5 * LEVEL / tests, count - 1) + student.isf(1.0 - _POWER, count - 1)
    low, ratio, high = np.exp([size - half, size, size + half]).tolist()
    detectable = float(np.exp(-error * reach))
    return Difference(pair.channel, better, worse, ratio, low, high, p, count, kind, detectable)
