"""Changed inputs give a result or a documented error: a fixed budget of `tests/fuzz.py`."""

import pytest

from tests.fuzz import fuzz


def no_failure(cases):
    counts, failures = fuzz(cases, seed=1)
    assert failures == []
    accepted = sum(n for (_, outcome), n in counts.items() if not outcome.endswith("Error"))
    assert 0.1 < accepted / counts.total() < 0.9  # changes neither too rough nor without effect


def test_some_changed_inputs():
    no_failure(range(100))


@pytest.mark.slow
def test_many_changed_inputs():
    no_failure(range(100, 4100))
