"""A checkpoint goes on exactly, even after kill -9, and refuses what it does not belong to."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from narxcal.narx.config import NarxConfig
from narxcal.record import Record
from narxcal.support.errors import ModelError
from training.config import TrainConfig
from training.dynamics.network import HistoryRow, Material, TrainingState, fit_narx, net_of
from training.dynamics.optimisers import Damping, Moments
from training.methods import fingerprint, read_checkpoint, write_checkpoint

ROOT = Path(__file__).parents[2]
FULL = TrainingState(
    theta=np.array([1.0, -2.5]),
    start=1,
    stage=2,
    iteration=3,
    damping=Damping(1e-7, 8.0),
    moments=Moments(np.array([0.1, 0.2]), np.array([0.3, 0.4]), 17),
    best_theta=np.array([4.0, 5.0]),
    best_score=0.1,
    since_best=2,
    history=(HistoryRow(0, 1, 20.0, 4, 0.25, float("nan")),),
)


def same(one, other):
    for name in ("start", "stage", "iteration", "damping", "best_score", "since_best"):
        assert getattr(one, name) == getattr(other, name)
    assert np.array_equal(one.theta, other.theta)
    assert repr(one.history) == repr(other.history)
    assert repr(one.moments) == repr(other.moments)
    assert repr(one.best_theta) == repr(other.best_theta)


@pytest.mark.parametrize("progress", [FULL, TrainingState(np.array([0.5, 1e-300]))])
def test_it_comes_back_as_it_was(progress, tmp_path):
    write_checkpoint(tmp_path / "c", progress, "key")
    same(read_checkpoint(tmp_path / "c", "key"), progress)


def test_arrays_that_are_not_contiguous_come_back_whole(tmp_path):
    progress = TrainingState(np.arange(10.0)[::3])
    write_checkpoint(tmp_path / "c", progress, "key")
    assert read_checkpoint(tmp_path / "c", "key").theta.tolist() == [0.0, 3.0, 6.0, 9.0]


def test_another_training_is_refused(tmp_path):
    file = tmp_path / "c"
    write_checkpoint(file, FULL, "key")
    with pytest.raises(ModelError) as error:
        read_checkpoint(file, "other")
    assert str(error.value) == (
        f"{file}: the checkpoint belongs to a training with another configuration or other data. "
        "Restore them, or train without --resume into another folder"
    )


@given(kept=st.floats(0.0, 0.999), junk=st.binary(max_size=20))
def test_a_damaged_file_is_refused_in_words(kept, junk, tmp_path_factory):
    file = tmp_path_factory.mktemp("damaged") / "c"
    write_checkpoint(file, FULL, "key")
    data = file.read_bytes()
    damaged = data[: int(kept * len(data))] + junk
    assume(damaged != data)
    file.write_bytes(damaged)
    with pytest.raises(ModelError) as error:
        read_checkpoint(file, "key")
    assert str(error.value).startswith(f"{file}: the checkpoint cannot be read: ")
    assert str(error.value).endswith(". Train without --resume")


def test_a_fingerprint_tells_its_parts_apart():
    assert fingerprint("a", "b") == fingerprint("a", "b")
    assert len({fingerprint(*parts) for parts in (("a", "b"), ("b", "a"), ("ab",), ("a",))}) == 4


def training(file, optimiser, pause_s=0.0):
    """Train on a fixed noisy lag, going on from `file` where it exists."""
    rng = np.random.default_rng(0)
    u = np.repeat(rng.uniform(-2, 2, 16), 25)
    y = np.zeros(400)
    for k in range(1, 400):
        y[k] = 0.9 * y[k - 1] + 0.1 * np.tanh(u[k])
    material = Material([Record(u, y + 0.05 * rng.normal(size=400))], [], 1.0)
    config = TrainConfig(
        optimiser=optimiser,
        horizons_s=(20.0, 0.0),
        iterations=(8, 8),
        score_every_s=1.0,
        threads=1,
    )

    def watch(progress):
        write_checkpoint(file, progress, "key")
        time.sleep(pause_s)

    resume = read_checkpoint(file, "key") if file.is_file() else None
    structure = NarxConfig(lags=1, taps=(0,), hidden=3)
    return net_of(fit_narx(material, structure, config, watch, resume).model).get_theta()


@pytest.mark.slow
@pytest.mark.parametrize("optimiser", ["lm", "adam"])
def test_killed_and_resumed_gives_the_weights_of_the_uninterrupted_run(optimiser, tmp_path):
    killed = tmp_path / "killed"
    child = subprocess.Popen(
        [sys.executable, __file__, str(killed), optimiser],
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    )
    while child.poll() is None and not (
        killed.is_file() and len(read_checkpoint(killed, "key").history) >= 3
    ):
        time.sleep(0.02)
    os.kill(child.pid, signal.SIGKILL)
    assert child.wait() == -signal.SIGKILL
    assert 3 <= len(read_checkpoint(killed, "key").history) < 16
    assert np.array_equal(training(killed, optimiser), training(tmp_path / "whole", optimiser))
    assert {path.name for path in tmp_path.iterdir()} == {"killed", "whole"}


if __name__ == "__main__":
    training(Path(sys.argv[1]), sys.argv[2], pause_s=0.5)
