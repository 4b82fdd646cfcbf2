"""Found effects are added to any simulated log, on its own raster."""

import json

import numpy as np
import pytest

from eval.gap.applied import FoundEffects, read_effects
from narxcal.errors import ConfigError, DataError


class Lagging:
    """A rate form whose outputs all follow the lever with one lag."""

    def __init__(self, tau_s, low, high):
        self.tau_s, self.low, self.high = tau_s, low, high

    def drive(self, u):
        return self.low + (self.high - self.low) * u[..., :1] / 70.0

    def rate(self, y, drive):
        return (drive - y) / self.tau_s


@pytest.fixture
def signals(make_data):
    return make_data(flights=1).flights.signals


def test_a_sensor_effect_acts_on_the_raster_of_the_log(signals, fly, log_of, probe):
    sim = fly(3, rate_hz=32.0)
    found = FoundEffects({"sensor_lag:EGT_C": {"tau_s": 1.0}}, signals, None)
    outputs = found.added_to(log_of(sim))
    # The effect takes the channel for straight lines between samples, the probe for steps.
    np.testing.assert_allclose(outputs["EGT_C"], probe(sim)["EGT_C"], atol=6.0)
    np.testing.assert_array_equal(outputs["N1_pct"], sim["N1_pct"])


def test_an_effect_inside_is_found_on_the_raster_of_the_diagnosis(signals, fly, log_of):
    sim = log_of(fly(3, rate_hz=32.0))
    low, high = np.array([25.0, 55.0, 400.0]), np.array([100.0, 100.0, 750.0])
    engine = Lagging(np.array([1.5, 0.8, 0.7]), low, high)
    found = FoundEffects({"throttle_delay": {"delay_s": 0.5}}, signals, engine)
    outputs = found.added_to(sim)
    late = np.roll(sim["N1_pct"], 16)
    late[:16] = late[16]
    before = np.sqrt(np.mean((late - sim["N1_pct"]) ** 2))
    assert np.sqrt(np.mean((outputs["N1_pct"] - late) ** 2)) < 0.2 * before


def test_no_effect_changes_nothing(signals, fly, log_of):
    sim = fly(3)
    outputs = FoundEffects({}, signals, None).added_to(log_of(sim))
    np.testing.assert_array_equal(outputs["EGT_C"], sim["EGT_C"])


def test_logs_that_do_not_fit_are_refused(signals, fly, log_of):
    found = FoundEffects({"throttle_delay": {"delay_s": 0.5}}, signals, object())
    with pytest.raises(DataError, match="at 5 Hz, which is no multiple of the diagnosis' 8 Hz"):
        found.added_to(log_of(fly(3, rate_hz=5.0)))
    bare = fly(3)
    del bare["NAI"]
    with pytest.raises(DataError, match="channel NAI: the effects need it"):
        found.added_to(log_of(bare))


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("{", "not JSON"),
        ("[]", "expected schema 'narxcal.gap/1', found None"),
        ('{"schema": "narxcal.evaluate/1"}', "found 'narxcal.evaluate/1'. Name the gap.json"),
    ],
)
def test_what_is_no_diagnosis_is_refused(tmp_path, text, problem):
    file = tmp_path / "gap.json"
    with pytest.raises(ConfigError, match="cannot be read"):
        read_effects(file)
    file.write_text(text, "utf-8")
    with pytest.raises(ConfigError, match=problem):
        read_effects(file)


def test_what_diagnose_stored_comes_back(tmp_path, signals):
    stored = {
        "schema": "narxcal.gap/1",
        "verdict": {"effects": ["sensor_lag:EGT_C"]},
        "effects": [
            {"id": "sensor_lag", "channel": "EGT_C", "parameters": {"tau_s": {"value": 1.5}}}
        ],
        "quality": {
            "signals": {
                "inputs": signals.inputs,
                "outputs": signals.outputs,
                "dt_s": signals.dt_s,
                "driver": signals.driver,
                "low": signals.low.tolist(),
                "high": signals.high.tolist(),
                "lever": signals.lever,
                "active": signals.active,
            }
        },
    }
    (tmp_path / "gap.json").write_text(json.dumps(stored), "utf-8")
    found = read_effects(tmp_path / "gap.json")
    assert found.values == {"sensor_lag:EGT_C": {"tau_s": 1.5}}
    assert found.signals.active == signals.active
    np.testing.assert_array_equal(found.signals.high, signals.high)
    assert found.emulator is None
    assert read_effects(tmp_path).values == found.values
