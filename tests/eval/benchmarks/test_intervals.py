"""Intervals of a run on virtual engines of which none was trained on."""

import numpy as np
import pytest

from eval.benchmarks.intervals import covered, write_fleet


@pytest.mark.slow
def test_most_samples_of_other_builds_lie_within_the_interval_of_four(tmp_path):
    """One fleet says little of the level; `python -m eval.bench --intervals` measures several."""
    write_fleet(tmp_path, (777, 0), 7)
    found = covered(tmp_path, 4, (4, 3))
    assert found.outputs == ("N1_pct", "N2_pct", "EGT_C")
    assert 0.75 < np.mean(found.coverage) < 1.0
    assert (found.half_width > 0.0).all()
    assert (found.half_width < [10.0, 10.0, 100.0]).all()
    assert np.exp(np.mean(np.log(found.hidden))) < 1.25
