"""The benchmark: finite figures from real runs, and a choice that never sees the test range."""

import json
import math
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from data_prep.events import Event
from eval import bench
from eval.benchmarks import Row, public_sets
from eval.benchmarks import flights as picture
from narxcal.support.errors import DataError
from training.estimator.ladder import Limits
from training.responses.rules import Verdict
from training.responses.transients import AssessedEvent


@pytest.fixture
def folder(tmp_path):
    """A first-order lag in 400 samples: its second half is the official test range."""
    draw = np.random.default_rng(0)
    u = np.repeat(draw.standard_normal(40), 10)
    y = np.zeros(400)
    for k in range(1, 400):
        y[k] = 0.9 * y[k - 1] + 0.1 * u[k - 1]
    y += 0.01 * draw.standard_normal(400)
    pd.DataFrame({"u": u, "y": y}).to_csv(tmp_path / "lag.csv.gz", index=False)
    tests = {"a": [200, 300], "b": [300, 400]}
    ranges = {"train": [0, 200], "test": tests, "init_window": 10}
    (tmp_path / "lag.json").write_text(json.dumps(ranges))
    return tmp_path


def test_ours_and_linear_reach_the_noise_of_a_linear_set(folder):
    found = list(public_sets.figures(folder, "lag", Limits(0.05)))
    pooled = {one.model: one.rmse for one in found if one.record == ""}
    assert list(pooled) == [public_sets.OURS, public_sets.FIXED, public_sets.LINEAR]
    assert max(pooled.values()) < 0.02
    assert [one.record for one in found[:3]] == ["a", "b", ""]
    ratio = public_sets.document(found, {})["geometric_mean_ratio"]
    assert ratio == pytest.approx(pooled[public_sets.OURS] / pooled[public_sets.LINEAR])


def test_the_choice_does_not_depend_on_the_test_range(folder):
    before = list(public_sets.figures(folder, "lag", Limits(0.05), models=("linear",)))
    table = pd.read_csv(folder / "lag.csv.gz")
    table.loc[200:, "y"] *= -100.0
    table.to_csv(folder / "lag.csv.gz", index=False)
    after = list(public_sets.figures(folder, "lag", Limits(0.05), models=("linear",)))
    assert [one.note for one in before] == [one.note for one in after]
    assert after[-1].rmse > 10.0 * before[-1].rmse


def test_rows_stand_against_published_figures_and_name_a_missing_set(folder, monkeypatch):
    peers = (public_sets.Target("a", 1e9, "a peer"),)
    monkeypatch.setattr(public_sets, "SETS", (public_sets.PublicSet("lag", "mV", 1e3, peers),))
    monkeypatch.setattr(public_sets, "Limits", lambda: Limits(0.05))
    rows = public_sets.rows(folder, ("lag", "tanks"))
    assert [row.name for row in rows] == ["lag a", "lag b", "lag", "lag, training", "tanks"]
    assert [row.reached for row in rows] == [True, None, None, None, None]
    assert rows[-1].note == f"not measured: tanks.json is not in {folder}"
    assert rows[-1].document()["value"] is None


def test_a_set_that_is_not_there_is_named(folder, tmp_path):
    with pytest.raises(DataError) as caught:
        public_sets.names_in(folder, ["lag", "tanks"])
    assert str(caught.value) == (
        f"the set 'tanks' is not in {folder}. "
        "A set is NAME.csv.gz with columns u and y, and NAME.json with its ranges"
    )
    (tmp_path / "empty").mkdir()
    with pytest.raises(DataError, match=r"^no set is in"):
        public_sets.names_in(tmp_path / "empty")


@pytest.mark.parametrize(
    ("value", "bound", "reached"),
    [(1.0, "at most", True), (3.0, "at most", False), (3.0, "at least", True), (3.0, "", None),
     (math.nan, "at most", None)],
)  # fmt: skip
def test_a_target_is_kept_on_its_side(value, bound, reached):
    assert Row("g", "n", value, "s", 2.0, bound).reached is reached


def test_json_is_one_document_without_nan(monkeypatch, capsys, tmp_path):
    monkeypatch.setattr(bench.speed, "rows", lambda: [Row("speed", "x", 2.0, "us")])
    assert bench.main(["--json", "--data", str(tmp_path)]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["schema"] == "narxcal.bench/1"
    assert document["rows"][0]["value"] == 2.0
    assert {row["value"] for row in document["rows"][1:]} == {None}


def test_the_table_says_why_a_figure_is_missing(monkeypatch, capsys, tmp_path):
    assert bench.main(["--flights", "--data", str(tmp_path)]) == 0
    shown = " ".join(capsys.readouterr().out.split())
    assert "Citation II" in shown
    assert "AGTF30" in shown
    assert shown.count("the folder of the logs does not exist") == 2


def moved(label=0, speed="fast", by=10.0, ok=True):
    event = Event("a", 0, 9, label, speed, 0.0, 0.0, by, settled=True, interrupted=False)
    return AssessedEvent(event, (SimpleNamespace(verdict=Verdict("paper", ok)),))


def test_the_picture_is_of_the_largest_assessed_push_even_a_failed_one():
    failed = moved(by=50.0, ok=False)
    others = [moved(), moved(by=90.0, ok=None), moved(label=1), moved(speed="slow", by=99.0)]
    assert picture.largest_push([*others, failed]) is failed


def test_a_log_without_such_a_push_has_no_picture():
    with pytest.raises(DataError, match=r"^no fast push could be assessed in every channel$"):
        picture.largest_push([moved(label=1)])
