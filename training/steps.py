"""Steps within a log: how far a stretch of a residual is from the rest, and how far sound ones are.

With r in blocks of `BLOCK_S`, the height of a stretch is its mean minus that of all other blocks.
Model errors last as long as a manoeuvre or a regime does, so that heights of sound logs depend on
the length. The largest |height| among the stretches of a log is taken for each octave of lengths

    L_k <= min(length, rest) < 2 L_k,   L_k = `LEAST_STRETCH_S` 2^k

A stretch is beyond what sound logs show if its height exceeds the limit of its octave, which comes
from the largest heights of left-out logs (a scan statistic with its null distribution measured, not
derived from a model of the errors; Glaz, Naus and Wallenstein 2001, Scan Statistics, chapter 3).
Their logarithms x are normal, with a conjugate prior for mean and variance:

    x_k ~ N(mu_k, v),   mu_k ~ N(ln m_k, v / p),   v ~ scaled inverse chi^2 (d, v_0)

so that x of one more log has Student's t distribution (Gelman et al. 2013, Bayesian Data Analysis,
section 3.3). The variance v is
one of all channels; the octaves of a log are not independent and count as one.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import gammaln
from scipy.stats import t as student

from narxcal.support.arrays import FloatArray, IntArray

BLOCK_S = 5.0
LEAST_STRETCH_S = 60.0  # twice the longest lag of the models: shorter errors may be dynamics
_FINENESS = 8  # lengths per octave


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


Seen = Mapping[int, Sequence[float]]  # octave -> largest heights of logs with such lengths


@dataclass(frozen=True)
class StepPrior:
    """Prior of ln h over recorders: m at k = 0 and its factor per octave, sqrt(v_0), d and p.

    The values are most likely on the recorders at hand (`python -m eval.benchmarks.priors`,
    which also leaves each of them out).
    """

    median: float = 0.026
    per_octave: float = 0.81
    spread: float = 0.65
    dof: float = 4.2
    logs: float = 0.34

    def limits(self, seen: Mapping[str, Seen], share: float) -> dict[str, dict[int, float]]:
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

    def log_evidence(self, seen: Mapping[str, Seen]) -> float:
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


def _logarithms(seen: Mapping[str, Seen]) -> dict[str, dict[int, FloatArray]]:
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
