"""The figures before and after a change: what is measured of a held-out flight, what has moved."""

import json
import math

import pytest

from eval.benchmarks import Row, figures
from training.config import load_config


@pytest.fixture
def commands(monkeypatch):
    """Commands that are only noted; evaluations find an error of 2 % of N1."""
    called = []
    scores = {"N1_pct": {"rmse": 2.0, "max_rel_pct": 5.0}}
    counts = dict.fromkeys(("passed", "assessed", "mean_relative_Ti_pct"), 4.0)
    evaluation = {"pooled": {"channels": scores, "ti_tt": {**counts, "mean_relative_Tt_pct": None}}}

    def run(*arguments):
        called.append(arguments)
        if arguments[0] == "train":
            file, run = arguments[1], arguments[3]
            run.mkdir()
            (run / "bundle.json").write_text(json.dumps({"training": {"wall_s": 7.0}}))
            split = load_config(file)[0].split
            called[-1] = ("train", split.train, split.test)
        return evaluation

    monkeypatch.setattr(figures, "_narxcal", run)
    return called


def test_a_fast_run_holds_out_what_the_shipped_configuration_does(commands, capsys, tmp_path):
    out = tmp_path / "figures.json"
    assert figures.main(["--fast", "--parts", "agtf30", "--out", str(out)]) == 0
    shipped = load_config("agtf30")[0].split
    (_, train, test), _ = commands
    assert (set(train), test) == (set(shipped.train), shipped.test)
    assert json.loads(out.read_text("utf-8")) == {
        "speed: agtf30 flight_3, training, s": 7.0,
        "agtf30 flight_3, N1_pct, RMSE": 2.0,
        "agtf30 flight_3, N1_pct, largest error, %": 5.0,
        "agtf30 flight_3, Ti and Tt, passed": 4.0,
        "agtf30 flight_3, Ti and Tt, assessed": 4.0,
        "agtf30 flight_3, Ti and Tt, mean_relative_Ti_pct": 4.0,
    }
    assert capsys.readouterr().err == "agtf30: 0 s\n"


def test_what_moved_by_more_than_one_percent_is_marked_and_a_speed_is_not(capsys):
    before = {"a": 1.0, "b": 2.0, "speed: c": 1.0, "passed": 0.0, "gone": 3.0}
    after = {"a": 1.009, "b": 2.1, "speed: c": 3.0, "passed": 1.0, "new": 4.0}
    assert figures.compare(before, after) == ["b", "passed"]
    lines = capsys.readouterr().err.splitlines()
    assert [line.split()[0] for line in lines if line.endswith("<--")] == ["b", "passed"]
    assert lines[1].split() == ["b", "2", "2.1", "+5", "%", "<--"]


def test_against_figures_of_before_the_exit_code_says_whether_one_moved(monkeypatch, tmp_path):
    rows = [Row("speed", "kernel", 2.0, "us"), Row("public sets", "tanks", 0.3, "V")]
    missing = Row("public sets", "wh2009", math.nan, "mV")
    monkeypatch.setattr(figures.public_sets, "rows", lambda *_: [*rows, missing])
    before, after = tmp_path / "before.json", tmp_path / "after.json"
    assert figures.main(["--parts", "public", "--out", str(before)]) == 0
    assert json.loads(before.read_text("utf-8")) == {"speed: kernel, us": 2.0, "tanks, V": 0.3}
    again = ["--parts", "public", "--out", str(after), "--against", str(before)]
    assert figures.main(again) == 0
    rows[:] = [Row("speed", "kernel", 3.0, "us"), Row("public sets", "tanks", 0.31, "V")]
    assert figures.main(again) == 1
