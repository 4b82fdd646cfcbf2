"""Evaluation of recorded flights: quick, complete, and with a trim that helps where it can."""

from pathlib import Path

import numpy as np
import pytest

from eval.evaluate import evaluate
from eval.run_logs import evaluation_logs
from training.config import load_config
from training.pipeline import calibrate, configured_files, prepare_logs
from training.records import split_logs

FLIGHTS = Path(__file__).parents[2] / ".." / "shared" / "data" / "flights"


@pytest.fixture(scope="module")
def bundle():
    """A network after three steps only: what is tested here is the evaluation."""
    if not FLIGHTS.is_dir():
        pytest.skip(f"the recorded flights are not in {FLIGHTS}")
    config, base = load_config("citation2.toml")
    short = config.train.model_copy(update={"horizons_s": (5.0,), "iterations": (3,)})
    sets = config.split.model_copy(update={"train": ("*flight1*",), "test": ("*flight2*",)})
    narx = config.narx.model_copy(update={"lag": False})
    config = config.model_copy(update={"train": short, "split": sets, "narx": narx})
    logs = prepare_logs(config, configured_files(config, base))
    return calibrate(config, base, split_logs(logs, config.split))


@pytest.mark.slow
def test_two_flights_are_evaluated(bundle):
    logs = evaluation_logs(bundle)
    assert [log.source.engine for log in logs] == ["left", "right"]
    document = evaluate(bundle, logs).document()
    for log in document["logs"]:
        assert log["role"] == "test"
        assert log["ti_tt"]["assessed"] > 40
        for figures in log["channels"].values():
            assert figures["samples"] > 40000
            assert figures["first_order_rmse"] < figures["steady_state_rmse"]
            assert figures["one_step_rmse"] < figures["rmse"]


@pytest.mark.slow
def test_trim_takes_the_probe_offset_of_an_unseen_flight_away(bundle):
    document = evaluate(bundle, evaluation_logs(bundle), trim=0.2).document()
    for log in document["logs"]:
        egt = log["channels"]["EGT_C"]
        assert egt["rmse"] < egt["untrimmed_rmse"]
        trim = log["trim"]
        shape = len(trim["altitudes_ft"]), len(trim["levels"])
        assert np.shape(trim["offsets"]["EGT_C"]) == shape
        # No offset is larger than what the quasi-steady error of 20 % of a flight can justify.
        assert np.abs(trim["offsets"]["N1_pct"]).max() < 4.0
