"""Training flights compared with models without them: nothing is tried by what was fitted to it."""

import numpy as np
import pytest

from data_prep.log import Finding, Log, Source
from eval.diagnosis.learned import _plans
from training.config import RunConfig


def log_of(file, engine="", samples=600):
    time_s = np.arange(samples) / 10.0
    lever = 30.0 + 20.0 * np.sin(time_s / 5.0)
    channels = {"TRA_deg": lever, "N1_pct": 40.0 + lever}
    return Log(f"{file}{engine}", time_s, channels, source=Source(file=file, engine=engine))


@pytest.mark.parametrize("flights", [2, 3, 7])
def test_every_flight_is_tried_once_by_a_model_without_it(flights):
    logs = [log_of(f"f{k}.csv") for k in range(flights)]
    plans = _plans(logs, RunConfig(), {})
    assert len(plans) == min(3, flights)
    assert sorted(part.log.name for plan in plans for part in plan.test) == sorted(
        log.name for log in logs
    )
    for plan in plans:
        trained, tried = ({part.log.name for part in parts} for parts in (plan.train, plan.test))
        assert trained
        assert not trained & tried


def test_halves_of_a_single_flight_stand_for_flights():
    plans = _plans([log_of("f.csv", ":left"), log_of("f.csv", ":right")], RunConfig(), {})
    assert len(plans) == 2
    for plan in plans:
        assert len(plan.train) == len(plan.test) == 2
        for train, test in zip(plan.train, plan.test, strict=True):
            assert {(train.start, train.stop), (test.start, test.stop)} == {(0, 300), (300, 600)}


def test_what_a_training_masked_is_neither_learned_from_nor_compared():
    logs = [log_of(f"f{k}.csv") for k in range(2)]
    fault = Finding("bias", "TRA_deg", 10.0, 19.9, 5.0, "deg", 1.0, "too high", log="f0.csv")
    plans = _plans(logs, RunConfig(), {"f0.csv": [fault]})
    (learned,), (compared,) = (
        [part.log for plan in plans for part in parts(plan) if part.log.name == "f0.csv"]
        for parts in (lambda plan: plan.train, lambda plan: plan.test)
    )
    assert learned.findings == (fault,)
    unknown = ~np.isfinite(compared["N1_pct"])
    assert unknown.nonzero()[0].tolist() == list(range(100, 300))  # and as long again
    assert (~np.isfinite(compared["TRA_deg"])).nonzero()[0].tolist() == list(range(100, 200))
