"""What sound logs of an engine show: scatter of levels between them, and steps within each.

**Between logs.** With x ~ N(mean, s^2) of the level or delay of a channel in each log, and u = x -
mean of the others, u of one more log has the variance s^2 (1 + 1 / n), and those u_i that were
seen, of logs left out in turn, show s with n - 1 degrees of freedom: sum (x_i - mean)^2 =
((n - 1) / n)^2 sum (u_i - mean u)^2. With

    ln s_c = ln m_c + a + b_c,   a ~ N(0, h^2) of the recorder,   b_c ~ N(0, g^2) of its channel

and a prior m, h, g, the other channels of the recorder show a, too. s_c is known to its posterior
distribution on a grid, and u is a mixture of normals.

**Within a log.** With the residual r in blocks of `BLOCK_S`, the height of a stretch is its mean
minus that of all other blocks. Model errors last as long as a manoeuvre or a regime does, so that
heights of sound logs depend on the length. The largest |height| among the stretches of a log is
taken for each octave of lengths

    L_k <= min(length, rest) < 2 L_k,   L_k = `LEAST_STRETCH_S` 2^k

A stretch is beyond what sound logs show if its height exceeds the limit of its octave, which comes
from the largest heights of left-out logs (a scan statistic with its null distribution measured, not
derived from a model of the errors; Glaz, Naus and Wallenstein 2001, Scan Statistics, chapter 3).
Their logarithms x are normal, with a conjugate prior for mean and variance:

    x_k ~ N(mu_k, v),   mu_k ~ N(ln m_k, v / p),   v ~ scaled inverse chi^2 (d, v_0)

so that x of one more log has Student's t distribution (Gelman et al. 2013, Bayesian Data Analysis,
section 3.3). The variance v is one of all channels; the octaves of a log are not independent and
count as one.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from scipy.optimize import brentq
from scipy.special import gammaln, logsumexp
from scipy.stats import norm as normal
from scipy.stats import t as student

from narxcal.channels import described
from narxcal.support.arrays import FloatArray, IntArray

_GRID = np.linspace(-6.0, 6.0, 97)
BLOCK_S = 5.0
LEAST_STRETCH_S = 60.0  # twice the longest lag of the models: shorter errors may be dynamics
_FINENESS = 8  # lengths per octave
Levels = Mapping[str, Sequence[float]]  # channel -> u of left-out logs
Heights = Mapping[int, Sequence[float]]  # octave -> largest heights of logs with such lengths


# ---------------------------------------------------------------- between logs


@dataclass(frozen=True)
class ScatterPrior:
    """Medians m over recorders, as a share of the level by unit and of delays; h and g.

    The values are most likely on the recorders at hand (`python -m eval.benchmarks.priors`
    of 2f9145a); `python -m eval.bench --recorders` leaves each of them out.
    """

    median: Mapping[str, float] = field(
        default_factory=lambda: {"%": 0.0074, "degC": 0.0057, "kg/h": 0.041}
    )
    other: float = 0.046
    delay_s: float = 0.16
    recorders: float = 1.47
    channels: float = 0.63

    def level(self, name: str) -> float:
        return self.median.get(described(name).unit, self.other)

    def of_levels(self, seen: Levels) -> dict[str, Scatter]:
        """What is known of the level of one more log in each channel."""
        return self._posteriors({name: (self.level(name), each) for name, each in seen.items()})

    def of_delays(self, seen: Levels) -> dict[str, Scatter]:
        return self._posteriors({name: (self.delay_s, each) for name, each in seen.items()})

    def log_evidence(self, levels: Levels, delays: Levels) -> float:
        """Logarithm of the probability density of what one recorder shows, up to a constant."""
        parts = (
            {name: (self.level(name), each) for name, each in levels.items()},
            {name: (self.delay_s, each) for name, each in delays.items()},
        )
        return sum(self._evidence(part) for part in parts)

    def _evidence(self, seen: Mapping[str, tuple[float, Sequence[float]]]) -> float:
        over = [self._log_over_channel(*each) for each in seen.values() if len(each[1]) > 1]
        total = np.sum([np.zeros(len(_GRID)), *over], axis=0)
        prior = -0.5 * (_GRID / self.recorders) ** 2
        return float(logsumexp(total + prior) - logsumexp(prior))

    @cached_property
    def _between(self) -> FloatArray:
        """Log density of ln s_c - ln m_c (rows) for each a (columns)."""
        found = -0.5 * ((_GRID[:, None] - _GRID[None, :]) / self.channels) ** 2
        return np.asarray(found - logsumexp(found, axis=0))

    def _log_over_channel(self, median: float, levels: Sequence[float]) -> FloatArray:
        own = _log_likelihood(median, levels)
        return np.asarray(logsumexp(self._between + own[:, None], axis=0))

    def _posteriors(self, seen: Mapping[str, tuple[float, Sequence[float]]]) -> dict[str, Scatter]:
        shown = {name: self._log_over_channel(*each) for name, each in seen.items()}
        found = {}
        for name, (median, levels) in seen.items():
            others = [each for other, each in shown.items() if other != name]
            a = np.sum([-0.5 * (_GRID / self.recorders) ** 2, *others], axis=0)
            log = _log_likelihood(median, levels) + logsumexp(self._between + a, axis=1)
            widened = np.sqrt(1.0 + 1.0 / max(len(levels), 1))
            found[name] = Scatter(median * np.exp(_GRID) * widened, np.exp(log - logsumexp(log)))
        return found


def _log_likelihood(median: float, levels: Sequence[float]) -> FloatArray:
    """Log likelihood of the scatters m exp(grid) by `levels`, up to a constant."""
    n, u = max(len(levels), 1), np.asarray(levels, dtype=np.float64)
    square = ((n - 1) / n) ** 2 * float(np.sum((u - u.mean()) ** 2)) if len(u) else 0.0
    size = np.log(median) + _GRID
    return np.asarray(-(n - 1) * size - 0.5 * square * np.exp(-2.0 * size))


@dataclass(frozen=True, eq=False)
class Scatter:
    """Posterior of one channel: a mixture of normals of standard deviations `sizes`."""

    sizes: FloatArray
    weights: FloatArray

    def tail(self, size: float) -> float:
        return float(self.weights @ (2.0 * normal.sf(abs(size) / self.sizes)))

    def log_density(self, level: float) -> float:
        each = np.exp(-0.5 * (level / self.sizes) ** 2) / (np.sqrt(2.0 * np.pi) * self.sizes)
        return float(np.log(self.weights @ each + 1e-300))

    def limit(self, share: float) -> float:
        """Size beyond which a level is with probability `share`."""
        low, high = np.log(self.sizes[0]) - 5.0, np.log(self.sizes[-1]) + 5.0
        return float(np.exp(brentq(lambda x: self.tail(np.exp(x)) - share, low, high)))


# ---------------------------------------------------------------- within a log


@dataclass(frozen=True, eq=False)
class Blocks:
    """Residual of one channel in medians over `BLOCK_S`: known blocks only, with middle times."""

    time_s: FloatArray
    r: FloatArray


@dataclass(frozen=True)
class Step:
    """A stretch of blocks `start:stop` by `height` above all others, over its limit by `excess`."""

    excess: float
    start: int
    stop: int
    height: float


@dataclass(frozen=True)
class StepPrior:
    """Prior of ln h over recorders: m at k = 0 and its factor per octave, sqrt(v_0), d and p.

    The values are most likely on the recorders at hand (`python -m eval.benchmarks.priors`
    of 2f9145a); `python -m eval.bench --recorders` leaves each of them out.
    """

    median: float = 0.026
    per_octave: float = 0.81
    spread: float = 0.65
    dof: float = 4.2
    logs: float = 0.34

    def limits(self, seen: Mapping[str, Heights], share: float) -> dict[str, dict[int, float]]:
        """Channel -> octave -> height that one more sound log exceeds with probability `share`."""
        logs = _logarithms(seen)
        total, dof = self.dof * self.spread**2, self.dof
        for own in filter(None, logs.values()):
            total += float(np.mean([np.sum((x - x.mean()) ** 2) for x in own.values()]))
            dof += float(np.mean([len(x) - 1.0 for x in own.values()]))
        tail = float(student.isf(share, dof)) * np.sqrt(total / dof)
        return {
            name: {k: self._limit(k, x, tail) for k, x in own.items()} for name, own in logs.items()
        }

    def log_evidence(self, seen: Mapping[str, Heights]) -> float:
        """Logarithm of the probability density of what one recorder shows, up to a constant."""
        count, square, log = 0.0, 0.0, 0.0
        for own in filter(None, _logarithms(seen).values()):
            n = np.array([len(x) for x in own.values()])
            off = np.array([x.mean() - self._log_median(k) for k, x in own.items()])
            within = np.array([np.sum((x - x.mean()) ** 2) for x in own.values()])
            count += float(n.mean())
            square += float(np.mean(within + n * self.logs / (n + self.logs) * off**2))
            log += float(np.mean(0.5 * np.log(self.logs / (self.logs + n))))
        prior = self.dof * self.spread**2
        log += float(gammaln(0.5 * (self.dof + count)) - gammaln(0.5 * self.dof))
        log += 0.5 * self.dof * np.log(prior)
        return float(log - 0.5 * (self.dof + count) * np.log(prior + square))

    def _limit(self, k: int, x: FloatArray, tail: float) -> float:
        weight = self.logs + len(x)
        centre = (self.logs * self._log_median(k) + x.sum()) / weight
        return float(np.exp(centre + tail * np.sqrt(1.0 + 1.0 / weight)))

    def _log_median(self, k: int) -> float:
        return float(np.log(self.median) + k * np.log(self.per_octave))


def _logarithms(seen: Mapping[str, Heights]) -> dict[str, dict[int, FloatArray]]:
    return {
        name: {k: np.log(np.maximum(each, 1e-9)) for k, each in own.items()}
        for name, own in seen.items()
    }


def heights(blocks: Blocks) -> dict[int, float]:
    """Octave k -> largest |height| of the stretches of such lengths."""
    found: dict[int, float] = {}
    for length, each in _scan(blocks.r):
        k = octave(length, len(blocks.r))
        found[k] = max(found.get(k, 0.0), float(np.abs(each).max()))
    return found


def octave(length: int, count: int) -> int:
    """Octave k of a stretch of `length` among `count` blocks; the rest may be the shorter part."""
    return int(np.log2(min(length, count - length) * BLOCK_S / LEAST_STRETCH_S))


def strongest_step(blocks: Blocks, limits: Mapping[int, float]) -> Step:
    """The stretch whose height exceeds the limit of its octave by the largest factor."""
    best, count = Step(0.0, 0, 0, 0.0), len(blocks.r)
    for length, each in _scan(blocks.r):
        limit = limits.get(octave(length, count), np.inf)
        start = int(np.argmax(np.abs(each)))
        excess = float(abs(each[start])) / limit
        if excess > best.excess:
            best = Step(excess, start, start + length, float(each[start]))
    return _refined(blocks.r, best) if best.excess > 0.0 else best


def _scan(r: FloatArray) -> Iterator[tuple[int, FloatArray]]:
    """Lengths of stretches, and the heights of those that begin at each block."""
    count, total = len(r), np.concatenate([[0.0], np.cumsum(r)])
    for length in _lengths(count):
        inside = total[length:] - total[:-length]
        yield length, inside / length - (total[-1] - inside) / (count - length)


def _lengths(count: int) -> IntArray:
    least = round(LEAST_STRETCH_S / BLOCK_S)
    if count < 2 * least:
        return np.empty(0, dtype=np.int64)
    octaves = np.log2((count - least) / least)
    found = least * 2.0 ** np.linspace(0.0, octaves, max(2, round(_FINENESS * octaves)))
    return np.unique(np.round(found).astype(np.int64))


def _refined(r: FloatArray, step: Step) -> Step:
    """Move both ends to where the two parts differ most, by the sum of squares between them."""
    count, total = len(r), np.concatenate([[0.0], np.cumsum(r)])
    reach = max(2, (step.stop - step.start) // _FINENESS)
    starts = np.arange(max(step.start - reach, 0), min(step.start + reach, count) + 1)
    stops = np.arange(max(step.stop - reach, 0), min(step.stop + reach, count) + 1)
    length = stops[None, :] - starts[:, None]
    valid = (length > 0) & (length < count)
    safe = np.where(valid, length, 1)
    inside = total[stops][None, :] - total[starts][:, None]
    height = inside / safe - (total[-1] - inside) / np.maximum(count - safe, 1)
    square = np.where(valid, height**2 * safe * (count - safe), -1.0)
    a, b = np.unravel_index(int(np.argmax(square)), square.shape)
    return Step(step.excess, int(starts[a]), int(stops[b]), float(height[a, b]))


@dataclass(frozen=True)
class Priors:
    """What is known of a recorder before its logs: scatter of levels and delays, steps."""

    scatter: ScatterPrior = field(default_factory=ScatterPrior)
    steps: StepPrior = field(default_factory=StepPrior)


PRIORS = Priors()
