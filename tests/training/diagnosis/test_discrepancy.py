"""What a simulator gets wrong by itself: learned on some flights, no finding on another."""

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from narxcal.effects import effect, respond
from tests.training.diagnosis.conftest import flights_of, recorded
from training.diagnosis.dictionary import Dictionary
from training.diagnosis.discrepancy import BANDS, learn, read
from training.diagnosis.layers import Setting, further, stored_odds

NAMES = [
    f"{kind}:{channel}"
    for kind in ("time_skew", "sensor_lag", "sensor_bias", "sensor_drift")
    for channel in ("N1_pct", "N2_pct", "EGT_C")
]


def wrong_by_itself(flights, seed):
    """Steady maps of each log, and errors that wander slowly."""
    random = np.random.default_rng(seed)
    p = flights.signals.power(flights.y)[..., None]
    size = 0.006 * (flights.signals.high - flights.signals.low)
    maps = random.normal(size=(len(p), 2, 1, 3))
    wander = lfilter([0.1], [1.0, -0.98], random.normal(size=flights.y.shape), axis=1)
    return flights.y + size * (maps[:, 0] + maps[:, 1] * (p - 0.5) + wander)


@pytest.fixture(name="learned", scope="module")
def given_learned():
    flights = flights_of(4, seed=5, steps=4096)
    record = recorded(flights, wrong_by_itself(flights, 6))
    return learn(record, Dictionary([effect(name) for name in NAMES], flights, None))


def layers_of(learned, size):
    flights = flights_of(2, seed=7, steps=4096)
    flights = replace(flights, signals=flights_of(4, seed=5, steps=4096).signals)
    late = respond([(effect("time_skew:N2_pct"), np.array([[size]]))], flights, None)[0]
    record = recorded(flights, wrong_by_itself(flights, 8) + late - flights.y)
    dictionary = Dictionary([effect(name) for name in NAMES], flights, None)
    noise, variance = learned.nuisances(record), learned.variance(record)
    return further(Setting(record, variance, noise, dictionary, stored_odds(), learned), None, 1.0)[
        0
    ]


def test_it_is_the_same_after_being_written_and_read(learned):
    assert read(json.loads(json.dumps(learned.document()))) == learned


def test_it_has_every_channel_and_band(learned):
    assert set(learned.noise) == {"N1_pct", "N2_pct", "EGT_C"}
    assert all(len(rows) == BANDS for rows in (*learned.noise.values(), *learned.tau.values()))
    assert all(min(rows) >= 1.0 for rows in learned.tau.values())


def test_nothing_acts_on_a_further_flight_and_a_late_channel_is_found(learned):
    assert layers_of(learned, 0.0) == []
    (found,) = layers_of(learned, 0.4)
    assert found.name == "time_skew:N2_pct"
    assert found.single.theta[0] == pytest.approx(0.4, abs=0.05)
