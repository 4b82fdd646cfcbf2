"""The compiled step against its twin, a block of one sample."""

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from narxcal.calibration.register import Parts, Register, Sample
from narxcal.lumped.lag import PARAMETERS, LagModel
from narxcal.narx.network import NarxConfig, NarxModel, NarxNet, Scaling

INPUTS, OUTPUTS = ("ALT_ft", "Mach", "TRA_deg"), ("N1_pct", "N2_pct", "EGT_C")
CENTRE, HALF = np.array([60.0, 75.0, 500.0]), np.array([30.0, 20.0, 150.0])


def lags(seed):
    parameters = np.random.default_rng(seed).normal(scale=0.4, size=(3, len(PARAMETERS)))
    return LagModel(
        output_names=OUTPUTS,
        parameters=parameters,
        centre=CENTRE,
        half=HALF,
        limit=np.array([40.0, 20.0, 150.0]),
    )


def network(config, features):
    torch.manual_seed(1)
    net = NarxNet(config, features, 3)
    net.low[:], net.high[:] = -2.0, 2.0
    rng = np.random.default_rng(2)
    inputs = Scaling(rng.normal(size=features), rng.uniform(5.0, 60.0, features))
    return NarxModel(net, inputs, Scaling(np.zeros(3), np.array([2.0, 1.0, 15.0])))


def log(seed, samples=40):
    rng = np.random.default_rng(seed)
    ss = CENTRE + HALF * np.repeat(rng.uniform(-1.2, 1.2, (samples // 10, 3)), 10, axis=0)
    given = np.column_stack(
        [np.linspace(0.0, 42000.0, samples), np.linspace(0.0, 0.8, samples), ss[:, 0]]
    )
    return given, ss


@st.composite
def registers(draw):
    """Two registers alike, and their log."""
    with_lag, seed = draw(st.booleans()), draw(st.integers(0, 99))
    config = NarxConfig(
        lags=draw(st.integers(1, 3)),
        taps=draw(st.sampled_from([(0,), (0, 2), (1, 2, 5)])),
        hidden=3,
        moving=draw(st.sampled_from([0, 6 if with_lag else 3])),
    )
    columns = draw(st.sampled_from([[], [1], [0, 1]]))
    features = 6 + 3 * with_lag + len(columns)
    lag = lags(seed) if with_lag else None
    settle_s = draw(st.sampled_from([None, 4.0]))
    parts = Parts(network(config, features), lag, 0.1, settle_s, INPUTS, columns)
    given, ss = log(seed)
    start = Sample(given[0], ss[0], np.array([2.0, -1.0, 30.0]))
    return Register(parts, start), Register(parts, start), given[1:], ss[1:]


@settings(max_examples=40, deadline=None)
@given(case=registers(), corrected=st.integers(0, 38))
def test_a_step_is_a_block_of_one_sample(case, corrected):
    fast, slow, inputs, ss = case
    for k in range(len(ss)):
        if k == corrected:
            for register in (fast, slow):
                register.correct(ss[k - 1] + np.array([0.5, np.nan, -3.0]))
        found = fast.step(inputs[k], ss[k])
        expected = slow.extend(inputs[k : k + 1], ss[k : k + 1])[0]
        np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-11)


@settings(max_examples=20, deadline=None)
@given(case=registers(), cut=st.integers(1, 38))
def test_what_a_step_leaves_behind_is_what_a_block_leaves(case, cut):
    fast, slow, inputs, ss = case
    for given_, settled in zip(inputs[:cut], ss[:cut], strict=True):
        fast.step(given_, settled)
    slow.extend(inputs[:cut], ss[:cut])
    for ours, twin in zip(fast.memory, slow.memory, strict=True):
        np.testing.assert_allclose(ours, twin, rtol=1e-12, atol=1e-11)


@pytest.mark.parametrize("moving", [3, 6])
def test_where_nothing_moves_a_step_says_exactly_nothing(moving):
    lag = lags(0) if moving == 6 else None
    config = NarxConfig(lags=2, taps=(0, 1), hidden=3, moving=moving)
    given_, ss = log(0)
    parts = Parts(network(config, 6 + (moving == 6) * 3), lag, 0.1, 4.0, INPUTS, [])
    parts.narx.input_scaling.centre[:moving] = 0.0
    register = Register(parts, Sample(given_[0], ss[0], np.zeros(3)))
    for _ in range(20):
        assert register.step(given_[0], ss[0]).tolist() == [0.0, 0.0, 0.0]
