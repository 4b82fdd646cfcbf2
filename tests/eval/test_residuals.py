"""Residual tests against a slow twin, an outside oracle and residuals of known dependence."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy.signal import lfilter

from eval.judging.residuals import (
    autocorrelation,
    cross_correlation,
    independence,
    whiteness,
)


def slow_correlation(u, e, lags):
    """Mean product over all valid pairs, one lag at a time."""
    u, e = ((x - np.nanmean(x)) / np.nanstd(x) for x in (u, e))
    values, counts = [], []
    for lag in range(-lags, lags + 1):
        products = [u[t] * e[t + lag] for t in range(len(u)) if 0 <= t + lag < len(e)]
        known = np.array(products)[np.isfinite(products)]
        values.append(known.mean() if len(known) else np.nan)
        counts.append(len(known))
    return np.array(values), np.array(counts)


@given(
    length=st.integers(3, 60),
    lags=st.integers(1, 30),
    gaps=st.floats(0.0, 0.5),
    stretch=st.integers(1, 30),
    seed=st.integers(0, 1000),
)
def test_fast_correlation_is_the_slow_one(length, lags, gaps, stretch, seed):
    """Logs of any length, also shorter than the lags, with gaps."""
    rng = np.random.default_rng(seed)
    u, e = rng.normal(size=length), rng.normal(size=length)
    e[rng.random(length) < gaps] = np.nan
    if np.isfinite(e).sum() < 2:
        return
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("eval.judging.residuals._STRETCH", stretch)
        found, own = cross_correlation(u, e, lags), autocorrelation(e, lags)
    values, counts = slow_correlation(u, e, lags)
    assert found.lags.tolist() == list(range(-lags, lags + 1))
    assert_allclose(found.values, values, atol=1e-9)
    assert_allclose(own.values, slow_correlation(e, e, lags)[0][lags:], atol=1e-9)
    counts = slow_correlation(e, e, lags)[1][lags:]
    assert_allclose(own.deviation[counts > 0], 1.0 / np.sqrt(counts[counts > 0]))


def test_autocorrelation_agrees_with_statsmodels():
    tools = pytest.importorskip("statsmodels.tsa.stattools", reason="statsmodels is not installed")
    e = np.random.default_rng(3).normal(size=300).cumsum()
    expected = tools.acf(e, adjusted=True, nlags=20, fft=False)
    assert_allclose(autocorrelation(e, 20).values, expected, atol=1e-10)


def test_white_noise_leaves_the_bands_as_often_as_they_say():
    """The trap of the limit 1.96 / sqrt(2N - 1): there 15 % of the lags would be outside."""
    rng = np.random.default_rng(5)
    verdicts = [whiteness(autocorrelation(rng.normal(size=1000), 25)) for _ in range(200)]
    assert np.mean([one.outside_95 for one in verdicts]) == pytest.approx(0.05, abs=0.01)
    assert sum(not one.ok for one in verdicts) <= 8
    band = autocorrelation(rng.normal(size=1000), 25).band_95
    assert_allclose(band[0], 1.96 / np.sqrt(1000))


def test_a_coloured_residual_is_not_white():
    e = np.random.default_rng(1).normal(size=2000)
    found = autocorrelation(e[1:] + 0.5 * e[:-1], 20)
    assert whiteness(found).ok is False
    assert found.values[1] == np.abs(found.values[1:]).max() == pytest.approx(0.4, abs=0.05)


def test_a_missed_effect_shows_at_its_positive_lag_and_feedback_at_none():
    rng = np.random.default_rng(2)
    u, noise = rng.normal(size=3000), rng.normal(size=3000)
    missed = cross_correlation(u, noise + 0.3 * np.roll(u, 4), 10)
    assert missed.lags[np.argmax(np.abs(missed.values))] == 4
    assert independence(missed).ok is False
    fed_back = cross_correlation(u + 0.3 * np.roll(noise, 6), noise, 10)
    assert fed_back.lags[np.argmax(np.abs(fed_back.values))] == -6
    assert independence(fed_back).ok is True


def test_the_band_keeps_its_level_for_slow_signals():
    """Slow input and slow residual that have nothing to do with each other."""
    rng = np.random.default_rng(4)

    def slow():
        return lfilter([1.0], [1.0, -0.9], rng.normal(size=3000))

    found = [cross_correlation(slow(), slow(), 60) for _ in range(40)]
    assert sum(independence(one).ok for one in found) >= 38


def test_a_constant_signal_gives_no_verdict():
    verdict = whiteness(autocorrelation(np.ones(50), 5))
    assert verdict.ok is None
    assert verdict.outside_95 is None
