"""How far one log of an engine lies from its other logs, in the level or delay of a channel.

With x ~ N(mean, s^2) of each log and u = x - mean of the others, u of one more log has the variance
s^2 (1 + 1 / n), and those u_i that were seen, of logs left out in turn, show s with n - 1 degrees
of freedom: sum (x_i - mean)^2 = ((n - 1) / n)^2 sum (u_i - mean u)^2. With

    ln s_c = ln m_c + a + b_c,   a ~ N(0, h^2) of the recorder,   b_c ~ N(0, g^2) of its channel

and a prior m, h, g, the other channels of the recorder show a, too. s_c is known to its posterior
distribution on a grid, and u is a mixture of normals.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from scipy.optimize import brentq
from scipy.special import logsumexp
from scipy.stats import norm as normal

from narxcal.channels import described
from narxcal.support.arrays import FloatArray

_GRID = np.linspace(-6.0, 6.0, 97)
Seen = Mapping[str, Sequence[float]]  # channel -> u of left-out logs


@dataclass(frozen=True)
class ScatterPrior:
    """Medians m over recorders, as a share of the level by unit and of delays; h and g.

    The values are most likely on the recorders at hand (`python -m eval.benchmarks.priors`,
    which also leaves each of them out).
    """

    median: Mapping[str, float] = field(
        default_factory=lambda: {"%": 0.0074, "degC": 0.0057, "kg/h": 0.041}
    )
    other: float = 0.046
    delay_s: float = 0.16
    recorders: float = 1.47
    channels: float = 0.63

    def level(self, name: str) -> float:
        """M of the levels of a channel."""
        return self.median.get(described(name).unit, self.other)

    def of_levels(self, seen: Seen) -> dict[str, Scatter]:
        """What is known of the level of one more log in each channel."""
        return self._posteriors({name: (self.level(name), each) for name, each in seen.items()})

    def of_delays(self, seen: Seen) -> dict[str, Scatter]:
        """What is known of the delay of each channel in one more log."""
        return self._posteriors({name: (self.delay_s, each) for name, each in seen.items()})

    def log_evidence(self, levels: Seen, delays: Seen) -> float:
        """Logarithm of the probability density of what one recorder shows, up to a constant."""
        parts = (
            {name: (self.level(name), each) for name, each in levels.items()},
            {name: (self.delay_s, each) for name, each in delays.items()},
        )
        return sum(self._evidence(part) for part in parts)

    def _evidence(self, seen: Mapping[str, tuple[float, Sequence[float]]]) -> float:
        over = [self._log_over_channel(*each) for each in seen.values() if len(each[1]) > 1]
        total = np.sum([np.zeros(len(_GRID)), *over], axis=0)
        return float(logsumexp(total - 0.5 * (_GRID / self.recorders) ** 2) - self._log_recorders)

    @property
    def _log_recorders(self) -> float:
        return float(logsumexp(-0.5 * (_GRID / self.recorders) ** 2))

    @cached_property
    def _between(self) -> FloatArray:
        """Log density of ln s_c - ln m_c (rows) for each a (columns)."""
        found = -0.5 * ((_GRID[:, None] - _GRID[None, :]) / self.channels) ** 2
        return np.asarray(found - logsumexp(found, axis=0))

    def _log_over_channel(self, median: float, levels: Sequence[float]) -> FloatArray:
        """Log likelihood of each a by one channel."""
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
        """Probability of a level beyond `size`, of either sign."""
        return float(self.weights @ (2.0 * normal.sf(abs(size) / self.sizes)))

    def log_density(self, level: float) -> float:
        """Logarithm of the probability density of a level."""
        each = np.exp(-0.5 * (level / self.sizes) ** 2) / (np.sqrt(2.0 * np.pi) * self.sizes)
        return float(np.log(self.weights @ each + 1e-300))

    def limit(self, share: float) -> float:
        """Size beyond which a level is with probability `share`."""
        low, high = np.log(self.sizes[0]) - 5.0, np.log(self.sizes[-1]) + 5.0
        return float(np.exp(brentq(lambda x: self.tail(np.exp(x)) - share, low, high)))
