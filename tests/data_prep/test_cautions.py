"""What is said of logs before their figures."""

import numpy as np

from data_prep.clean import clean
from data_prep.events import EventsConfig
from data_prep.log import Log
from data_prep.prepare import all_masked, cautions, crowded, never_runs, seldom
from data_prep.reading import read_logs

EVENTS = EventsConfig(condition="")


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
    assert crowded(log) == said
    assert cautions([log], EVENTS) == [said, seldom(log, EVENTS)]
    assert len(cautions([log], EventsConfig())) == 3


def test_a_few_equal_stamps_are_no_caution(tmp_path):
    stamps = np.arange(400) / 8
    stamps[100] = stamps[99]
    log = written(tmp_path, stamps)
    assert any(entry.reason == "duplicate time stamp" for entry in log.audit.entries)
    assert cautions([log], EVENTS) == []


def test_speeds_in_the_wrong_unit_are_told():
    time, ratio = np.arange(40) / 8, np.linspace(0.3, 1.04, 40)
    log = Log("rig.csv", time, {"N1_pct": ratio, "N2_pct": 0.9 * ratio})
    highest = "N1_pct 1.04 % and N2_pct 0.936 %"
    said = f"rig.csv: the engine never runs, at most {highest}: is the unit right?"
    assert cautions([log], EVENTS) == [said]
    assert never_runs(log.with_channels({"N2_pct": 90.0 * ratio})) == ""
    assert never_runs(Log("none.csv", time, {"EGT_C": ratio})) == ""
    assert never_runs(Log("lost.csv", time, {"N1_pct": np.full(40, np.nan)})) == ""


def test_a_channel_of_which_nothing_is_left_is_told_with_why():
    speeds = {"N1_pct": np.linspace(5000.0, 7000.0, 400), "N2_pct": np.linspace(80.0, 90.0, 400)}
    log = clean(Log("rpm.csv", np.arange(400) / 8, speeds))
    said = "rpm.csv: no sample is left of N1_pct (out of range): check column and unit"
    assert cautions([log], EVENTS) == [said]
    assert all_masked(log.with_channels({"N1_pct": speeds["N2_pct"]})) == ""


def test_recordings_too_slow_for_ti_and_tt_are_told(tmp_path):
    path = tmp_path / "qar.csv"
    lever = [f"{k / 8:g},{30 + k % 40},{80 + k % 9 if k % 8 == 0 else ''}" for k in range(400)]
    path.write_text("\n".join(["time_s,TRA_deg,N1_pct", *lever]) + "\n", encoding="utf-8")
    (log,) = read_logs(path)
    said = (
        "qar.csv: recorded are N1_pct about every 1 s, while Ti and Tt have to agree within "
        "0.25 s: what they say rests on interpolation"
    )
    assert cautions([log], EVENTS) == [said]
    assert seldom(log, EventsConfig(response=("TRA_deg",))) == ""
    time = 0.5 * np.arange(40)
    slow = Log("slow.csv", time, {"TRA_deg": time, "N1_pct": 80.0 + time})
    assert seldom(slow, EVENTS).startswith(
        "slow.csv: recorded are TRA_deg about every 0.5 s and N1_pct about every 0.5 s, while"
    )
