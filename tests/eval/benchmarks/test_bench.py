"""The benchmark: finite figures from real runs, and a choice that never sees the test range."""

import json
import math
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
import torch

from data_prep.events import Event
from eval import bench
from eval.benchmarks import flights as picture
from eval.benchmarks import public_sets, speed
from eval.benchmarks.public_sets import Candidate, Material, PublicSet, Target
from eval.benchmarks.row import Row
from eval.rules import Verdict
from eval.transients import AssessedEvent
from narxcal.narx.config import NarxConfig
from narxcal.record import Record
from narxcal.support.errors import DataError
from training.config import TrainConfig, load_config
from training.free_run import FreeRunProblem, cut_windows
from training.network import new_model

BRIEF = TrainConfig(horizons_s=(20.0,), iterations=(2,), score_every_s=1.0, threads=1)
GOOD = Candidate(NarxConfig(lags=2, taps=(0, 1), hidden=3), BRIEF)
# Sees inputs far too old to be of use.
POOR = Candidate(NarxConfig(lags=1, taps=(40,), hidden=3), BRIEF)


def tiny(targets=()):
    return PublicSet("tiny", "mV", 1000.0, (POOR, GOOD), targets)


def material(count=1, samples=300):
    record = speed.record_of(samples * (count + 1))
    parts = [
        Record(record.u[k : k + samples], record.y[k : k + samples], f"r{k}")
        for k in range(0, samples * (count + 1), samples)
    ]
    return Material(tuple(parts[:-1]), tuple(parts[-1:]), 2)


@pytest.mark.parametrize("count", [1, 4])
def test_the_better_candidate_is_chosen_by_what_was_held_back(count):
    outcome = public_sets.measure(tiny(), material(count))
    assert outcome.chosen == GOOD
    assert 0.0 < outcome.pooled < 200.0
    assert outcome.fit_s > 0.0
    assert outcome.search_s > 0.0


def test_the_choice_does_not_depend_on_the_test_range():
    given = material()
    spoilt = Material(given.train, (Record(given.test[0].u, -100.0 * given.test[0].y),), 2)
    seen = [public_sets.measure(tiny(), one) for one in (given, spoilt)]
    assert seen[0].chosen == seen[1].chosen
    assert seen[1].pooled > 10.0 * seen[0].pooled


def test_whole_recordings_are_held_back_and_a_single_one_in_blocks():
    assert [one.name for one in public_sets._pieces(material(7).train, 0)] == [
        one.name for one in material(7).train
    ]
    blocks = public_sets._pieces(material().train, 0)
    np.testing.assert_array_equal(np.concatenate([one.y for one in blocks]), material().train[0].y)
    assert [len(one) for one in blocks] == [75] * 4


def test_only_the_configured_part_of_a_recording_is_used():
    assert sum(len(one) for one in public_sets._pieces(material().train, 100)) == 100


def test_each_piece_is_judged_by_a_network_that_did_not_see_it(monkeypatch):
    seen = []

    class Spy(public_sets.Narx):
        def fit(self, records, *_):
            seen.append({one.name for one in records})
            return super().fit(records)

    monkeypatch.setattr(public_sets, "Narx", Spy)
    judged = []

    def judge(model, record, init):
        judged.append((len(seen), record.name))
        return record.y

    monkeypatch.setattr(public_sets, "_free_run_error", judge)
    pieces = material(6).train
    public_sets._held_back_rmse(GOOD, pieces, 2)
    assert sorted(name for _, name in judged) == sorted(one.name for one in pieces)
    assert not any(name in seen[turn - 1] for turn, name in judged)


def test_rows_of_a_set_name_peer_and_choice(tmp_path):
    given = speed.record_of(600)
    frame = pd.DataFrame({"u": given.u[:, 0], "y": given.y[:, 0]})
    frame.to_csv(tmp_path / "tiny.csv.gz", index=False)
    said = {"train": [0, 300], "test": {"a": [300, 450], "b": [450, 600]}, "init_window": 2}
    (tmp_path / "tiny.json").write_text(json.dumps(said))
    rows = public_sets.rows(tmp_path, [tiny((Target("a", 1e9, "a peer"),))])
    assert [row.name for row in rows] == ["tiny a", "tiny b", "tiny pooled", "tiny, training"]
    assert [row.reached for row in rows] == [True, None, None, None]
    assert all(math.isfinite(row.value) for row in rows)
    assert rows[0].note == (
        "chosen of 2 by cross-validation in the training range: "
        "lags 2, taps 0..1, hidden 3, decay 1e-05, margin 0.25, lm"
    )


def test_candidates_of_a_set_are_told_from_each_other():
    for one in public_sets.SETS:
        assert len({candidate.text for candidate in one.candidates}) == len(one.candidates)
    texts = [candidate.text for candidate in public_sets.SETS[1].candidates]
    assert any("linear feedback" in text for text in texts)


def test_a_set_that_is_missing_becomes_a_row_that_says_so(tmp_path):
    [row] = public_sets.rows(tmp_path, [tiny()])
    assert row.note == f"not measured: tiny.json is not in {tmp_path}"
    assert row.document()["value"] is None
    assert row.reached is None


@pytest.mark.slow
def test_kernel_rows_are_finite_and_ratios_fit_their_parts():
    rows = {row.name: row for row in speed.kernel_rows(400, 120)}
    assert all(math.isfinite(row.value) and row.value > 0.0 for row in rows.values())
    parts = rows["free run, eager PyTorch twin"].value / rows["free run, kernel"].value
    assert rows["free run, twin over kernel"].value == pytest.approx(parts)


def test_the_slow_training_step_has_the_loss_and_gradient_of_the_fast_one():
    record = speed.record_of(301)
    model = new_model([record], NarxConfig(lags=1, taps=(0,), hidden=4), seed=0)
    with torch.no_grad():
        model.net.linear.weight.fill_(0.3)
        model.net.output.weight.fill_(0.1)
    problem = FreeRunProblem(model.net, cut_windows(model, [record], 100))
    loss, gradient = problem.gradient(model.net.get_theta())
    assert speed.autograd_loss(model, record, 100) == pytest.approx(loss)
    named = dict(model.net.named_parameters())
    order = ("hidden.weight", "hidden.bias", "output.weight", "output.bias", "linear.weight")
    slow = np.concatenate([named[name].grad.numpy().ravel() for name in order])
    np.testing.assert_allclose(slow, gradient, atol=1e-9)


@pytest.mark.slow
def test_replay_rows_are_finite(monkeypatch):
    """Without lags, whose fit takes longer than all else."""
    config, base = load_config("demo.toml")
    narx = config.narx.model_copy(update={"lag": False, "lag_governed": False})
    plain = config.model_copy(update={"narx": narx}), base
    monkeypatch.setattr(speed, "load_config", lambda _: plain)
    rows = speed.replay_rows(duration_s=480.0, steps=50)
    assert [row.unit for row in rows] == ["x real time", "ms"]
    assert all(math.isfinite(row.value) and row.value > 0.0 for row in rows)


@pytest.mark.parametrize(
    ("value", "bound", "reached"),
    [(1.0, "at most", True), (3.0, "at most", False), (3.0, "at least", True), (3.0, "", None),
     (math.nan, "at most", None)],
)  # fmt: skip
def test_a_target_is_kept_on_its_side(value, bound, reached):
    assert Row("g", "n", value, "s", 2.0, bound).reached is reached


def test_json_is_one_document_without_nan(monkeypatch, capsys, tmp_path):
    monkeypatch.setattr(bench.speed, "rows", lambda: [Row("speed", "x", 2.0, "us")])
    monkeypatch.setattr(bench.virtual_engine, "rows", list)
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
