"""Flights are the units of the budget; what was learned is kept in the folder of a run."""

import numpy as np
import pytest

from eval.diagnosis.flights import batch, phases_of
from eval.diagnosis.learned import LEARNED, keep_learned, learned_by
from narxcal.support.errors import ModelError
from tests.eval.diagnosis.conftest import pair_of
from training.diagnosis.discrepancy import Discrepancy


def test_flights_are_units_and_blocks_stand_for_few():
    three = batch([pair_of(seed) for seed in range(3)])
    assert three.units == 3
    one = batch([pair_of(0, duration_s=900.0)])
    assert one.units == 3
    assert np.bincount(one.unit[0]).tolist() == [1200, 1200, 1200]


def test_every_sample_has_a_phase():
    data = batch([pair_of(0)])
    phases = phases_of(data)
    assert phases.names[:3] == ("steady", "push_initiation", "push_transit")
    assert set(np.unique(phases.index)) <= set(range(len(phases.names)))


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
