"""The compiled step of samples, blocks and whole logs against its twin of array operations."""

from itertools import pairwise

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from narxcal.calibration.register import OVERSHOOT, Parts, Register, Sample, stacked
from narxcal.lumped.engine import LumpedEngine
from narxcal.lumped.limited import LIMITED
from narxcal.narx import kernels
from narxcal.narx.module import NarxNet
from narxcal.narx.network import AT_START, NarxConfig, NarxModel, Scaling

INPUTS, OUTPUTS = ("ALT_ft", "Mach", "TRA_deg"), ("N1_pct", "N2_pct", "EGT_C")
CENTRE, HALF = np.array([60.0, 75.0, 500.0]), np.array([30.0, 20.0, 150.0])


class ArrayRegister(Register):
    """The register by array operations: slow for single samples, and the oracle."""

    def advance(self, inputs, ss):
        state, narx, network = self.state, self.parts.narx, self.network
        lagged = self._lags(inputs, ss)
        increments = np.diff(ss, axis=0, prepend=state.ss[None])
        features = stacked(increments, lagged, ss, inputs[:, self.parts.columns])
        rows = np.concatenate([state.past, narx.input_scaling.down(features)])
        newest = np.arange(len(state.past), len(rows))
        tapped = rows[newest[:, None] - network.taps].reshape(len(features), -1)
        limit = None
        if network.keep >= 0.0:
            envelope = kernels.fading(increments, state.fading, network.keep)
            limit = OVERSHOOT * envelope / narx.output_scaling.scale
        start = (AT_START, state.history[None].copy())
        deviation, fed = narx.weights.run(tapped, start, limit)[:2]
        state.history[:] = np.concatenate([deviation[-1], fed[-1, : -deviation.shape[1]]])
        state.past[:] = rows[len(features) :]
        state.ss[:] = ss[-1]
        total = narx.output_scaling.up(deviation)
        return total + lagged if lagged.shape[1] else total


def lags(seed):
    parameters = np.random.default_rng(seed).normal(scale=0.4, size=(3, len(LIMITED)))
    scales = {"centre": CENTRE, "half": HALF, "limit": np.array([40.0, 20.0, 150.0])}
    return LumpedEngine.of(OUTPUTS, {"parameters": parameters}, scales)


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
    """A register, its twin, and their log."""
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
    return Register(parts, start), ArrayRegister(parts, start), given[1:], ss[1:]


@given(
    case=registers(),
    cuts=st.sets(st.integers(1, 38), max_size=4),
    corrected=st.integers(0, 38),
    singly=st.booleans(),
)
def test_samples_blocks_and_the_whole_are_the_arrays(case, cuts, corrected, singly):
    compiled, twin, inputs, ss = case
    edges = sorted({0, corrected, len(ss), *(range(len(ss)) if singly else cuts)})
    found, expected = [], []
    for first, last in pairwise(edges):
        if first == corrected:
            compiled.correct(ss[first - 1] + np.array([0.5, np.nan, -3.0]))
        found.append(compiled.advance(inputs[first:last], ss[first:last]))
    for first, last in pairwise(sorted({0, corrected, len(ss)})):
        if first == corrected:
            twin.correct(ss[first - 1] + np.array([0.5, np.nan, -3.0]))
        expected.append(twin.advance(inputs[first:last], ss[first:last]))
    np.testing.assert_allclose(
        np.concatenate(found), np.concatenate(expected), rtol=1e-12, atol=1e-11
    )
    for ours, theirs in zip(compiled.state, twin.state, strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-12, atol=1e-11)
    np.testing.assert_allclose(compiled.lagged, twin.lagged, rtol=1e-12, atol=1e-11)


@pytest.mark.parametrize("moving", [3, 6])
def test_where_nothing_moves_a_step_says_exactly_nothing(moving):
    lag = lags(0) if moving == 6 else None
    config = NarxConfig(lags=2, taps=(0, 1), hidden=3, moving=moving)
    given_, ss = log(0)
    parts = Parts(network(config, 6 + (moving == 6) * 3), lag, 0.1, 4.0, INPUTS, [])
    parts.narx.input_scaling.centre[:moving] = 0.0
    register = Register(parts, Sample(given_[0], ss[0], np.zeros(3)))
    for _ in range(20):
        assert register.advance(given_[:1], ss[:1]).tolist() == [[0.0, 0.0, 0.0]]
