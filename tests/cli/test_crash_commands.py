"""A training that loses power at any of its file events; the fit is done once and given again.

Files and folders of results: tests/support/test_crash.py; kills in any order: test_runs_machine.py.
"""

import shutil
from dataclasses import replace

import numpy as np
import pytest

from narxcal.calibration.bundle import load_bundle, write_bundle
from narxcal.cli import main
from tests.crash import killed_everywhere
from training.dynamics.network import TrainingState
from training.methods import write_checkpoint

pytestmark = pytest.mark.slow
WHOLE_RUN = ["bundle.json", "weights.safetensors"]


@pytest.fixture(autouse=True)
def _quick(monkeypatch):
    """What is put right between two kills need not be flushed to the real disk."""
    monkeypatch.setattr("os.fsync", lambda _: None)


def names(folder):
    return sorted(item.name for item in folder.iterdir())


def quietly(*words):
    assert main([*map(str, words), "--quiet"]) in {0, 1}


def test_a_training_cut_off_anywhere_is_resumed_to_the_same_model(training, tmp_path):
    run = tmp_path / "run"
    kills = 0
    for event in killed_everywhere(tmp_path, lambda: quietly(*training, run), power=True):
        if (run / "bundle.json").exists():
            load_bundle(run)
        kills += event is not None
        quietly(*training, run, "--resume")
        assert load_bundle(run).record.training.status
        assert (names(tmp_path), names(run)) == (["run"], WHOLE_RUN)
        if event is not None:
            shutil.rmtree(run)
    assert kills >= 20


def test_going_on_with_a_training_may_be_cut_off_anywhere(project, training, tmp_path):
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
        tmp_path, lambda: quietly(*training, run, "--resume"), power=True
    ):
        seen.add(load_bundle(run).record.interrupted)
        quietly(*training, run, "--resume")
        assert not load_bundle(run).record.interrupted
        assert (names(tmp_path), names(run)) == (["run"], WHOLE_RUN)
        if event is not None:
            shutil.rmtree(run)
            shutil.copytree(kept, run)
    assert seen == {True, False}
