"""The compiled interpolation against SciPy's."""

import time

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from scipy.interpolate import RegularGridInterpolator

from narxcal.steady.table import Multilinear


@given(
    lengths=st.lists(st.integers(2, 5), min_size=1, max_size=4),
    outputs=st.integers(1, 3),
    seed=st.integers(0, 1000),
)
def test_it_gives_what_the_slow_twin_gives(lengths, outputs, seed):
    rng = np.random.default_rng(seed)
    axes = [np.cumsum(rng.uniform(0.1, 100.0, length)) for length in lengths]
    values = rng.normal(size=(*lengths, outputs))
    low, high = np.array([a[0] for a in axes]), np.array([a[-1] for a in axes])
    inputs = rng.uniform(low, high, (50, len(axes)))
    inputs[:5], inputs[5:10] = low, high
    twin = RegularGridInterpolator(tuple(axes), values)
    np.testing.assert_allclose(Multilinear.of(axes, values)(inputs), twin(inputs), atol=1e-12)


def test_each_input_is_held_at_the_end_of_its_axis():
    axes = [np.array([0.0, 1.0]), np.array([0.0, 2.0])]
    grid = Multilinear.of(axes, np.arange(4.0).reshape(2, 2, 1))
    found = grid(np.array([[-5.0, 1.0], [9.0, -1.0], [1e300, 1e300]]))
    np.testing.assert_allclose(found[:, 0], [0.5, 2.0, 3.0])


def test_one_sample_of_a_four_dimensional_table_is_looked_up_by_compiled_code():
    axes = [np.linspace(0, 1, 10)] * 4
    grid = Multilinear.of(axes, np.zeros((10, 10, 10, 10, 3)))
    sample = np.full((1, 4), 0.37)
    grid(sample)
    start = time.perf_counter()
    for _ in range(1000):
        grid(sample)
    # Some 10 us each; to prepare or compile anything per sample would take milliseconds.
    assert (time.perf_counter() - start) / 1000 < 2e-3
