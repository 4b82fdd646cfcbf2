"""Residual tests: what remains in the residual that the model should have described.

Whiteness (autocorrelation) and independence of the inputs (cross-correlation at lags of both
signs: a positive lag is an effect of the input that the model misses, a negative one is feedback
from the output to the input), after Ljung, System Identification, section 16.6.

The band of a white residual is `z / sqrt(N)` with N the number of samples. (One tool divides by
the square root of 2N-1, the length of the two-sided correlation; its 95 % band then loses three
times as many lags of true white noise as it should.) A free-run residual is coloured by nature:
independence of the inputs is the test that counts there, and its band is widened by what the two
autocorrelations allow (Bartlett's formula).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.fft import irfft, next_fast_len, rfft
from scipy.special import ndtri

from narxcal.support.arrays import FloatArray, IntArray

# Chance of calling a white or independent residual dependent, over all lags of one test.
FALSE_ALARM = 0.01
_LONGEST_LAG_S = 10.0  # several time constants of a spool
_FEWEST_LAGS = 25  # as MATLAB's resid
_STRETCH = 2**14  # samples of one FFT: its arrays fit into the cache of a core


@dataclass(frozen=True, eq=False)
class Correlation:
    """Normalised correlation at `lags (lag,)` in samples.

    `deviation (lag,)` is the standard deviation of `values` under the null hypothesis.
    """

    lags: IntArray
    values: FloatArray
    deviation: FloatArray

    @property
    def band_95(self) -> FloatArray:
        return 1.96 * self.deviation


@dataclass(frozen=True)
class Dependence:
    """Verdict on a set of lags.

    `outside_95` is the share of lags outside the 95 % band (5 % expected of white noise). `ok` is
    false if the worst lag exceeds what the largest of that many would reach with a chance of 1 %
    (Bonferroni: holds for correlated lags too). Both are None without a lag that could be computed.
    """

    ok: bool | None
    outside_95: float | None


@dataclass(frozen=True, eq=False)
class ResidualTests:
    """Residual of one channel with itself and with each input, lags in samples of `dt_s`."""

    channel: str
    dt_s: float
    auto: Correlation
    cross: Mapping[str, Correlation]


def residual_tests(
    channel: str, residual: FloatArray, inputs: Mapping[str, FloatArray], dt_s: float
) -> ResidualTests:
    """Correlate one log's residual (time,) with itself and with `inputs` (time,).

    Lags reach to 10 s, and there are 25 of them at least.

    Inputs that never change are left out: they correlate with nothing.
    """
    lags = max(_FEWEST_LAGS, round(_LONGEST_LAG_S / dt_s))
    cross = {
        name: cross_correlation(values, residual, lags)
        for name, values in inputs.items()
        if np.isfinite(values).any() and np.nanmax(values) > np.nanmin(values)
    }
    return ResidualTests(channel, dt_s, autocorrelation(residual, lags), cross)


def autocorrelation(residual: FloatArray, lags: int) -> Correlation:
    """Correlate the residual (time,) with itself at lags 0 to `lags`, without its mean.

    Pairs with a NaN are left out.
    """
    centred = _standardised(residual)
    values, pairs = _pair_means(centred, centred, lags)
    forward = slice(lags, None)
    return Correlation(np.arange(lags + 1), values[forward], _white(pairs[forward]))


def cross_correlation(given: FloatArray, residual: FloatArray, lags: int) -> Correlation:
    """Correlate `given[t]` with `residual[t + lag]` (time,) at lags `-lags` to `lags`.

    The band allows for the autocorrelation of input and residual up to `lags`: variance
    `sum_k r_u(k) r_e(k) / N`.
    """
    moved, left = _standardised(given), _standardised(residual)
    values, pairs = _pair_means(moved, left, lags)
    own = _pair_means(moved, moved, lags)[0] * _pair_means(left, left, lags)[0]
    deviation = _white(pairs) * np.sqrt(max(1.0, float(np.nansum(own))))
    return Correlation(np.arange(-lags, lags + 1), values, deviation)


def whiteness(correlation: Correlation) -> Dependence:
    return _judge(correlation, correlation.lags > 0)


def independence(correlation: Correlation) -> Dependence:
    """Judge lags 0 and up: effects of the input that the model misses."""
    return _judge(correlation, correlation.lags >= 0)


def _judge(correlation: Correlation, chosen: NDArray[np.bool_]) -> Dependence:
    known = chosen & np.isfinite(correlation.values) & np.isfinite(correlation.deviation)
    if not known.any():
        return Dependence(None, None)
    size = np.abs(correlation.values[known])
    score = size / correlation.deviation[known]
    bound = -float(ndtri(FALSE_ALARM / (2 * len(score))))
    return Dependence(
        ok=bool(score.max() <= bound),
        outside_95=float(np.mean(size > correlation.band_95[known])),
    )


def _standardised(values: FloatArray) -> FloatArray:
    """Remove the mean and divide by the standard deviation; NaN of a constant."""
    known = values[np.isfinite(values)]
    spread = float(known.std()) if len(known) else 0.0
    if spread == 0.0:
        return np.full_like(values, np.nan)
    return np.asarray((values - known.mean()) / spread)


def _pair_means(first: FloatArray, second: FloatArray, lags: int) -> tuple[FloatArray, FloatArray]:
    """Mean of `first[t] * second[t + lag]` and number of pairs, lags `-lags` to `lags`."""
    known, other = np.isfinite(first), np.isfinite(second)
    sums = _lagged_sums(np.where(known, first, 0.0), np.where(other, second, 0.0), lags)
    pairs = np.round(_lagged_sums(known.astype(float), other.astype(float), lags))
    return np.divide(sums, pairs, out=np.full_like(sums, np.nan), where=pairs > 0), pairs


def _lagged_sums(first: FloatArray, second: FloatArray, lags: int) -> FloatArray:
    """Sum of `first[t] * second[t + lag]` over t, lags `-lags` to `lags`, by FFT.

    Spectra of short stretches are added: one FFT of a whole flight of hours takes several times as
    long and a gigabyte. Each stretch of `second` reaches `lags` beyond that of `first`.
    """
    # scipy.signal.correlate would do one stretch, at a second of importing it.
    size = next_fast_len(min(len(first), _STRETCH) + 2 * lags, real=True)
    step = size - 2 * lags
    around = np.concatenate((np.zeros(lags), second, np.zeros(lags)))
    spectrum = np.zeros(size // 2 + 1, dtype=np.complex128)
    for start in range(0, len(first), step):
        own = rfft(first[start : start + step], size)
        spectrum += np.conj(own) * rfft(around[start : start + size], size)
    return np.asarray(irfft(spectrum, size)[: 2 * lags + 1])


def _white(pairs: FloatArray) -> FloatArray:
    return np.divide(1.0, np.sqrt(pairs), out=np.full_like(pairs, np.nan), where=pairs > 0)
