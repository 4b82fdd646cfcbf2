"""Records of a first-order lag with a known pole, clean or noisy."""

import numpy as np
import pytest

from narxcal.record import Record

POLE = 0.9


def lag_record(seed=0, samples=400, noise=0.0, name=None):
    """y(k) = 0.9 y(k-1) + 0.1 tanh(u(k)) under random steps, plus white noise on y."""
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.uniform(-2.0, 2.0, samples // 25 + 1), 25)[:samples]
    y = np.zeros(samples)
    for k in range(1, samples):
        y[k] = POLE * y[k - 1] + (1.0 - POLE) * np.tanh(u[k])
    return Record(u, y + noise * rng.normal(size=samples), name or f"record {seed}")


@pytest.fixture(name="lag_record")
def _lag_record():
    return lag_record
