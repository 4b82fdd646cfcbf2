"""Theil's split adds up, and each part answers to what it is named after."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from eval.diagnosis.where import theil, theil_of

series = arrays(np.float64, 30, elements=st.floats(-100.0, 100.0))


@given(series, series)
def test_it_is_the_textbook_formula(real, sim):
    found = theil(real, sim)
    mean_square = np.mean((real - sim) ** 2)
    if mean_square < 1e-6:
        return
    assert found.bias == pytest.approx((real.mean() - sim.mean()) ** 2 / mean_square)
    covariance = np.mean((real - real.mean()) * (sim - sim.mean()))
    unlike = 2.0 * (real.std() * sim.std() - covariance) / mean_square
    assert found.covariance == pytest.approx(unlike, abs=1e-6)
    assert sum(found[:3]) == pytest.approx(1.0)
    assert 0.0 <= found.inequality <= 1.0 + 1e-9


def test_offset_size_and_shape_are_told_apart():
    wave = np.sin(np.linspace(0.0, 20.0 * np.pi, 1000))
    assert theil(wave + 1.0, wave).bias == pytest.approx(1.0)
    assert theil(2.0 * wave, wave).variance == pytest.approx(1.0, abs=1e-2)
    assert theil(np.roll(wave, 20), wave).covariance == pytest.approx(1.0, abs=1e-2)


def test_equal_series_and_unknown_samples():
    wave = np.arange(10.0)
    assert theil(wave, wave) == (0.0, 0.0, 0.0, 0.0)
    assert theil(np.full(10, np.nan), wave) == (0.0, 0.0, 0.0, 0.0)
    holed = np.where(np.arange(10) == 4, np.nan, wave + 1.0)
    assert theil(holed, wave).bias == pytest.approx(1.0)


def test_every_output_has_its_split(make_data, probe):
    found = theil_of(make_data(probe))
    assert set(found) == {"N1_pct", "N2_pct", "EGT_C"}
    assert found["EGT_C"].covariance > 0.8
    assert found["EGT_C"].inequality > 5.0 * found["N1_pct"].inequality
