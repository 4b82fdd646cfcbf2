"""Files of one flight, joined by time: as one file that nobody cut."""

import re
from itertools import pairwise

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from data_prep.config import LogsConfig
from data_prep.reading import read_logs
from data_prep.sources.csv_source import Pace
from data_prep.sources.log_file import open_log
from narxcal.support.errors import ConfigError, DataError

BY_PART = {"flights": ["{flight}_*.csv"]}
BY_KIND = {"flights": ["{flight}_engine.csv", "{flight}_air.csv"]}


def recording(rows=400, first_s=10.0):
    time_s = first_s + np.arange(rows) / 8.0
    speed = 80.0 + 10.0 * np.sin(time_s / 3.0)
    return pd.DataFrame({
        "time_s": time_s, "N1_pct": speed, "EGT_C": 5.0 * speed, "ALT_ft": 1000.0 + time_s,
    })  # fmt: skip


def written(folder, **tables):
    folder.mkdir(exist_ok=True)
    for name, table in tables.items():
        table.to_csv(folder / f"{name}.csv", index=False)
    return folder


def same(one, other):
    assert one.channels.keys() == other.channels.keys()
    assert np.array_equal(one.time_s, other.time_s)
    return all(np.array_equal(one[name], other[name], equal_nan=True) for name in one.channels)


def read(folder, config):
    logs = LogsConfig.parse({**config, "folder": str(folder)})
    return read_logs(logs.resolve(folder), logs)


@settings(max_examples=20)
@given(st.lists(st.integers(5, 395), min_size=1, max_size=3, unique=True))
def test_a_flight_that_was_cut_is_read_as_if_it_were_whole(tmp_path_factory, cuts):
    folder, table = tmp_path_factory.mktemp("cut"), recording()
    edges = [0, *sorted(cuts), len(table)]
    parts = {f"f1_{k}": table[a:b] for k, (a, b) in enumerate(pairwise(edges))}
    (whole,) = read_logs(written(folder / "whole", f1=table) / "f1.csv")
    (log,) = read(written(folder / "parts", **parts), BY_PART)
    assert (log.name, log.source.file) == ("f1", str(folder / "parts" / "f1_0.csv"))
    assert same(log, whole)


def test_channels_in_files_of_their_own_are_those_of_one_file_with_blank_cells(tmp_path):
    table = recording()
    slow = table["ALT_ft"].where(np.arange(len(table)) % 8 == 0)
    (whole,) = read_logs(written(tmp_path / "w", f1=table.assign(ALT_ft=slow)) / "f1.csv")
    air = table[["time_s", "ALT_ft"]][::8]
    parts = written(tmp_path / "p", f1_engine=table.drop(columns="ALT_ft"), f1_air=air)
    (log,) = read(parts, BY_KIND)
    assert same(log, whole)
    assert set(log.interpolated) == {"ALT_ft"}
    (by_part,) = read_logs(parts / "f1_engine.csv", LogsConfig.parse(BY_KIND))
    assert by_part.source == log.source


def test_a_clock_of_whole_seconds_is_joined_row_by_row(tmp_path):
    table = recording(first_s=0.0)
    table["time_s"] = np.floor(table["time_s"])
    (whole,) = read_logs(written(tmp_path / "w", f1=table) / "f1.csv")
    parts = written(
        tmp_path / "p",
        f1_engine=table.drop(columns="ALT_ft"), f1_air=table[["time_s", "ALT_ft"]],
    )  # fmt: skip
    assert same(read(parts, BY_KIND)[0], whole)
    cut = written(tmp_path / "c", f1_1=table[:101], f1_2=table[101:])  # within a second
    assert same(read(cut, BY_PART)[0], whole)


def test_a_cut_at_midnight_goes_on(tmp_path):
    table = recording(first_s=86380.0)
    clock = [f"{int(t % 86400) // 3600:02}:{int(t % 3600) // 60:02}:{t % 60:06.3f}"
             for t in table["time_s"]]  # fmt: skip
    table["time_s"] = clock
    (whole,) = read_logs(written(tmp_path / "w", f1=table) / "f1.csv")
    (log,) = read(written(tmp_path / "p", f1_1=table[:160], f1_2=table[160:]), BY_PART)
    assert same(log, whole)


def test_a_gap_between_files_divides_the_log_as_one_within_a_file_does(tmp_path):
    table = recording().drop(index=range(150, 200))
    whole = read_logs(written(tmp_path / "w", f1=table) / "f1.csv")
    found = read(written(tmp_path / "p", f1_1=table[:150], f1_2=table[150:]), BY_PART)
    assert [log.name for log in found] == ["f1", "f1#2"]
    assert all(same(*pair) for pair in zip(found, whole, strict=True))


def test_rows_that_both_files_hold_are_taken_once(tmp_path):
    table = recording()
    (whole,) = read_logs(written(tmp_path / "w", f1=table) / "f1.csv")
    (log,) = read(written(tmp_path / "p", f1_1=table[:200], f1_2=table[160:]), BY_PART)
    assert same(log, whole)


def test_a_flight_of_one_file_and_a_file_of_none_are_read_as_files(tmp_path):
    table = recording()
    folder = written(tmp_path / "p", f1_1=table[:200], f1_2=table[200:], f2_1=table, other=table)
    assert [log.name for log in read(folder, BY_PART)] == ["f1", "f2_1.csv", "other.csv"]


@pytest.mark.parametrize(
    ("parts", "problem"),
    [
        (
            {"f1_1": recording(), "f1_2": recording().assign(N1_pct=50.0)},
            r"channel N1_pct: it and f1_2.csv overlap from 10 s to 59.875 s, and differ at 10 .*",
        ),
        (
            {"f1_1": recording(), "f1_2": recording(first_s=30.06)},
            r"channel ALT_ft: it and f1_2.csv overlap from 30.06 s to 59.875 s, and differ at 30.*",
        ),
        (
            {
                "f1_1": recording()[["time_s", "N1_pct"]],
                "f1_2": recording(first_s=900.0)[["time_s", "ALT_ft"]],
            },
            r"channel time_s: it runs from 10 s to 59.875 s and f1_2.csv from 900 s to 949.875 .*",
        ),
    ],
)
def test_files_that_do_not_fit_together_are_refused(tmp_path, parts, problem):
    folder = written(tmp_path / "p", **parts)
    with pytest.raises(DataError) as caught:
        read(folder, BY_PART)
    assert re.fullmatch(re.escape(f"{folder}/f1_1.csv, ") + problem, str(caught.value))
    assert "Files of one flight need one clock, which does not start anew" in str(caught.value)


def test_a_column_that_no_file_has_is_named(tmp_path):
    table = recording()
    folder = written(tmp_path / "p", f1_1=table[["time_s", "N1_pct"]], f1_2=table[["time_s"]])
    columns = {name: {"column": name} for name in ("time_s", "N1_pct", "EGT_C")}
    with pytest.raises(DataError) as caught:
        read(folder, {**BY_PART, "columns": columns})
    assert str(caught.value) == (
        f"{folder}/f1_1.csv, channel EGT_C: no file of flight 'f1' has column 'EGT_C'. Where a "
        "flight may lack it: optional = true. Its files are f1_1.csv, f1_2.csv"
    )


def test_a_flight_is_replayed_whole_and_cannot_be_followed(tmp_path):
    table = recording()
    folder = written(tmp_path / "p", f1_1=table[:200], f1_2=table[200:])
    flight = open_log(folder / "f1_2.csv", LogsConfig.parse(BY_PART))
    (block,) = flight.blocks(flight.engines, Pace(live=True))
    np.testing.assert_array_equal(block[""]["N1_pct"], table["N1_pct"])
    with pytest.raises(DataError, match="a flight of several files cannot be followed"):
        next(flight.blocks(flight.engines, Pace(live=True, follow=True)))


def test_a_file_that_is_not_there_is_no_part_of_a_flight(tmp_path):
    folder = written(tmp_path / "p", f1_1=recording())
    for path in (folder / "f1_2.csv", tmp_path / "none" / "f1_2.csv"):
        with pytest.raises(DataError, match="the file does not exist"):
            read_logs(path, LogsConfig.parse(BY_PART))


@pytest.mark.parametrize("pattern", ["f_*.csv", "{flight}_{flight}.csv", "day/{flight}.csv"])
def test_a_pattern_that_names_no_flight_is_refused(pattern):
    with pytest.raises(ConfigError, match=r"expected names of files with \{flight\} in them"):
        LogsConfig.parse({"flights": [pattern]})
