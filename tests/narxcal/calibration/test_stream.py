"""A calibration gives the same numbers in one piece, sample by sample and in blocks."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from narxcal.support.errors import DataError

TIME = np.arange(120)
LOG = np.column_stack([40 + 30 * np.sign(np.sin(TIME / 15)), np.linspace(0, 0.7, len(TIME))])


@pytest.fixture(scope="module")
def model(plane, calibrated):
    return calibrated(plane, LOG)


@given(cuts=st.lists(st.integers(1, len(LOG) - 1), max_size=6, unique=True), start=st.booleans())
def test_blocks_of_any_size_give_the_numbers_of_one_simulation(model, cuts, start):
    first = np.array([55.0, 310.0]) if start else None
    whole = model.simulate(LOG, first)
    edges = [1, *sorted(cut for cut in cuts if cut > 1), len(LOG)]
    parts = [model.reset(LOG[0], first)[None]]
    parts += [model.extend(LOG[a:b]) for a, b in pairwise(edges)]
    np.testing.assert_allclose(np.concatenate(parts), whole, rtol=1e-12)


def test_steps_and_blocks_may_be_mixed(model):
    whole = model.simulate(LOG)
    found = [model.reset(LOG[0])[None], model.extend(LOG[1:40])]
    found += [model.step(row)[None] for row in LOG[40:60]]
    found += [model.extend(LOG[60:])]
    np.testing.assert_allclose(np.concatenate(found), whole, rtol=1e-12)


@pytest.mark.parametrize("size", [1, 50])
def test_the_first_block_of_all_starts_settled(plane, calibrated, size):
    fresh = calibrated(plane, LOG)
    np.testing.assert_allclose(fresh.extend(LOG[:size]), fresh.simulate(LOG[:size]), rtol=1e-12)


def test_a_block_with_a_missing_input_is_refused(model):
    inputs = LOG[:5].copy()
    inputs[3, 1] = np.nan
    with pytest.raises(DataError) as error:
        model.extend(inputs)
    assert str(error.value) == (
        "channel Mach, row 3: expected a finite input, found nan. "
        "Hold the last good value, or cut the log there"
    )
