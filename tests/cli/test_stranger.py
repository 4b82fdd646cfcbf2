"""Who has logs and nothing else: columns and a split are enough, and what is assumed is said."""

import json

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
"""
SAID = "no WOW channel in {}: events on the ground count like those in flight"


@pytest.fixture
def folder(slow_probe, tmp_path):
    """Three flights without a switch, and a configuration that asks for nothing special."""
    (tmp_path / "flights").mkdir()
    for seed in (1, 2, 3):
        slow_probe(seed)[0].to_csv(tmp_path / "flights" / f"flight_{seed}.csv", index=False)
    (tmp_path / "mine.toml").write_text(CONFIG, "utf-8-sig")  # as Notepad does
    return tmp_path


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
    assert done.err == f"narxcal: warning: {said}\n"
    document = json.loads((folder / "ev/evaluate.json").read_text("utf-8"))
    assert document["cautions"] == [said]
    assert document["logs"][0]["events"]
    assert f"<li>{said}</li>" in (folder / "ev/evaluate.html").read_text("utf-8")


def test_weight_on_wheels_that_was_asked_for_has_to_be_there(folder, narxcal):
    config = folder / "mine.toml"
    config.write_text(CONFIG + '[events]\ncondition = "WOW"\n', "utf-8")
    done = narxcal("prepare", config, "--out", folder / "prepared")
    assert done.code == 2
    assert done.err == (
        "narxcal: error: flight_1.csv, channel WOW: events need their condition channel, and the "
        'log has none. Derive it in [logs], or set condition = "" in [events]\n'
    )
