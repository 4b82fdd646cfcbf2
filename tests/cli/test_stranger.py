"""Who has logs and nothing else: columns and a split are enough, and what is assumed is said."""

import json

import pandas as pd
import pytest

CONFIG = """\
schema = "narxcal.config/1"

[logs]
folder = "flights"

[split]
train = ["flight_[12]*"]
test = ["flight_3*"]

[steady_state]
inputs = ["TRA_deg", "ALT_ft"]

[train]
horizons_s = [30.0]
iterations = [2]
choice_s = 0.0
delay_s = 0.0
"""
SAID = "{}: there is no WOW channel: events on the ground count like those in flight"


@pytest.fixture
def folder(slow_probe, tmp_path):
    """Three flights without a switch, and a configuration that asks for nothing special."""
    (tmp_path / "flights").mkdir()
    for seed in (1, 2, 3):
        slow_probe(seed)[0].to_csv(tmp_path / "flights" / f"flight_{seed}.csv", index=False)
    (tmp_path / "mine.toml").write_text(CONFIG, "utf-8-sig")  # as Notepad does
    return tmp_path


@pytest.mark.slow
def test_without_weight_on_wheels_every_event_counts_which_is_said(folder, narxcal):
    logs = [f"flight_{seed}.csv" for seed in (1, 2, 3)]
    done = narxcal("prepare", folder / "mine.toml", "--out", folder / "prepared")
    said = SAID.format(", ".join(logs))
    assert (done.code, done.err) == (0, f"narxcal: warning: {said}\n")
    document = json.loads((folder / "prepared/prepare.json").read_text("utf-8"))
    assert document["cautions"] == [said]
    assert all(log["events"]["found"] >= 5 for log in document["logs"])
    assert f"<li>{said}</li>" in (folder / "prepared/prepare.html").read_text("utf-8")

    done = narxcal("train", folder / "mine.toml", "--out", folder / "run", "--quiet")
    assert (done.code, done.err) == (0, f"narxcal: warning: {said}\n")

    done = narxcal("evaluate", folder / "run", "--out", folder / "ev", "--quiet")
    said = SAID.format(logs[2])
    assert done.code in (0, 1)
    assert done.err.startswith(f"narxcal: warning: {said}\n")
    document = json.loads((folder / "ev/evaluate.json").read_text("utf-8"))
    assert document["cautions"][0] == said
    assert document["logs"][0]["events"]
    assert f"<li>{said}</li>" in (folder / "ev/evaluate.html").read_text("utf-8")


def refused(done, message):
    """Exit code 2 and one line."""
    assert (done.code, done.out) == (2, "")
    assert done.err == f"narxcal: error: {message}\n"


@pytest.mark.parametrize("command", ["prepare", "train", "crossval"])
def test_a_place_that_cannot_be_written_is_refused_before_any_work(folder, narxcal, command):
    (folder / "flights/flight_1.csv").write_text("what is worked on first", "utf-8")
    out = folder / "mine.toml" / "out"
    refused(
        narxcal(command, folder / "mine.toml", "--out", out),
        f"{out}: cannot write: Not a directory. Nothing was changed; choose another place",
    )


def test_a_file_that_cannot_be_written_is_refused_before_any_work(project, narxcal):
    out = project / "tiny.toml" / "out.csv"
    refused(
        narxcal("replay", project / "nothing", project / "nothing.csv", "--out", out),
        f"{out}: cannot write: Not a directory. Nothing was changed; choose another place",
    )


def test_headers_that_are_no_channels_are_told_with_what_to_do(folder, project, narxcal):
    file = folder / "rig.csv"
    file.write_text("time_s,rpm,egt\n0,1,2\n1,1,2\n", "utf-8")
    refused(
        narxcal("evaluate", project / "run", "--logs", file, "--out", folder / "ev"),
        f"{file}: no column but 'time_s' is named as a channel. Map the columns under "
        "[logs.columns]. The file has time_s, rpm, egt",
    )


def test_a_folder_in_the_place_of_a_log(folder, project, narxcal):
    logs = folder / "flights"
    message = f"{logs}: a log is a file, and this is a folder. Name the files in it"
    refused(narxcal("evaluate", project / "run", "--logs", logs, "--out", folder / "ev"), message)
    refused(narxcal("replay", project / "run", logs, "--out", folder / "out.csv"), message)


def test_resuming_what_never_began_is_said(training, tmp_path, narxcal):
    run = tmp_path / "run"
    done = narxcal(*training, run, "--resume", "--quiet")
    assert done.code == 0
    said = f"narxcal: warning: nothing to resume in {run}: the training begins anew\n"
    assert done.err.startswith(said)


@pytest.mark.usefixtures("undrawn")
def test_inputs_that_leave_the_ranges_of_a_table_are_named(project, narxcal, tmp_path):
    flight = pd.read_csv(project / "flights/flight_3.csv")
    file = tmp_path / "high.csv"
    flight.assign(ALT_ft=55000.0).to_csv(file, index=False)
    done = narxcal("evaluate", project / "run", "--logs", file, "--out", tmp_path / "ev", "--json")
    said = (
        "high.csv: 100 % of the samples are outside the envelope of the steady-state model "
        "(ALT_ft is 55000 to 55000, the envelope -1000 to 40000)"
    )
    assert json.loads(done.out)["cautions"][-1] == said
    assert done.err.splitlines()[-1] == f"narxcal: warning: {said}"
