"""Ways to an undeserved PASS: none passes, and each says why.

The engine, its network and the logs are those of tests/eval: a model that is exact, so that a sound
log passes. `../../docs/reliability.md` P12.
"""

import numpy as np
import pytest

from data_prep.prepare import Preparation, prepare
from eval.judging.evaluate import evaluate
from eval.run_logs import EvaluateConfig
from tests.eval import conftest as ENGINE  # noqa: N812


def steps(channel, change):
    """A function that changes one channel of a log by a function of values and time."""
    return lambda log: log.with_channels({channel: change(log[channel], log.time_s)})


def noise(size):
    return lambda v, t: v + np.random.default_rng(0).normal(0.0, size, len(t))


def stuck(values, time_s):
    return np.where((time_s > 80.0) & (time_s < 140.0), values[800], values)


WAYS = {
    "N1 in rpm": steps("N1_pct", lambda v, _: 67.0 * v),
    "N1 negative": steps("N1_pct", lambda v, _: -v),
    "N1 constant": steps("N1_pct", lambda _, t: np.full(len(t), 80.0)),
    "N1 constant with noise": steps("N1_pct", lambda _, t: noise(0.05)(np.full(len(t), 80.0), t)),
    "N2 negative": steps("N2_pct", lambda v, _: -v),
    "N2 gain 1.2": steps("N2_pct", lambda v, _: 80.0 + 1.2 * (v - 80.0)),
    "N2 1.5 % high": steps("N2_pct", lambda v, _: 1.015 * v),
    "N1 a second late": steps("N1_pct", lambda v, _: np.concatenate([np.full(10, v[0]), v[:-10]])),
    "N1 drifts by 3 %": steps("N1_pct", lambda v, t: v + 3.0 * t / t[-1]),
    "N1 noise of 2 %": steps("N1_pct", noise(2.0)),
    "N1 early by 0.5 s": steps("N1_pct", lambda v, _: np.concatenate([v[5:], np.full(5, v[-1])])),
    "N1 clipped": steps("N1_pct", lambda v, _: np.minimum(v, np.quantile(v, 0.7))),
    "N1 swings by 1 %": steps("N1_pct", lambda v, t: v + np.sin(1.2 * t)),
    "N1 steps by 2 %": steps("N1_pct", lambda v, t: v + 2.0 * (t > t[-1] / 2.0)),
    "N1 spikes": steps("N1_pct", lambda v, _: v + 15.0 * (np.arange(len(v)) % 70 < 3)),
    "N1 held for 2 s each": steps("N1_pct", lambda v, _: v[np.arange(len(v)) // 20 * 20]),
    "lever stuck for 60 s": steps(
        "TRA_deg", lambda v, t: np.where((t > 80) & (t < 140), v[800], v)
    ),
    "N1 stuck for 60 s": steps("N1_pct", stuck),
    "lever 4 deg off": steps("TRA_deg", lambda v, _: v + 4.0),
    "N1 lost from 20 % on": steps("N1_pct", lambda v, t: np.where(t > 48.0, np.nan, v)),
    "half of N1 lost": steps("N1_pct", lambda v, t: np.where(t % 2.0 < 1.0, np.nan, v)),
    "Mach lost": steps("Mach", lambda v, t: np.where(t > 150.0, np.nan, v)),
    "90 s cut": lambda log: log.part(0, 900),
    "one push": lambda log: log.part(0, 350),
    "steady": steps("TRA_deg", lambda _, t: np.full(len(t), 30.0)),
    "N1 and N2 exchanged": lambda log: log.with_channels(
        {"N1_pct": log["N2_pct"], "N2_pct": log["N1_pct"]}
    ),
}


def model_output(log):
    """A log with what the model gives in the place of what was measured."""
    exact = ENGINE.lag_log("new.csv")
    return log.with_channels({name: exact[name] for name in ENGINE.OUTPUTS})


WAYS["model output as measurement"] = model_output


def bundle_with(**parts):
    """The bundle of the engine with errors on three held-out logs, and `parts` of its record."""
    bundle = ENGINE.lag_bundle(train=[ENGINE.lag_log("train.csv", offset=(-2.0, 1.5))])
    errors = {"N1_pct": [0.02, 0.04, 0.06], "N2_pct": [0.02, 0.04, 0.06]}
    held = {"logs": ["a", "b", "c"], "fitted": False, "rmse": errors}
    return type(bundle)(bundle.calibration, bundle.record.having(**{"held_out": held} | parts))


@pytest.fixture
def judged():
    """The evaluation of a log that was prepared as `evaluate` prepares it."""

    def run(change, settings=None, **parts):
        log = change(ENGINE.lag_log("new.csv", offset=(0.06, 0.05)))
        tables = Preparation.parse({"smooth": {"window": 1}, "events": {"condition": ""}})
        bundle = bundle_with(**parts)
        return evaluate(bundle, [prepare([log], tables)[0].log], settings=settings)

    return run


def test_a_sound_log_passes_and_states_its_evidence(judged):
    found = judged(lambda log: log)
    assert found.missed == []
    assert found.outcome.exit_code == 0
    (evidence,) = [line for line in found.outcome.lines if line.startswith("Evidence: ")]
    assert "1 new log" in evidence
    assert "at least 100 % of each output of each log is judged" in evidence


@pytest.mark.parametrize("way", WAYS)
def test_no_way_to_an_undeserved_pass(judged, way):
    found = judged(WAYS[way])
    assert found.outcome.exit_code == 1
    assert found.missed
    assert found.document()["ok"] is False


def test_the_output_of_the_model_is_no_measurement(judged):
    outcome = judged(model_output).outcome
    assert outcome.passed is None
    assert outcome.lines[0] == (
        "new.csv: N1 is no measurement: RMSE 0 %, its noise alone leaves more "
        "(0.02 is the least of 3 held-out training logs)."
    )


def test_a_run_without_a_record_of_errors_passes_nothing(judged):
    outcome = judged(lambda log: log, held_out=None).outcome
    assert outcome.passed is None
    assert outcome.lines[0] == (
        "N1, N2: the run has no record of errors on held-out logs: train it anew."
    )


def test_bounds_that_the_steady_state_meets_earn_no_pass_and_all_are_stated(judged):
    table = {"largest_rmse": {"N1_pct": 50.0}, "least_passed_pct": 0.1}
    found = judged(steps("N1_pct", lambda v, _: 1.1 * v + 3.0), EvaluateConfig.parse(table))
    assert found.outcome.exit_code == 1
    assert any("largest_rmse.N1_pct = 50 is no bound" in line for line in found.outcome.lines)
    stated = "least_passed_pct = 0.1 (default 95.0), largest_rmse.N1_pct = 50.0 (default None)."
    assert any(line.endswith(stated) for line in found.outcome.lines)
    assert found.document()["bounds"] == {
        "least_passed_pct": {"value": 0.1, "default": 95.0},
        "largest_rmse.N1_pct": {"value": 50.0, "default": None},
    }
