"""Crossings of a response that is known sample by sample."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from eval.response import HIGH, LOW, low_and_high_crossing


@pytest.mark.parametrize("mode", ["interpolated", "nearest"])
@pytest.mark.parametrize("hits", [(LOW,), (HIGH,), (LOW, HIGH), (LOW, LOW, HIGH, HIGH)])
def test_a_sample_on_the_level_itself_is_the_crossing(mode, hits):
    """Noise-free logs do hit a level exactly, and stay there."""
    share = np.array(sorted([0.0, 0.0, 0.05, 0.5, 0.97, 1.0, 1.0, *hits]))
    time_s = 0.25 * np.arange(len(share))
    found = low_and_high_crossing(time_s, share, 1, 0.0, mode)
    for level, at_s in zip((LOW, HIGH), found, strict=True):
        if level in hits:
            assert at_s == pytest.approx(time_s[share == level][0])


@given(st.lists(st.integers(0, 20), min_size=1, max_size=30))
def test_any_noise_free_response_crosses_both_levels_in_order(steps):
    """In twentieths, so that levels are hit often; the response goes back and forth."""
    share = np.array([0, 0, *steps, 20, 20]) / 20.0
    low_s, high_s = low_and_high_crossing(
        np.arange(len(share), dtype=float), share, 1, 0.0, "interpolated"
    )
    assert 0.0 < low_s <= high_s < len(share) - 1
    assert np.interp([low_s, high_s], np.arange(len(share)), share) == pytest.approx([LOW, HIGH])
