"""How commands end: resumed, interrupted, killed, on a full disk, cut off by a reader."""

import json
import os
import resource
import signal
import sys
import time
from io import StringIO
from pathlib import Path

import pytest

from data_prep.sources import csv_source
from narxcal.calibration.bundle import load_bundle
from narxcal.cli import console, demo
from training import pipeline

LONG = ("iterations = [2, 2]", "iterations = [40, 40]\nchoice_s = 0")
CHECKPOINT = "checkpoints/checkpoint-joint.safetensors"


@pytest.fixture
def long(project, tmp_path):
    """A configuration whose training takes seconds, and the folder it is to write."""
    text = (project / "tiny.toml").read_text("utf-8").replace(*LONG)
    folder = f'folder = "{project / "flights"}"'
    (tmp_path / "long.toml").write_text(text.replace('folder = "flights"', folder), "utf-8")
    return tmp_path / "long.toml", tmp_path / "run"


def wait_for(path, process, written=0):
    """Wait for a file that is newer than `written`."""
    deadline = time.monotonic() + 600.0  # a busy machine is no failure
    while not path.is_file() or path.stat().st_mtime_ns <= written:
        assert process.poll() is None, process.stderr.read()
        assert time.monotonic() < deadline
        time.sleep(0.01)


def weights(run):
    return json.loads((run / "bundle.json").read_text("utf-8"))["weights"]["sha256"]


@pytest.mark.slow
def test_a_training_that_is_killed_and_then_interrupted_ends_as_the_same_model(
    long, start, narxcal
):
    config, run = long
    process = start("train", config, "--out", run)
    wait_for(run / CHECKPOINT, process)
    time.sleep(0.2)
    process.kill()
    process.communicate()
    assert process.returncode == -signal.SIGKILL
    assert not (run / "bundle.json").exists()

    again = narxcal("train", config, "--out", run)
    assert again.code == 2
    assert again.err == (
        f"narxcal: error: output folder {run} holds an unfinished training. "
        "Go on with it by --resume, or choose another name\n"
    )
    assert narxcal("info", run).code == 2

    written = (run / CHECKPOINT).stat().st_mtime_ns
    process = start("train", config, "--out", run, "--resume", "--json")
    wait_for(run / CHECKPOINT, process, written)
    process.send_signal(signal.SIGINT)
    out, err = process.communicate()
    assert (process.returncode, err) == (0, "")
    assert json.loads(out)["interrupted"] is True
    assert load_bundle(run).record.training.status.startswith("interrupted")

    done = narxcal("train", config, "--out", run, "--resume", "--json")
    assert json.loads(done.out)["interrupted"] is False
    assert not (run / "checkpoints").exists()
    whole = run.with_name("whole")
    assert narxcal("train", config, "--out", whole, "--quiet").code == 0
    assert weights(run) == weights(whole)


def test_resuming_a_complete_training_changes_nothing(project, narxcal):
    before = weights(project / "run")
    done = narxcal("train", project / "tiny.toml", "--out", project / "run", "--resume")
    assert (done.code, done.err) == (0, "")
    assert done.out == f"{project / 'run'} is complete; nothing is left to do.\n"
    assert weights(project / "run") == before


def test_resuming_with_another_configuration_is_refused(project, narxcal, tmp_path):
    text = (project / "tiny.toml").read_text("utf-8").replace(*LONG)
    (project / "other.toml").write_text(text, "utf-8")
    done = narxcal("train", project / "other.toml", "--out", project / "run", "--resume")
    assert done.code == 2
    assert done.err == (
        f"narxcal: error: output folder {project / 'run'} holds a model of another "
        "configuration. Choose another name\n"
    )


def test_ctrl_c_before_anything_is_written_says_so(project, narxcal, monkeypatch, tmp_path):
    def stop(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(pipeline, "prepare_logs", stop)
    done = narxcal("train", project / "tiny.toml", "--out", tmp_path / "run")
    assert (done.code, done.out) == (130, "")
    assert done.err == "narxcal: interrupted; nothing was written\n"
    assert not (tmp_path / "run").exists()


def test_ctrl_c_that_the_reader_of_a_file_drops_is_no_error_of_the_file(
    project, narxcal, monkeypatch, tmp_path
):
    class Pressed(StringIO):
        def read(self, size=-1):
            """Pandas' parser calls it from C and drops what it raises."""
            signal.raise_signal(signal.SIGINT)
            return super().read(size)

    monkeypatch.setattr(csv_source, "StringIO", Pressed)
    done = narxcal("train", project / "tiny.toml", "--out", tmp_path / "run")
    assert (done.code, done.out) == (130, "")
    assert done.err == "narxcal: interrupted; nothing was written\n"


def test_ctrl_c_after_the_last_step_names_the_way_on(
    training, project, narxcal, monkeypatch, tmp_path
):
    def stop(*_):
        raise KeyboardInterrupt

    run = tmp_path / "run"
    with monkeypatch.context() as patch:
        patch.setattr("narxcal.cli.train.write_bundle", stop)
        done = narxcal(*training, run)
    assert done.code == 130
    assert done.err == (
        "narxcal: interrupted; no model was written; "
        f"train --resume --out {run} goes on from the last step\n"
    )
    assert narxcal(*training, run, "--resume", "--quiet").code == 0
    assert weights(run) == weights(project / "run")


def small_disk():
    """No file of this process may grow beyond 4 KiB, as if the disk were full."""
    resource.setrlimit(resource.RLIMIT_FSIZE, (4096, 4096))


@pytest.mark.slow
def test_a_full_disk_leaves_no_half_of_a_folder(project, shell, tmp_path):
    out = tmp_path / "prepared"
    done = shell("prepare", project / "tiny.toml", "--out", out, preexec_fn=small_disk)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr == (
        f"narxcal: error: {out}: cannot write: File too large. "
        "Nothing was changed; free some space or choose another place\n"
    )
    assert list(tmp_path.iterdir()) == []


def test_a_full_disk_leaves_no_half_of_a_file(project, narxcal, monkeypatch, tmp_path):
    inputs = project / "flights" / "flight_3.csv"

    def full(*_):
        raise OSError(28, os.strerror(28))

    monkeypatch.setattr(os, "fsync", full)
    for command in ("simulate", "replay"):
        out = tmp_path / f"{command}.csv"
        done = narxcal(command, project / "run", inputs, "--out", out)
        assert (done.code, done.out) == (2, "")
        assert done.err == (
            f"narxcal: error: {out}: cannot write: No space left on device. "
            "Nothing was changed; free some space or choose another place\n"
        )
    assert list(tmp_path.iterdir()) == []


def test_a_disk_that_fills_while_the_model_is_written_leaves_no_model(
    training, project, narxcal, monkeypatch, tmp_path
):
    run, real = tmp_path / "run", os.fsync

    def full(descriptor):
        if "weights" in str(Path(f"/proc/self/fd/{descriptor}").readlink()):
            raise OSError(28, os.strerror(28))
        real(descriptor)

    with monkeypatch.context() as patch:
        patch.setattr(os, "fsync", full)
        done = narxcal(*training, run)
    assert done.code == 2
    assert done.err == (
        f"narxcal: error: {run / 'weights.safetensors.new'}: cannot write: "
        "No space left on device. Nothing was changed; free some space or choose another place\n"
    )
    assert narxcal("info", run).code == 2
    assert narxcal(*training, run, "--resume", "--quiet").code == 0
    assert weights(run) == weights(project / "run")


@pytest.mark.slow
def test_a_full_standard_output_ends_in_one_line(project, shell):
    with Path("/dev/full").open("w", encoding="utf-8") as full:
        done = shell("info", project / "run", "--json", stdout=full)
    assert (done.returncode, done.stderr) == (2, "narxcal: error: No space left on device\n")


@pytest.mark.slow
@pytest.mark.parametrize("more", [(), ("--json",)])
def test_a_reader_that_goes_away_is_no_error(project, start, more):
    process = start("info", project / "run", *more)
    process.stdout.close()
    err = process.stderr.read()
    assert (process.wait(), err) == (141, "")
    process.stderr.close()


def test_an_internal_error_is_one_line_that_names_the_way_to_the_traceback(
    project, narxcal, monkeypatch
):
    def broken(*_):
        raise ZeroDivisionError("float division\nby zero")

    monkeypatch.setattr(console.Console, "facts", broken)
    done = narxcal("info", project / "run")
    assert (done.code, done.out) == (3, "")
    assert done.err == (
        "narxcal: internal error: ZeroDivisionError: float division by zero. "
        "Set NARXCAL_TRACEBACK=1 or add --traceback to see where, and report it\n"
    )
    monkeypatch.setenv("NARXCAL_TRACEBACK", "1")
    assert "in broken" in narxcal("info", project / "run").err
    monkeypatch.delenv("NARXCAL_TRACEBACK")
    assert "in broken" in narxcal("info", project / "run", "--traceback").err


def test_an_unfinished_demonstration_is_marked_and_can_be_begun_again(
    narxcal, monkeypatch, tmp_path
):

    def stop(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(demo, "train", stop)
    monkeypatch.setattr(demo, "write_flights", lambda folder, *_: folder.mkdir() or {})
    for _ in range(2):
        done = narxcal("demo", "--out", tmp_path / "demo")
        assert done.code == 130
        document = json.loads((tmp_path / "demo" / "demo.json").read_text("utf-8"))
        assert document == {"schema": "narxcal.demo/1", "complete": False}


def test_progress_goes_to_a_terminal_only(capsys, monkeypatch):
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    with console.Console().progress("Working") as advance:
        advance(1, 2, "half")
    assert "Working (half)" in capsys.readouterr().err
    for silent in (console.Console(quiet=True), console.Console(json=True)):
        with silent.progress("Working") as advance:
            advance(1, 2, "half")
    monkeypatch.setattr(sys.stderr, "isatty", lambda: False)
    with console.Console().progress("Working") as advance:
        advance(1, 2, "half")
    assert capsys.readouterr().err == ""


def test_what_is_no_number_becomes_null_in_json():
    text = console.to_json({"a": float("nan"), "b": [float("inf"), 1.0], "c": ({"d": None},)})
    assert json.loads(text) == {"a": None, "b": [None, 1.0], "c": [{"d": None}]}
