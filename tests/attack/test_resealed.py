"""Whoever can write a hash can write any content: it is used, or refused with a `NarxcalError`."""

import json

import numpy as np
import pytest

from eval.judging.evaluate import evaluate
from narxcal.calibration.bundle import load_bundle, save_bundle
from narxcal.calibration.certificate import certify
from narxcal.support.errors import NarxcalError
from tests.eval import conftest as ENGINE  # noqa: N812
from tests.fuzz import value_changed
from training.screening.redundancy_fit import Pool

CHANNEL = {
    "weights": {"network": 0.4, "arx": 0.6},
    "held_out_rmse": {"network": 0.2, "arx": None, "mixture": 0.1},
    "held_out_level": [0.1, -0.1, None],
    "held_out_lag_s": [0.0, 0.1, 0.2],
}
TABLES = {
    "mixture": {"status": "", "held_out": ["a"], "channels": {"N1_pct": CHANNEL}, "suspects": []},
    "screening": {
        "findings": [],
        "logs": [{"log": "a", "rows": 9, "masked": {"N1_pct": 3}, "left_out_rows": 0}],
        "contradicting": [{"log": "a", "words": "a contradicts the others"}],
    },
    "held_out": {"logs": ["a", "b"], "fitted": False, "rmse": {"N1_pct": [0.1, None]}},
    "delay": {"found": None, "ln_error": [[0.0, 0.2]]},
}


@pytest.fixture(scope="module")
def sound():
    """A bundle with every table of its record, and a log that is new to it."""
    train = [ENGINE.lag_log(f"train_{k}.csv", offset=(0.05 * k, 0.1)) for k in range(3)]
    bundle = ENGINE.lag_bundle(train=train)
    bank = Pool.of(train).bank(("TRA_deg", *bundle.calibration.output_names)).to_json()
    parts = {**TABLES, "certificate": certify(bundle.calibration), "redundancy": bank}
    record = bundle.record.having(**parts)
    return bundle.calibration, record, ENGINE.lag_log("new.csv")


@pytest.mark.parametrize("part", [*TABLES, "certificate", "redundancy", "baselines", "identities"])
def test_a_changed_table_of_the_record_is_used_or_refused(sound, part):
    calibration, record, log = sound
    whole, refused = record.to_json(), 0
    for seed in range(8):
        rng = np.random.default_rng([39, seed])
        try:
            changed = record.having(**{part: value_changed(rng, whole[part])})
            evaluate(ENGINE.Bundle(calibration, changed), [log])
        except NarxcalError:
            refused += 1
    assert refused > 0


def test_every_table_of_a_record_comes_back(sound, tmp_path):
    calibration, record, _ = sound
    save_bundle(tmp_path / "run", ENGINE.Bundle(calibration, record))
    again = load_bundle(tmp_path / "run", trust=True).record
    found, written = (json.loads(json.dumps(one.to_json())) for one in (again, record))
    assert found | {"versions": {}} == written | {"versions": {}}
    assert again.certificate == record.certificate
