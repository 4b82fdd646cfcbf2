"""Changed inputs give a result or a documented error: a fixed budget of `tests/fuzz.py`."""

import time

import pytest

from tests.fuzz import fuzz

TODAY = time.time_ns() // 10**9 // 86_400


@pytest.mark.parametrize(
    ("cases", "seed"), [(100, 1), pytest.param(1500, TODAY, marks=pytest.mark.slow, id="drawn")]
)
def test_changed_inputs(cases, seed):
    """The short part is always the same, the long one another one each day."""
    counts, failures = fuzz(cases, seed)
    assert failures == [], f"make fuzz N={cases} SEED={seed}"
    accepted = sum(n for (_, outcome), n in counts.items() if not outcome.endswith("Error"))
    assert 0.1 < accepted / counts.total() < 0.9  # changes neither too rough nor without effect
