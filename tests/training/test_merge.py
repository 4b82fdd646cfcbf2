"""Networks merged side by side compute exactly what each computed alone."""

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from narxcal.narx.config import NarxConfig
from narxcal.narx.module import NarxNet
from narxcal.narx.network import NarxModel, Scaling
from narxcal.record import Record
from training.network import Material, merge_models

INPUTS = 3


def single(config, seed):
    torch.manual_seed(seed)
    net = NarxNet(config, INPUTS, 1)
    net.low[:], net.high[:] = -0.5 - 0.1 * seed, 0.5 + 0.1 * seed
    shared = np.random.default_rng(0)
    own = np.random.default_rng(seed)
    inputs = Scaling(shared.normal(size=INPUTS), 1.0 + shared.random(INPUTS))
    return NarxModel(net, inputs, Scaling(own.normal(size=1), 1.0 + own.random(1)))


@settings(max_examples=15, deadline=None)
@given(
    lags=st.integers(1, 4),
    taps=st.sampled_from([(0,), (0, 1), (1, 3)]),
    moving=st.integers(0, 2),
    count=st.integers(1, 4),
)
def test_merged_networks_are_the_separate_ones(lags, taps, moving, count):
    config = NarxConfig(lags=lags, taps=taps, hidden=3, moving=moving)
    models = [single(config, seed) for seed in range(count)]
    merged = merge_models(models)
    u = np.random.default_rng(1).normal(size=(80, INPUTS))
    start = np.linspace(-0.2, 0.2, count)
    together = merged.simulate(u, start)
    for k, model in enumerate(models):
        alone = model.simulate(u, start[k : k + 1])[:, 0]
        np.testing.assert_allclose(together[:, k], alone, rtol=1e-12, atol=1e-13)
    lows = [model.bounds[0][0] for model in models]
    assert merged.bounds[0] == pytest.approx(lows)
    measured = np.random.default_rng(2).normal(size=(80, count))
    steps = merged.predict(u, measured)
    for k, model in enumerate(models):
        np.testing.assert_allclose(
            steps[1:, k], model.predict(u, measured[:, k : k + 1])[1:, 0], rtol=1e-12, atol=1e-13
        )


def test_one_network_is_left_as_it_is():
    model = single(NarxConfig(), 0)
    assert merge_models([model]) is model


def test_a_single_output_keeps_inputs_name_and_weight():
    weight = np.arange(4.0)
    record = Record(np.ones((4, 2)), np.arange(8.0).reshape(4, 2), "flight", weight)
    (part,) = Material([record], [], 0.1).of_output(1).records
    assert part.y.tolist() == [[1.0], [3.0], [5.0], [7.0]]
    assert part.u is record.u
    assert (part.name, part.weight) == ("flight", weight)
