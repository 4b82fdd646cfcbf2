"""Rates of a step's work are recovered from what steps cost."""

import numpy as np

from eval.benchmarks.step_costs import rates
from training.search import Rates, counted


def test_rates_are_recovered_and_their_costs_hold():
    true = Rates(200.0, 0.2, 0.03, 1e-3, 2e-5, 3e-5)
    draw = np.random.default_rng(0)
    sizes = [
        (samples, samples / every, size, kind)
        for samples in (500, 4000)
        for every in (1, 9)
        for size, kind in ((14, (0, 2)), (90, (0, 8)), (105, (8, 3)), (420, (16, 8)))
    ]
    rows = [(counted(*each), true.step(*each) * draw.uniform(0.99, 1.01)) for each in sizes]
    np.testing.assert_allclose(rates(rows), list(vars(true).values()), rtol=0.2)
