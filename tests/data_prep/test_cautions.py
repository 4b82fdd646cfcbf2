"""Warnings about logs: one line for each kind, however many logs."""

import numpy as np

from data_prep.clean import clean
from data_prep.events import EventsConfig
from data_prep.log import Log
from data_prep.prepare import Preparation, Prepared, cautions
from data_prep.reading import read_logs
from data_prep.smooth import SmoothConfig

ANYWHERE = Preparation(events=EventsConfig(condition=""))


def warnings(log, tables=ANYWHERE, outputs=()):
    return {one.kind: one.text for one in Prepared(log, tables, outputs).warnings}


def written(folder, stamps):
    rows = [f"{stamp:.10g},{80 + k},30" for k, stamp in enumerate(stamps)]
    path = folder / "log.csv"
    path.write_text("\n".join(["time_s,N1_pct,TRA_deg", *rows]) + "\n", encoding="utf-8")
    return read_logs(path)[0]


def test_stamps_coarser_than_the_rows_are_told(tmp_path):
    some = np.sort(np.random.default_rng(1).uniform(0.0, 50.0, 400))  # as rows of a bus come
    log = written(tmp_path, np.floor(some))
    said = (
        "log.csv: 350 rows have the time stamp of the row before and were left out; its stamps are "
        "coarser than its rows"
    )
    assert cautions([log], ANYWHERE)[0] == said
    assert warnings(log).keys() == {"crowded", "rate"}
    assert warnings(log, Preparation()).keys() == {"crowded", "rate", "condition"}


def test_a_few_equal_stamps_are_no_caution(tmp_path):
    stamps = np.arange(400) / 8
    stamps[100] = stamps[99]
    log = written(tmp_path, stamps)
    assert any(entry.reason == "duplicate time stamp" for entry in log.audit.entries)
    assert cautions([log], ANYWHERE) == []


def test_speeds_in_the_wrong_unit_are_told():
    time, ratio = np.arange(40) / 8, np.linspace(0.3, 1.04, 40)
    log = Log("rig.csv", time, {"N1_pct": ratio, "N2_pct": 0.9 * ratio})
    highest = "N1_pct 1.04 % and N2_pct 0.936 %"
    said = f"rig.csv: the engine never runs, at most {highest}: is the unit right?"
    assert cautions([log], ANYWHERE) == [said]
    assert warnings(log.with_channels({"N2_pct": 90.0 * ratio})) == {}
    assert warnings(Log("none.csv", time, {"EGT_C": ratio})) == {}
    assert warnings(Log("lost.csv", time, {"N1_pct": np.full(40, np.nan)})) == {}


def test_a_channel_of_which_nothing_is_left_is_told_with_why():
    speeds = {"N1_pct": np.linspace(5000.0, 7000.0, 400), "N2_pct": np.linspace(80.0, 90.0, 400)}
    log = clean(Log("rpm.csv", np.arange(400) / 8, speeds))
    said = "rpm.csv: no sample is left of N1_pct (out of range): check column and unit"
    assert cautions([log], ANYWHERE) == [said]
    assert "masked" not in warnings(log.with_channels({"N1_pct": speeds["N2_pct"]}))


def test_recordings_too_slow_for_ti_and_tt_are_told(tmp_path):
    path = tmp_path / "qar.csv"
    lever = [f"{k / 8:g},{30 + k % 40},{80 + k % 9 if k % 8 == 0 else ''}" for k in range(400)]
    path.write_text("\n".join(["time_s,TRA_deg,N1_pct", *lever]) + "\n", encoding="utf-8")
    (log,) = read_logs(path)
    said = (
        "qar.csv: N1_pct is sampled every 1 s, coarser than the tolerance of 0.25 s on Ti and Tt: "
        "these times are limited by interpolation"
    )
    assert cautions([log], ANYWHERE) == [said]
    assert warnings(log, Preparation(events=EventsConfig(condition="", response=()))) == {}
    time = 0.5 * np.arange(40)
    slow = Log("slow.csv", time, {"TRA_deg": time, "N1_pct": 80.0 + time})
    assert warnings(slow)["rate"].startswith(
        "TRA_deg is sampled every 0.5 s and N1_pct is sampled every 0.5 s, coarser than"
    )


def test_many_logs_with_the_same_warning_are_one_line():
    time = np.arange(40) / 8
    logs = [Log(name, time, {"N1_pct": 80.0 + time}) for name in "abcde"]
    said = "there is no WOW channel: events on the ground count like those in flight"
    assert cautions(logs, Preparation()) == [f"a, b, c and 2 more: {said}"]
    assert cautions(logs[:2], Preparation()) == [f"a, b: {said}"]


def test_many_logs_with_like_warnings_are_the_first_one_and_a_count():
    time = np.arange(40) / 8
    logs = [Log(f"{k}.csv", time, {"N1_pct": (1.0 + 0.1 * k) * time / 5.0}) for k in range(64)]
    (line,) = cautions(logs, ANYWHERE)
    assert line == (
        "0.csv and, likewise, 63 more: the engine never runs, at most N1_pct 0.975 %: "
        "is the unit right?"
    )
    assert len(cautions(logs[:3], ANYWHERE)) == 3


def test_a_window_that_blurs_is_a_warning_of_its_logs():
    log = Log("a.csv", np.arange(40) / 8, {"N1_pct": np.full(40, 80.0)})
    tables = Preparation(events=EventsConfig(condition=""), smooth=SmoothConfig(window=11))
    assert warnings(log, tables) == {
        "window": "[smooth] window = 11 lasts 1.4 s at 8 Hz, which blurs fast movements: take 1"
    }
