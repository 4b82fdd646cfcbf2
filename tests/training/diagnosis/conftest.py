"""Flights of three channels that follow a lever, and what sensors make of them."""

import numpy as np
import pytest
from scipy.signal import lfilter

from narxcal.effects import Flights, Signals
from training.diagnosis.metric import Record

DT = 0.25
OUTPUTS = ("N1_pct", "N2_pct", "EGT_C")
NOISE = np.array([0.03, 0.03, 0.5])


def flights_of(count, seed=0, steps=1200):
    random = np.random.default_rng(seed)
    lever = np.repeat(random.uniform(5.0, 80.0, (count, steps // 40)), 40, axis=1)
    lever = lfilter([0.3], [1.0, -0.7], lever, axis=1, zi=0.7 * lever[:, :1])[0]
    lags = [
        lfilter([1 - k], [1.0, -k], lever, axis=1, zi=k * lever[:, :1])[0] for k in (0.8, 0.7, 0.9)
    ]
    y = np.stack([25 + 0.8 * lags[0], 55 + 0.5 * lags[1], 350 + 5 * lags[2]], axis=-1)
    low, high = y.min(axis=(0, 1)), y.max(axis=(0, 1))
    signals = Signals(("TRA_deg",), OUTPUTS, DT, "TRA_deg", low, high, (0.0, 85.0), ("TRA_deg",))
    return Flights(signals, lever[..., None], y, np.full(count, steps))


def recorded(flights, y, seed=1):
    random = np.random.default_rng(seed)
    real = y + NOISE * random.standard_normal(y.shape)
    unit = np.repeat(np.arange(len(y))[:, None], y.shape[1], axis=1)
    return Record(flights, real, NOISE, unit, tuple(range(len(y))))


@pytest.fixture(name="flights", scope="session")
def given_flights():
    return flights_of(4)
