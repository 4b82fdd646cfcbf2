"""Dual numbers in compiled code: slopes of every operation are those of central differences."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from narxcal.support.compiled import compiled
from narxcal.support.dual import WIDTH, clip, get, put, seeded


@compiled
def formulas(p, out):
    """Every operation, between two numbers and between a number and a constant."""
    a, b = get(p, 0), get(p, 1)
    put(out, 0, a + b)
    put(out, 1, a - 2.0 * b)
    put(out, 2, a * b + a * 3.0)
    put(out, 3, a / b + 1.0 / a)
    put(out, 4, math.exp(-a) / 2.0)
    put(out, 5, math.sqrt(a * a + b * b))
    put(out, 6, abs(a - b))
    put(out, 7, clip(a * b, -1.0, 1.0))
    put(out, 8, a if a > b else 2.0 * b)
    put(out, 9, b if a < 0.5 else a)
    put(out, 10, 4.0)
    for k in range(3):
        a = a + (k + 1) * b
    put(out, 11, a)


def values(a, b):
    out = np.zeros(12)
    formulas(np.array([a, b]), out)
    return out


NUMBERS = st.floats(0.2, 3.0)


@given(a=NUMBERS, b=NUMBERS)
def test_slopes_are_those_of_differences(a, b):
    if min(abs(a - b), abs(a * b - 1.0), abs(a - 0.5)) < 1e-4:
        return  # a corner
    out = np.full((12, 1 + WIDTH), np.nan)
    formulas(seeded(np.array([a, b]), np.array([1, 0])), out)
    np.testing.assert_allclose(out[:, 0], values(a, b), rtol=1e-14)
    step = 1e-6
    by_a = (values(a + step, b) - values(a - step, b)) / (2.0 * step)
    by_b = (values(a, b + step) - values(a, b - step)) / (2.0 * step)
    np.testing.assert_allclose(out[:, 1], by_b, rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(out[:, 2], by_a, rtol=1e-6, atol=1e-6)
    assert not out[:, 3:].any()


@pytest.mark.parametrize(("x", "inside"), [(-2.0, 0.0), (0.0, 1.0), (2.0, 0.0)])
def test_beyond_its_bounds_a_clipped_number_has_no_slope(x, inside):
    @compiled
    def clipped(p, out):
        put(out, (0, 0), clip(get(p, 0), -1.0, 1.0))

    out = np.zeros((1, 1, 1 + WIDTH))
    clipped(seeded(np.array([x]), np.array([0])), out)
    assert out[0, 0, 0] == np.clip(x, -1.0, 1.0)
    assert out[0, 0, 1] == inside
