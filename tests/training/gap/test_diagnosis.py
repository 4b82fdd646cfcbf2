"""The verdict: right effects are claimed, nulls and what is in no library are not."""

import numpy as np
import pytest

from tests.training.gap.conftest import NOISE
from training.gap.diagnosis import diagnose
from training.gap.work import Options

QUICK = Options(draws=40)


def answer(flights, engine, real):
    return diagnose(flights, (real, NOISE), engine, QUICK)


@pytest.mark.parametrize(
    ("name", "theta"),
    [
        ("throttle_delay", [0.4]),
        ("throttle_backlash", [3.0]),
        ("sensor_lag:EGT_C", [1.2, 0.5]),
        ("time_skew:N2_pct", [0.5]),
        ("altitude_lag", [0.7]),
    ],
)
def test_a_single_effect_is_named_with_its_size(name, theta, flights, engine, recorded):
    found = answer(flights, engine, recorded({name: theta}))
    assert (found.kind, found.effects) == ("effects", (name,)), found.reason
    row = found.tried[0]
    value = next(iter(row.parameters[name].values()))
    assert value.low <= theta[0] * 1.02
    assert value.high >= theta[0] * 0.98
    assert found.predicted.value > 0.9
    assert found.left_share < 0.1
    assert row.probability >= found.tried[-1].probability


def test_an_offset_larger_than_build_scatter_is_named(flights, engine, recorded):
    real = recorded({"throttle_bias": [3.0]})
    found = answer(flights, engine, real)
    assert (found.kind, found.effects) == ("effects", ("throttle_bias",)), found.reason


@pytest.mark.parametrize("seed", [0, 1])
def test_noise_alone_is_no_gap(seed, flights, engine, recorded):
    found = answer(flights, engine, recorded({}, seed))
    assert (found.kind, found.effects) == ("none", ())
    assert found.reason == "no gap beyond noise and build scatter"


def test_build_scatter_is_no_effect(flights, engine, recorded):
    real = recorded({}) + np.array([0.0, 0.3, 5.0])
    real[..., 2] += 4.0 * flights.signals.power(flights.y)
    assert answer(flights, engine, real).kind == "none"


def test_what_is_in_no_library_is_not_named(flights, engine, recorded):
    """A temperature that swings slowly by itself, differently in each flight."""
    time = np.arange(flights.y.shape[1])
    random = np.random.default_rng(9)
    swing = [np.sin(time / random.uniform(5, 15) + random.uniform(0, 6)) for _ in flights.y]
    real = recorded({})
    real[..., 2] += 15.0 * np.array(swing)
    real[..., 1] += 1.5 * np.array(swing)
    found = answer(flights, engine, real)
    assert (found.kind, found.effects) == ("unknown", ())
    assert "of it" in found.reason or "unexplained" in found.reason


def test_two_effects_are_both_named(flights, engine, recorded):
    real = recorded({"throttle_delay": [0.5], "sensor_lag:EGT_C": [2.5, 0.5]})
    found = answer(flights, engine, real)
    assert set(found.effects) == {"throttle_delay", "sensor_lag:EGT_C"}, found.reason


def test_the_same_logs_give_the_same_answer(flights, engine, recorded):
    real = recorded({"sensor_lag:EGT_C": [1.2, 0.5]})
    assert answer(flights, engine, real) == answer(flights, engine, real)


def test_the_model_at_work_is_reported(flights, engine, recorded):
    seen = []
    real = recorded({"sensor_lag:EGT_C": [1.2, 0.5]})
    diagnose(flights, (real, NOISE), engine, QUICK, lambda name, k, n: seen.append((name, k, n)))
    assert seen[0][1] == 0
    assert all(k < n for _, k, n in seen)
