"""The document has the fixed keys, and says what the budget and the evidence hold."""

import json
import math

import pytest

from eval.diagnosis.document import Evidence, document
from eval.diagnosis.expected import channel_shrink, held_out, time_errors, time_shrink
from eval.diagnosis.where import locate
from tests.eval.diagnosis.conftest import LAG, NAME
from training.diagnosis.budget import Interval


@pytest.fixture
def evidence(make_data, probe, make_budget):
    data = make_data(probe, flights=3)
    values = {NAME: {"tau_s": 1.0}}
    held = held_out(values, make_data(probe, flights=2), None)
    after = held_out(values, data, None).after
    none = time_errors(held.data, held.after, ((), ()))
    return Evidence(
        data,
        make_budget("effects", {NAME: LAG}),
        locate(data, after - data.flights.y),
        after,
        time_shrink(none, none),
        Interval(0.9, 0.8, 1.0),
        channel_shrink(data, after),
        None,
        {"EGT_C": 0.4},
        held,
        {"warnings": ["few"]},
    )


def test_the_keys_are_those_that_others_rely_on(evidence):
    found = json.loads(json.dumps(document(evidence, ())))
    assert found["schema"] == "narxcal.gap/2"
    assert found["verdict"].items() >= {"kind": "effects", "effects": [NAME]}.items()
    (first,) = found["effects"]
    assert (first["id"], first["channel"], first["family"]) == (
        "sensor_lag",
        "EGT_C",
        "channel lag",
    )
    assert first["parameters"]["tau_s"] == {"value": 1.0, "low": 0.9, "high": 1.1, "unit": "s"}
    assert first["gain"] == {"value": 0.9, "low": 0.8, "high": 0.9}
    assert found["where"][0].items() >= {"channel": "EGT_C", "phase": "transit"}.items()
    assert sum(row["explained"] for row in found["where"]) == pytest.approx(1.0, abs=0.01)
    assert found["side"] == {"input": 0.0, "process": 0.0, "sensor": 1.0}
    assert found["shrink"]["predicted"] == {"value": 0.9, "low": 0.8, "high": 1.0}
    assert found["shrink"]["realised"] > 0.98
    row = found["shrink"]["channels"]["EGT_C"]
    share = 1.0 - (row["after"] / row["before"]) ** 2
    assert found["shrink"]["shares"]["EGT_C"] == pytest.approx(share)
    bands = found["quality"]["bands"]["EGT_C"]
    assert all(band["low"] <= band["share"] <= band["high"] for band in bands)
    power = found["quality"]["regimes"]["power"]
    assert sum(level["share"] for level in power.values()) == pytest.approx(1.0)
    assert found["emulator"] == {"used": True, "rmse": {"EGT_C": 0.4}, "rmse_heldout": {}}
    assert found["quality"]["warnings"] == ["few"]
    assert found["quality"]["pushes"] > 10
    assert math.isfinite(found["quality"]["left_share"])
