"""Which logs are which data set, and what is refused."""

import shutil
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from eval.reproduce.data import counted, numbered, read_data_sets, truth_of
from narxcal.support.errors import DataError


def test_files_are_counted_as_a_person_counts():
    names = ["set_10.csv", "set_9.csv", "set_1.csv", "b_2.csv", "2_a.csv"]
    ordered = sorted(map(Path, names), key=counted)
    assert [path.name for path in ordered] == [
        "2_a.csv", "b_2.csv", "set_1.csv", "set_9.csv", "set_10.csv",
    ]  # fmt: skip


def test_data_sets_have_numbers_a_split_a_truth_and_further_records(data):
    assert [data.number(log.name) for log in data.logs] == [1, 2, 3, 4]
    assert data.label("data_set_03.csv") == "No. 3"
    assert data.labels(data.tests) == "4"
    assert [log.name for log in data.split.train] == [f"data_set_0{k}.csv" for k in (1, 2, 3)]
    further = [log.name for log in data.further]
    assert further == [f"take_off_approach/data_set_0{k}.csv" for k in (1, 2)]
    assert [log.name for log in data.further_tests] == further[1:]
    assert further[0] in {log.name for log in data.whole_split.train}
    assert data.inputs == ("TRA_deg", "dT_C", "ALT_ft", "Mach")
    assert data.speeds == ("N1_pct", "N2_pct")


def test_truth_is_what_the_engine_did_without_noise(data):
    log = data.raw[0]
    error = log["N1_pct"] - truth_of(data, log, "N1_pct")
    # Second differences take out what is slow; of white noise they leave sqrt(6) times its own.
    spread = 1.4826 * np.median(np.abs(np.diff(error, 2))) / np.sqrt(6.0)
    assert spread == pytest.approx(0.04, rel=0.15)  # that of the sensor
    assert truth_of(data, log, "WOW") is None


def test_missing_numbers_are_made_up_for_from_the_end(data):
    assert [data.number(log.name) for log in numbered(data, (2, 4))] == [2, 4]
    assert [data.number(log.name) for log in numbered(data, (2, 9, 10))] == [2, 3, 4]


def test_too_few_data_sets_are_refused(tmp_path, flights, make_config):
    shutil.copy(flights / "data_set_01.csv", tmp_path)
    with pytest.raises(DataError, match=r"at least 3 data sets, found 1.*One log of one engine"):
        read_data_sets(make_config(tmp_path), Path())


def test_a_split_without_tests_is_refused(flights, make_config):
    config = make_config(flights, split={"train": ["*"]})
    with pytest.raises(DataError, match=r"no data set is held out.*\[split\] test; logs are data"):
        read_data_sets(config, Path())


def test_outputs_without_a_speed_are_refused(flights, make_config):
    narx = {"outputs": ["EGT_C"], "schedule": []}
    steady = {"kind": "fitted", "inputs": ["TRA_deg", "ALT_ft", "Mach", "dT_C"]}
    events = {"response": ["EGT_C"]}
    config = make_config(flights, narx=narx, steady_state=steady, events=events)
    with pytest.raises(DataError, match="about N1 and N2, and the outputs are EGT_C"):
        read_data_sets(config, Path())


def test_a_truth_of_another_flight_is_refused(tmp_path, flights, make_config):
    shutil.copytree(flights, tmp_path, dirs_exist_ok=True)
    path = tmp_path / "truth" / "data_set_02.csv"
    pd.read_csv(path).iloc[:-40].to_csv(path, index=False)
    with pytest.raises(DataError, match="the truth has 1160 samples from 0 s, its log 1200 from 0"):
        read_data_sets(make_config(tmp_path), Path())
