"""Residual tests against a slow twin, an outside oracle and residuals of known dependence."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy.signal import lfilter

from eval.residuals import (
    autocorrelation,
    cross_correlation,
    independence,
    whiteness,
)
from narxcal.support.errors import DataError


def slow_correlation(first, second, lags):
    """Mean product over all valid pairs, one lag at a time, records apart."""
    flat_u, flat_e = np.concatenate(first), np.concatenate(second)
    mean_u, mean_e = np.nanmean(flat_u), np.nanmean(flat_e)
    scale = np.nanstd(flat_u) * np.nanstd(flat_e)
    values, counts = [], []
    for lag in range(-lags, lags + 1):
        products = [
            (u[t] - mean_u) * (e[t + lag] - mean_e)
            for u, e in zip(first, second, strict=True)
            for t in range(len(u))
            if 0 <= t + lag < len(e)
        ]
        known = np.array(products)[np.isfinite(products)] if products else np.array([])
        values.append(known.mean() / scale if len(known) else np.nan)
        counts.append(len(known))
    return np.array(values), np.array(counts)


@given(
    lengths=st.lists(st.integers(1, 25), min_size=1, max_size=3),
    lags=st.integers(1, 30),
    gaps=st.floats(0.0, 0.5),
    stretch=st.integers(1, 30),
    seed=st.integers(0, 1000),
)
@settings(deadline=None, max_examples=40)
def test_fast_correlation_is_the_slow_one(lengths, lags, gaps, stretch, seed):
    """Logs of any length, also shorter than the lags, with gaps; no pair crosses two logs."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("eval.residuals._STRETCH", stretch)
        _compare_with_slow(lengths, lags, gaps, seed)


def _compare_with_slow(lengths, lags, gaps, seed):
    rng = np.random.default_rng(seed)
    first = [rng.normal(size=n) for n in lengths]
    second = [np.where(rng.random(n) < gaps, np.nan, rng.normal(size=n)) for n in lengths]
    if np.isfinite(np.concatenate(second)).sum() < 2 or sum(lengths) < 2:
        return
    found = cross_correlation(first, second, lags)
    values, counts = slow_correlation(first, second, lags)
    assert found.lags.tolist() == list(range(-lags, lags + 1))
    assert_allclose(found.values, values, atol=1e-9)
    assert_allclose(found.deviation[counts > 0], 1.0 / np.sqrt(counts[counts > 0]))
    own = autocorrelation(second, lags)
    assert_allclose(own.values, slow_correlation(second, second, lags)[0][lags:], atol=1e-9)


def test_autocorrelation_agrees_with_statsmodels():
    tools = pytest.importorskip("statsmodels.tsa.stattools", reason="statsmodels is not installed")
    e = np.random.default_rng(3).normal(size=300).cumsum()
    expected = tools.acf(e, adjusted=True, nlags=20, fft=False)
    assert_allclose(autocorrelation([e], 20).values, expected, atol=1e-10)


def test_white_noise_leaves_the_bands_as_often_as_they_say():
    """The trap of the limit 1.96 / sqrt(2N - 1): there 15 % of the lags would be outside."""
    rng = np.random.default_rng(5)
    verdicts = [whiteness(autocorrelation([rng.normal(size=1000)], 25)) for _ in range(200)]
    assert np.mean([one.outside_95 for one in verdicts]) == pytest.approx(0.05, abs=0.01)
    assert sum(not one.ok for one in verdicts) <= 8
    band = autocorrelation([rng.normal(size=1000)], 25).band_95
    assert_allclose(band[0], 1.96 / np.sqrt(1000))


def test_a_coloured_residual_is_not_white():
    e = np.random.default_rng(1).normal(size=2000)
    found = autocorrelation([e[1:] + 0.5 * e[:-1]], 20)
    assert whiteness(found).ok is False
    assert found.values[1] == np.abs(found.values[1:]).max() == pytest.approx(0.4, abs=0.05)


def test_a_missed_effect_shows_at_its_positive_lag_and_feedback_at_none():
    rng = np.random.default_rng(2)
    u, noise = rng.normal(size=3000), rng.normal(size=3000)
    missed = cross_correlation([u], [noise + 0.3 * np.roll(u, 4)], 10)
    assert missed.lags[np.argmax(np.abs(missed.values))] == 4
    assert independence(missed).ok is False
    fed_back = cross_correlation([u + 0.3 * np.roll(noise, 6)], [noise], 10)
    assert fed_back.lags[np.argmax(np.abs(fed_back.values))] == -6
    assert independence(fed_back).ok is True


def test_the_coloured_band_keeps_its_level_for_slow_signals():
    """Slow input and slow residual that have nothing to do with each other.

    The plain band of white noise calls most of them dependent.
    """
    rng = np.random.default_rng(4)

    def slow():
        return lfilter([1.0], [1.0, -0.9], rng.normal(size=3000))

    pairs = [(slow(), slow()) for _ in range(40)]
    plain = [independence(cross_correlation([u], [e], 60)).ok for u, e in pairs]
    widened = [independence(cross_correlation([u], [e], 60, coloured=True)).ok for u, e in pairs]
    assert sum(plain) < 20
    assert sum(widened) >= 38


def test_a_constant_signal_gives_no_verdict():
    verdict = whiteness(autocorrelation([np.ones(50)], 5))
    assert verdict.ok is None
    assert verdict.outside_95 is None


def test_arguments_that_do_not_fit_are_refused():
    with pytest.raises(DataError, match=r"^expected at least 1 lag, got 0$"):
        autocorrelation([np.zeros(5)], 0)
    with pytest.raises(
        DataError,
        match=r"^expected inputs and residuals of the same logs, got shapes \[\(5,\)\] "
        r"and \[\(4,\)\]$",
    ):
        cross_correlation([np.zeros(5)], [np.zeros(4)], 2)
    with pytest.raises(DataError, match=r"^expected records of shape \(time,\), got \[\(5, 1\)\]$"):
        autocorrelation([np.zeros((5, 1))], 2)
