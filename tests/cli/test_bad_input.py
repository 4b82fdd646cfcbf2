"""Bad input ends in one line that says what, where and what to do, and in code 2.

The messages themselves are tested where they arise.
"""

import json
import shutil

import numpy as np
import pandas as pd
import pytest

from narxcal.cli import train

FLIGHT = "flight_3.csv"


@pytest.fixture
def flight(project):
    return pd.read_csv(project / "flights" / FLIGHT).iloc[: 60 * 32]


def refused(done, message):
    """Exit code 2, exactly one line on stderr, nothing on stdout."""
    assert (done.code, done.out) == (2, "")
    assert done.err == f"narxcal: error: {message}\n"


def test_logs_of_mixed_rates_are_read_at_the_median_one_which_is_said(
    narxcal, project, tmp_path, monkeypatch
):
    shutil.copytree(project / "flights", tmp_path / "flights")
    file = tmp_path / "flights" / "flight_2.csv"
    pd.read_csv(file).iloc[::2].to_csv(file, index=False)
    text = (project / "tiny.toml").read_text("utf-8").replace("raster_hz = 8.0\n", "")
    (tmp_path / "run.toml").write_text(text, "utf-8")
    read = []

    def stop(_config, _base, split, _options):
        read.extend(log.dt_s for log in split.train)
        raise KeyboardInterrupt

    monkeypatch.setattr(train, "calibrate", stop)
    done = narxcal("train", tmp_path / "run.toml", "--out", tmp_path / "run")
    files = [*(tmp_path / "flights").glob("*.csv")]
    intervals = [np.diff(pd.read_csv(one)["time_s"]).mean() for one in files]
    assert done.code == 130
    assert done.err == (
        "narxcal: warning: sampling intervals differ between logs: all are read every "
        f"{np.median(intervals):g} s\nnarxcal: interrupted; nothing was written\n"
    )
    assert read == pytest.approx([np.median(intervals)] * 2)


@pytest.mark.usefixtures("undrawn")
def test_a_log_of_another_rate_is_put_on_the_model_s_raster(narxcal, project, flight, tmp_path):
    file = tmp_path / "slow.csv"
    flight.iloc[::2].to_csv(file, index=False)
    done = narxcal("evaluate", project / "run", "--logs", file, "--out", tmp_path / "out", "--json")
    assert json.loads(done.out)["logs"][0]["dt_s"] == pytest.approx(0.125)


@pytest.mark.usefixtures("undrawn")
def test_a_constant_lever_gives_no_events_and_no_pass(narxcal, project, flight, tmp_path):
    file = tmp_path / "still.csv"
    flight.assign(TRA_deg=30.0).to_csv(file, index=False)
    done = narxcal("evaluate", project / "run", "--logs", file, "--out", tmp_path / "out")
    assert done.code == 1
    assert "Ti/Tt: no transient could be assessed (no event was found)." in done.out
    assert "Ti and Tt of" not in done.out  # a table without rows
    document = json.loads((tmp_path / "out" / "evaluate.json").read_text("utf-8"))
    assert document["ok"] is False
    assert document["logs"][0]["ti_tt"]["assessed"] == 0


@pytest.fixture
def bundle(project, tmp_path):
    shutil.copytree(project / "run", tmp_path / "run")
    return tmp_path / "run"


@pytest.mark.parametrize("command", ["prepare", "train", "crossval"])
def test_an_output_folder_with_other_content(narxcal, project, tmp_path, command):
    (tmp_path / "notes.txt").write_text("mine", "utf-8")
    done = narxcal(command, project / "tiny.toml", "--out", tmp_path)
    if command == "train":
        what = "exists and is not empty. Choose another name"
    else:
        what = (
            "holds other content ('notes.txt') and is not overwritten. "
            "Choose another name, or empty it yourself"
        )
    refused(done, f"output folder {tmp_path} {what}")
    assert [path.name for path in tmp_path.iterdir()] == ["notes.txt"]


def test_a_trained_model_is_never_trained_over(narxcal, project, bundle):
    done = narxcal("train", project / "tiny.toml", "--out", bundle)
    refused(done, f"output folder {bundle} holds a trained model. Choose another name")


BAD_LINES = {
    "": "the following arguments are required: COMMAND. See narxcal --help",
    "info": "the following arguments are required: RUN. See narxcal info --help",
    "info run --jason": "unrecognized arguments: --jason. See narxcal --help",
    "evaluate run --trim 1.5": "argument --trim: expected a fraction from 0 to 0.9, found 1.5. "
    "See narxcal evaluate --help",
    "evaluate run --trim much": "argument --trim: expected a fraction from 0 to 0.9, found much. "
    "See narxcal evaluate --help",
    "crossval c.toml --out d --jobs 0": "argument --jobs: expected a whole number of 1 or more, "
    "found 0. See narxcal crossval --help",
    "crossval c.toml --out d --jobs many": "argument --jobs: expected a whole number of 1 or "
    "more, found many. See narxcal crossval --help",
    "reproduce narx-paper --out d --seed -4": "argument --seed: expected a whole number of 0 or "
    "more, found -4. See narxcal reproduce --help",
}


@pytest.mark.parametrize("words", BAD_LINES)
def test_a_bad_command_line(narxcal, words):
    refused(narxcal(*words.split()), BAD_LINES[words])


def test_an_engine_that_the_log_does_not_have(narxcal, project, tmp_path):
    log = project / "flights" / FLIGHT
    done = narxcal(
        "replay", project / "run", log, "--out", tmp_path / "out.csv", "--engine", "left"
    )
    refused(
        done,
        f"{log}: unknown engine 'left'. It holds one engine, without a name",
    )
    assert list(tmp_path.iterdir()) == []


def test_a_file_where_a_folder_belongs_and_the_other_way_round(narxcal, project, tmp_path):
    config, logs = project / "tiny.toml", project / "flights"
    refused(
        narxcal("info", config),
        f"{config}: a bundle is a folder, and this is a file. "
        "Name the folder that narxcal train wrote",
    )
    refused(
        narxcal("prepare", logs, "--out", tmp_path / "out"),
        f"{logs}: a configuration is a file, and this is a folder. Name the TOML file in it",
    )
    refused(
        narxcal("prepare", config, "--data", config, "--out", tmp_path / "out"),
        f"{config}: the folder of the logs is a file. Set [logs] folder, or name another by --data",
    )
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("command", ["simulate", "replay"])
def test_a_result_takes_the_place_of_neither_a_folder_nor_its_input(
    narxcal, project, tmp_path, command
):
    log = tmp_path / FLIGHT
    shutil.copy(project / "flights" / FLIGHT, log)
    before = log.read_bytes()
    refused(
        narxcal(command, project / "run", log, "--out", tmp_path),
        f"output file {tmp_path} is a folder. Name a file, such as {tmp_path / 'out.csv'}",
    )
    refused(
        narxcal(command, project / "run", log, "--out", log),
        f"output file {log} is the input itself. Choose another name",
    )
    assert log.read_bytes() == before
