"""Statistics of maximum-likelihood estimates: precision, coloured residuals, combination, tests.

Sources: Morelli and Klein, J. Aircraft 34(2), 1997 (coloured residuals); Andrews, Econometrica
59(3), 1991 (number of lags); Ljung and Box, Biometrika 65(2), 1978; Birge, Phys. Rev. 40, 1932;
Holm, Scand. J. Statistics 6(2), 1979.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import matmul_toeplitz
from scipy.signal import correlate
from scipy.stats import chi2, norm

from narxcal.support.arrays import FloatArray

# Eigenvalues of the scaled information matrix below this share of the largest count as zero: the
# square root of what rounding leaves of it in double precision.
_RANK = 1e-8
_PORTMANTEAU_LAGS = 20


@dataclass(frozen=True, eq=False)
class Information:
    """What an information matrix M (P, P) says: the Cramer-Rao covariance and what it leaves open.

    `unidentifiable` names the directions of parameter space that change no output; parameters in
    them have an infinite variance, and `rank` is the number of directions that are determined.
    `weakest` is the least determined direction of those that are.
    """

    covariance: FloatArray
    rank: int
    unidentifiable: tuple[str, ...]
    weakest: str

    @property
    def sd(self) -> FloatArray:
        """Cramer-Rao standard deviations (P,)."""
        return np.sqrt(np.diag(self.covariance))


def information(matrix: FloatArray, names: Sequence[str]) -> Information:
    """Invert M in the space that the data determine, scaled to a unit diagonal."""
    diagonal = np.diag(matrix)
    scale = np.where(diagonal > 0, 1.0 / np.sqrt(np.where(diagonal > 0, diagonal, 1.0)), 1.0)
    values, vectors = np.linalg.eigh(matrix * np.outer(scale, scale))
    known = values > _RANK * values.max(initial=0.0)
    inverse = (vectors[:, known] / values[known]) @ vectors[:, known].T
    covariance = inverse * np.outer(scale, scale)
    # A parameter with a part in the null space of more than rounding can take any value.
    open_ended = (vectors[:, ~known] ** 2).sum(axis=1) > _RANK
    covariance[open_ended, open_ended] = np.inf
    directions = tuple(_direction(vector, names) for vector in vectors[:, ~known].T)
    first = int(np.argmax(known)) if known.any() else 0
    weakest = _direction(vectors[:, first], names) if known.any() else ""
    return Information(covariance, int(known.sum()), directions, weakest)


def _direction(vector: FloatArray, names: Sequence[str]) -> str:
    """Name the components of at least 30 % of the largest, largest first, in units of 1/sqrt(M)."""
    size = np.round(np.abs(vector) / np.abs(vector).max(), 6)
    order = np.argsort(-size, kind="stable")
    largest = vector[order[0]]
    parts = [j for j in order if size[j] >= 0.3]
    return ", ".join(f"{names[j]} ({vector[j] / largest:+.2f})" for j in parts)


def coloured_covariance(
    covariance: FloatArray,
    sensitivities: Sequence[FloatArray],
    residuals: Sequence[FloatArray],
    sigma: FloatArray,
) -> FloatArray:
    """Covariance (P, P) of the estimates when residuals are coloured (Morelli and Klein).

        Cov = M^-1 [ sum_i sum_j S_i' R^-1 Rvv(i - j) R^-1 S_j ] M^-1

    `sensitivities` (time, p, P) and `residuals` (time, p) are per record, 0 where masked; sums stay
    within records. Rvv is the biased autocovariance under a Bartlett window, which keeps the sum
    positive semidefinite; outputs are taken as uncorrelated with each other.
    """
    middle = np.zeros_like(covariance)
    for output, sd in enumerate(sigma):
        own = [residual[:, output] for residual in residuals]
        auto = autocovariance(own)
        for record in sensitivities:
            weighted = record[:, output] / sd**2
            lags = np.zeros(len(weighted))
            lags[: len(auto)] = auto[: len(lags)]
            middle += weighted.T @ matmul_toeplitz(lags, weighted)
    finite = np.isfinite(np.diag(covariance))
    inverse = np.where(np.outer(finite, finite), covariance, 0.0)
    result: FloatArray = inverse @ middle @ inverse
    result[~finite, ~finite] = np.inf
    return result


def autocovariance(residuals: Sequence[FloatArray]) -> FloatArray:
    """Biased autocovariance (lags,) over records, under a Bartlett window.

    The number of lags is Andrews' for a first-order autoregression of the same lag-1 correlation,
    1.1447 (4 rho^2 / ((1 - rho)^2 (1 + rho)^2) N)^(1/3), at most a fifth of the shortest record.
    """
    length = min(len(residual) for residual in residuals)
    count = max(sum(int(np.count_nonzero(residual)) for residual in residuals), 1)
    total = np.zeros(length)
    for residual in residuals:
        both = correlate(residual, residual, "full", "fft")
        total += both[len(residual) - 1 : len(residual) - 1 + length]
    rho = float(np.clip(total[1] / total[0], -0.999, 0.999)) if total[0] > 0 else 0.0
    growth = 4.0 * rho**2 / ((1.0 - rho) ** 2 * (1.0 + rho) ** 2)
    lags = int(np.clip(np.ceil(1.1447 * (growth * length) ** (1.0 / 3.0)), 1, max(length // 5, 1)))
    return np.asarray(total[:lags] * (1.0 - np.arange(lags) / lags) / count)


def whiteness(residuals: Sequence[FloatArray]) -> float:
    """P value of the hypothesis that no output's residuals are correlated in time.

    Ljung and Box's test with 20 lags, summed over records; the smallest p of the outputs, times
    their number (Bonferroni). Masked samples are 0.
    """
    p_values = []
    for output in range(residuals[0].shape[1]):
        statistic, freedom = 0.0, 0
        for residual in residuals:
            v = residual[:, output]
            n, lags = len(v), min(_PORTMANTEAU_LAGS, len(v) // 5)
            power = float(v @ v)
            if power > 0 and lags > 0:
                rho = np.array([v[k:] @ v[:-k] for k in range(1, lags + 1)]) / power
                statistic += n * (n + 2) * float((rho**2 / (n - np.arange(1, lags + 1))).sum())
                freedom += lags
        p_values.append(float(chi2.sf(statistic, freedom)) if freedom else 1.0)
    return min(1.0, min(p_values) * len(p_values))


@dataclass(frozen=True)
class Combined:
    """Mean of repeated estimates, weighted by 1/sd^2.

    `sd` is the formal one; `birge` is the ratio of scatter between runs to reported standard
    deviation, sqrt(chi2 / (n - 1)).
    """

    value: float
    sd: float
    birge: float


def combine(estimates: Sequence[float] | FloatArray, sd: Sequence[float] | FloatArray) -> Combined:
    """Combine estimates (runs,) of one quantity by their standard deviations (runs,).

    Infinite standard deviations have no weight; without any finite one the result is infinite.
    """
    values, spread = np.asarray(estimates), np.asarray(sd)
    known = np.isfinite(spread) & (spread > 0)
    if not known.any():
        return Combined(float(np.mean(values)), float("inf"), 1.0)
    values, weights = values[known], 1.0 / spread[known] ** 2
    mean = float((weights * values).sum() / weights.sum())
    squares = float((weights * (values - mean) ** 2).sum())
    birge = np.sqrt(squares / (len(values) - 1)) if len(values) > 1 else 1.0
    return Combined(mean, float(weights.sum() ** -0.5), float(birge))


@dataclass(frozen=True)
class Difference:
    """One parameter of two engines; `p_holm` is adjusted for the number of parameters compared."""

    name: str
    left: float
    right: float
    z: float
    p_holm: float
    level: float

    @property
    def percent(self) -> float:
        """100 (right - left) / |left|; NaN for a left value of 0."""
        return 100.0 * (self.right - self.left) / abs(self.left) if self.left else float("nan")

    @property
    def significant(self) -> bool:
        """Whether the difference is significant at the family-wise level."""
        return self.p_holm < self.level


Estimates = Mapping[str, tuple[float, float]]


def compare(left: Estimates, right: Estimates, level: float = 0.05) -> list[Difference]:
    """Compare (value, sd) by name: z = (right - left) / sqrt(sum of variances), Holm's procedure.

    Parameters of only one engine, or fixed in both (sd = 0) or unidentifiable, are left out.
    """
    found = []
    for name in left:
        if name in right:
            (a, sd_a), (b, sd_b) = left[name], right[name]
            spread = np.hypot(sd_a, sd_b)
            if 0 < spread < np.inf:
                found.append((name, a, b, float((b - a) / spread)))
    raw = np.array([2.0 * norm.sf(abs(z)) for *_, z in found])
    adjusted, order = np.ones(len(raw)), np.argsort(raw)
    steps = raw[order] * (len(raw) - np.arange(len(raw)))
    adjusted[order] = np.minimum(1.0, np.maximum.accumulate(steps)) if len(raw) else steps
    return [Difference(*one, float(p), level) for one, p in zip(found, adjusted, strict=True)]


def propagate(
    function: Callable[[Mapping[str, complex]], complex],
    values: Mapping[str, float],
    covariance: FloatArray,
) -> tuple[float, float]:
    """Value and standard deviation of a function of estimates, to first order.

    `values` are in the order of `covariance` (P, P); the gradient is taken by complex steps.
    """
    step = 1e-20
    gradient = np.array([
        complex(function({**values, name: complex(value, step)})).imag / step
        for name, value in values.items()
    ])  # fmt: skip
    value = complex(function(values)).real
    return value, float(np.sqrt(gradient @ covariance @ gradient))
