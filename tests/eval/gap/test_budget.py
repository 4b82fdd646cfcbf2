"""The budget from pairs of logs to the document; what was learned is kept beside a run."""

import json

import numpy as np
import pytest

from eval.gap.budget import (
    LEARNED,
    batched,
    diagnose_pairs,
    keep_learned,
    learned_by,
)
from eval.gap.records import phases_of, record_of
from narxcal.support.errors import ModelError
from narxcal.support.files import to_json
from tests.eval.gap.conftest import pair_of, probe_lag
from training.budget.discrepancy import Discrepancy


def test_flights_are_units_and_blocks_stand_for_few():
    three = record_of(batched([pair_of(seed) for seed in range(3)]))
    assert three.units == 3
    one = record_of(batched([pair_of(0, duration_s=900.0)]))
    assert one.units == 3
    assert np.bincount(one.unit[0]).tolist() == [1200, 1200, 1200]


def test_every_sample_has_a_phase():
    data = batched([pair_of(0)])
    phases = phases_of(data)
    assert phases.names[:3] == ("steady", "push_initiation", "push_transit")
    assert set(np.unique(phases.index)) <= set(range(len(phases.names)))


@pytest.mark.slow
def test_a_lagging_probe_is_named_and_its_budget_adds_up():
    pairs = [pair_of(seed, probe_lag) for seed in range(4)]
    answer = diagnose_pairs(pairs[:3], pairs[3:])
    told = json.loads(to_json(answer.document))
    assert told["schema"] == "narxcal.gap/2"
    assert told["verdict"]["effects"] == ["sensor_lag:EGT_C"]
    assert sum(row["share"] for row in told["budget"]) == pytest.approx(1.0)
    causes = {row["cause"]: row for row in told["budget"]}
    assert set(causes) == {"sensor_lag:EGT_C", "build", "offsets", "noise", "unexplained"}
    first = causes["sensor_lag:EGT_C"]
    assert sum(first["channels"].values()) == pytest.approx(first["share"])
    assert sum(first["phases"].values()) == pytest.approx(first["share"])
    assert first["share"] > 0.5
    assert told["shrink"]["realised"] > 0.8


def test_a_run_keeps_what_was_learned(tmp_path):
    learned = Discrepancy(
        1, ((1.0,),), {"N1_pct": ((0.1, 0.2),)}, {"N1_pct": (3.0,)}, {}, {}, {"spool_lag": 2.0}
    )
    (tmp_path / "bundle.json").write_text("{}", encoding="utf-8")
    assert learned_by(tmp_path) is None
    keep_learned(learned, tmp_path)
    assert learned_by(tmp_path) == learned
    assert learned.spread("spool_lag") == pytest.approx(1.5 * 2.0)
    assert learned.spread("other") == pytest.approx(2.0)


@pytest.mark.parametrize(
    ("file", "old", "new", "problem"),
    [
        (LEARNED, '"flights": 1', '"flights": 9', "was altered"),
        (LEARNED, '"sha256"', '"sha255"', "is unusable: KeyError"),
        (LEARNED, "{", "[", "is unusable: JSONDecodeError"),
        ("bundle.json", "{}", "{ }", "was learned for another model"),
    ],
)
def test_what_was_learned_is_used_as_it_was_written_and_for_its_run_alone(
    tmp_path, file, old, new, problem
):
    (tmp_path / "bundle.json").write_text("{}", encoding="utf-8")
    keep_learned(Discrepancy(1, (), {}, {}, {}, {}, {}), tmp_path)
    changed = (tmp_path / file).read_text(encoding="utf-8").replace(old, new, 1)
    (tmp_path / file).write_text(changed, encoding="utf-8")
    with pytest.raises(ModelError, match=rf"discrepancy\.json: {problem}.*diagnose --learn$"):
        learned_by(tmp_path)
