"""Every writing command killed at every one of its file events: the old output or the new one.

What takes long and writes no file (fitting, flying, judging) is done once and given again.
"""

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest

from narxcal.calibration.bundle import load_bundle, write_bundle
from narxcal.cli import evaluate, fly, main
from narxcal.flight_test import fly as flying
from tests.crash import killed_everywhere
from training.methods import write_checkpoint
from training.network import TrainingState

pytestmark = pytest.mark.slow
HOW = pytest.mark.parametrize("power", [False, True])
WHOLE_RUN = ["bundle.json", "weights.safetensors"]


@pytest.fixture(autouse=True)
def _quick(monkeypatch):
    """What is put right between two kills need not be flushed to the real disk."""
    monkeypatch.setattr("os.fsync", lambda _: None)


def names(folder):
    return sorted(item.name for item in folder.iterdir())


def tree(out):
    """Content of a file, or of all files of a folder, by path."""
    files = (path for path in (out, *out.rglob("*")) if path.is_file())
    return {str(path.relative_to(out.parent)): path.read_bytes() for path in files}


def quietly(*words):
    assert main([*map(str, words), "--quiet"]) in {0, 1}


@HOW
def test_a_training_killed_anywhere_is_resumed_to_the_same_model(training, tmp_path, power):
    run = tmp_path / "run"
    kills = 0
    for event in killed_everywhere(tmp_path, lambda: quietly(*training, run), power=power):
        if (run / "bundle.json").exists():
            load_bundle(run)
        kills += event is not None
        quietly(*training, run, "--resume")
        assert load_bundle(run).record.training.status
        assert (names(tmp_path), names(run)) == (["run"], WHOLE_RUN)
        if event is not None:
            shutil.rmtree(run)
    assert kills >= 20


@HOW
def test_going_on_with_a_training_may_be_killed_anywhere(project, training, tmp_path, power):
    """What Ctrl-C kept, its best network and its checkpoints, is there until the new model is."""
    run, kept = tmp_path / "run", tmp_path.with_name(f"{tmp_path.name}-kept")
    trained = load_bundle(project / "run")
    cut_short = {**trained.record.to_json()["training"], "status": "interrupted"}
    kept.mkdir()
    write_bundle(kept, replace(trained, record=trained.record.having(training=cut_short)))
    write_checkpoint(kept / "checkpoints/joint.safetensors", TrainingState(np.ones(500)), "key")
    shutil.copytree(kept, run)
    seen = set()
    for event in killed_everywhere(
        tmp_path, lambda: quietly(*training, run, "--resume"), power=power
    ):
        seen.add(load_bundle(run).record.interrupted)
        quietly(*training, run, "--resume")
        assert not load_bundle(run).record.interrupted
        assert (names(tmp_path), names(run)) == (["run"], WHOLE_RUN)
        if event is not None:
            shutil.rmtree(run)
            shutil.copytree(kept, run)
    assert seen == {True, False}


def replaced_or_not(folder, write, power):
    """Kill `write`, which replaces `out` in `folder`, everywhere: its whole content or the old."""
    out = folder / "out"
    write()
    new = tree(out)
    former = {name: text + b"\n" for name, text in new.items()}
    seen = []

    def put_former():
        for name, text in former.items():
            (folder / name).write_bytes(text)

    put_former()
    for event in killed_everywhere(folder, write, power=power):
        if out.exists():
            assert tree(out) in (former, new)
            seen.append(tree(out) == new)
        write()
        assert tree(out) == new
        assert names(folder) == ["out"]
        if event is not None:
            put_former()
    assert set(seen) == {True, False}


@HOW
def test_results_of_an_evaluation(project, tmp_path, monkeypatch, power):
    found = type("Judgement", (), {"outcome": type("Outcome", (), {"exit_code": 0})})
    monkeypatch.setattr(evaluate, "logs_for", lambda *_: [])
    monkeypatch.setattr(evaluate, "report", lambda *_: (found, DOCUMENT, "<p>a: b</p>"))
    monkeypatch.setattr(evaluate, "show", lambda *_: None)
    command = ("evaluate", project / "run", "--out", tmp_path / "out")
    replaced_or_not(tmp_path, lambda: quietly(*command), power)


DOCUMENT = {"schema": "narxcal.evaluate/1", "logs": []}


@HOW
def test_logs_of_virtual_flights(tmp_path, monkeypatch, power):
    log = flying._Written("flight_01_left.csv", b"time_s: 1\n" * 500, b"true: 1\n" * 500, {})
    monkeypatch.setattr(flying, "in_processes", lambda *_: iter([[log]]))
    monkeypatch.setattr(flying, "_truth", lambda *_: {"schema": fly.TRUTH_SCHEMA, "logs": []})
    monkeypatch.setattr(fly, "_show", lambda *_: None)
    command = ("fly", "fly_line", "--truth-channels", "--out", tmp_path / "out")
    replaced_or_not(tmp_path, lambda: quietly(*command), power)


@HOW
def test_a_replayed_log(project, tmp_path, monkeypatch, power):
    monkeypatch.setattr("narxcal.cli.replay._findings", lambda *_: ())
    table = (project / "flights" / "flight_3.csv").read_text(encoding="utf-8").splitlines()
    log = tmp_path.with_name(f"{tmp_path.name}.csv")
    log.write_text("\n".join(table[:400]), encoding="utf-8")
    command = ("replay", project / "run", log, "--overwrite", "--out", tmp_path / "out")
    replaced_or_not(tmp_path, lambda: quietly(*command), power)
    assert json.loads((project / "run/bundle.json").read_text(encoding="utf-8"))["sha256"]
