"""A calibration gives the same numbers in one piece, sample by sample and in blocks."""

from itertools import pairwise

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from narxcal.calibration import DynamicCalibration, narx_features
from narxcal.errors import DataError
from narxcal.narx import NarxConfig, NarxModel, NarxNet, Scaling
from narxcal.steady_table import SteadyTable

TIME = np.arange(120)
LOG = np.column_stack([40 + 30 * np.sign(np.sin(TIME / 15)), np.linspace(0, 0.7, len(TIME))])


def calibration():
    torch.manual_seed(0)
    points = np.array([[0.0, 0.0], [0.0, 0.8], [78.0, 0.0], [78.0, 0.8]])
    settled = np.column_stack([20 + points[:, 0], 300 + points[:, 1]])
    steady = SteadyTable((("TRA_deg", "Mach"), ("N1_pct", "EGT_C")), points, settled)
    ss = steady.outputs(LOG)
    features = narx_features(ss, LOG[:, 1:])
    net = NarxNet(NarxConfig(lags=3, hidden=5, moving=2), features.shape[1], ss.shape[1])
    with torch.no_grad():
        for parameter in net.parameters():
            parameter.copy_(0.1 * torch.randn_like(parameter))
        net.low.fill_(-2.0)
        net.high.fill_(2.0)
    model = NarxModel(net.double(), Scaling.of(features), Scaling.of(ss, centred=False))
    return DynamicCalibration(steady, model, 1 / 32, ("Mach",))


@given(cuts=st.lists(st.integers(1, len(LOG) - 1), max_size=6, unique=True), start=st.booleans())
@settings(max_examples=30, deadline=None)
def test_blocks_of_any_size_give_the_numbers_of_one_simulation(cuts, start):
    model = calibration()
    first = np.array([55.0, 310.0]) if start else None
    whole = model.simulate(LOG, first)
    edges = [1, *sorted(cut for cut in cuts if cut > 1), len(LOG)]
    parts = [model.reset(LOG[0], first)[None]]
    parts += [model.extend(LOG[a:b]) for a, b in pairwise(edges)]
    np.testing.assert_allclose(np.concatenate(parts), whole, rtol=1e-12)


def test_steps_and_blocks_may_be_mixed():
    model = calibration()
    whole = model.simulate(LOG)
    found = [model.reset(LOG[0])[None], model.extend(LOG[1:40])]
    found += [model.step(row)[None] for row in LOG[40:60]]
    found += [model.extend(LOG[60:])]
    np.testing.assert_allclose(np.concatenate(found), whole, rtol=1e-12)


@pytest.mark.parametrize("size", [1, 50])
def test_the_first_block_of_all_starts_settled(size):
    np.testing.assert_allclose(
        calibration().extend(LOG[:size]), calibration().simulate(LOG[:size]), rtol=1e-12
    )


def test_a_block_with_a_missing_input_is_refused():
    inputs = LOG[:5].copy()
    inputs[3, 1] = np.nan
    with pytest.raises(DataError) as error:
        calibration().extend(inputs)
    assert str(error.value) == (
        "channel Mach, row 3: expected a finite input, found nan. "
        "Hold the last good value, or cut the log there"
    )
