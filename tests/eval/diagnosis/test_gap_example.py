"""Two cases of a third party's simulation: one with a slow EGT probe, one with nothing."""

from pathlib import Path

import pytest

from eval.diagnosis.expected import held_out
from eval.diagnosis.flights import batch
from eval.diagnosis.pairs import read_pairs
from eval.diagnosis.where import locate

CASES = Path(__file__).parents[4] / "shared" / "data" / "gap_example"
pytestmark = pytest.mark.skipif(
    not CASES.is_dir(), reason="needs the open gap cases in ../shared/data/gap_example"
)


@pytest.fixture(scope="module", params=["A", "B"])
def case(request):
    folder = CASES / f"case_{request.param}"
    return request.param, batch(read_pairs(folder / "real", folder / "sim"))


def test_the_gap_is_where_it_was_put_and_nowhere_else(case):
    name, data = case
    assert data.flights.signals.dt_s == pytest.approx(0.25)
    assert all(len(events) >= 18 for events in locate(data).events)
    where = locate(data)
    if name == "B":
        assert max(where.excess.values()) < 0.15
        return
    assert where.channels["EGT_C"].low > 0.9
    assert (where.rows[0].direction, where.rows[0].phase) == ("push", "transit")
    assert where.side.sensor > 0.8
    assert where.times["EGT_C"].groupby("direction")["Tt_s"].median()["push"] > 0.5
    assert abs(where.times["N1_pct"].groupby("direction")["Tt_s"].median()["push"]) < 0.05


def test_the_true_lag_closes_the_gap_and_invents_none(case):
    name, data = case
    found = held_out({"sensor_lag:EGT_C": {"tau_s": 0.9, "own_s": 0.7}}, data, None)
    # What is left of A is on N1: its temperature limiter listens to the slow probe.
    assert found.share > 0.96 if name == "A" else found.share < 0.1
