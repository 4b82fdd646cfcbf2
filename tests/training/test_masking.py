"""What is learned of logs with faults: what is masked, what is left out."""

from dataclasses import replace

import numpy as np
import pytest

from data_prep.log import Finding
from narxcal.support.errors import DataError
from tests.training.test_screening import DT_S, ROWS, flights
from training.config import RunConfig
from training.records import Split
from training.screening.masking import training_data

INPUTS = ("FF_kgph", "ALT_ft", "Mach", "dT_C")
OUTPUTS = ("N1_pct", "N2_pct", "EGT_C")
CONFIG = RunConfig.parse(
    {
        "schema": "narxcal.config/1",
        "events": {"driver": "FF_kgph", "condition": ""},
        "steady_state": {
            "inputs": list(INPUTS), "driver": "FF_kgph", "blend": ["Mach"], "switches": [],
        },
        "narx": {"outputs": list(OUTPUTS), "hidden": 2, "lag_limits": False},
        "train": {"horizons_s": [5.0], "iterations": [3], "threads": 1, "choice_s": 0.0},
        "smooth": {"window": 1},
    }
)  # fmt: skip


@pytest.fixture(scope="module")
def sound():
    return flights(1, 2, 3)


def test_an_input_that_is_lost_for_long_divides_the_log(sound):
    log = sound[0]
    fuel = log["FF_kgph"].copy()
    fuel[2000:2600] = np.nan
    fuel[4000:4005] = np.nan
    split = Split((log.with_channels({"FF_kgph": fuel}), *sound[1:]), (), ())
    found = training_data(split, CONFIG, screen=False)
    first, second, *others = found.split.train
    assert (len(first), len(second)) == (2000, ROWS - 2600)
    assert [len(each) for each in others] == [ROWS, ROWS]
    assert np.isfinite(second["FF_kgph"]).all()
    assert found.row()["logs"][0]["left_out_rows"] == 600


def test_a_part_too_short_for_a_response_is_left_out_and_counted(sound):
    short = sound[0].part(0, 2)
    found = training_data(Split((short, *sound[1:]), (), ()), CONFIG, screen=False)
    assert [len(each) for each in found.split.train] == [ROWS, ROWS]
    assert found.row()["logs"][0]["left_out_rows"] == 2


def finding(name, channel, start_s, end_s):
    return Finding("stuck", channel, start_s, end_s, 0.0, "", 0.999, "stays at 0", log=name)


def test_masked_samples_are_counted_by_log_and_channel(sound):
    found = finding("flight 1", "EGT_C", 100.0, 199.9)
    log = replace(sound[0], findings=(found,))
    row = training_data(Split((log, *sound[1:]), (), ()), CONFIG, screen=False).row()
    assert row["findings"] == [found.row()]
    assert [each["masked"] for each in row["logs"]] == [{"EGT_C": round(100.0 / DT_S)}, {}, {}]


def test_a_finding_of_the_whole_log_masks_nothing(sound):
    found = replace(finding("flight 1", "EGT_C", None, None), kind="unit")
    log = replace(sound[0], findings=(found,))
    learned = training_data(Split((log, *sound[1:]), (), ()), CONFIG, screen=False)
    assert learned.row()["findings"] == [found.row()]
    assert all(each["masked"] == {} for each in learned.row()["logs"])


def test_a_log_whose_input_is_at_fault_throughout_is_left_out(sound):
    bad = replace(sound[0], findings=(finding("flight 1", "FF_kgph", 0.0, 1e9),))
    found = training_data(Split((bad, *sound[1:]), (), ()), CONFIG)
    assert [log.name for log in found.split.train] == ["flight 2", "flight 3"]
    assert found.row()["logs"][0]["left_out_rows"] == ROWS


def test_logs_that_are_all_at_fault_are_refused_with_the_first_reason(sound):
    bad = [replace(log, findings=(finding(log.name, "Mach", 0.0, 1e9),)) for log in sound[:2]]
    with pytest.raises(DataError) as caught:
        training_data(Split(tuple(bad), (), ()), CONFIG)
    assert str(caught.value) == (
        "flight 1: no training log has a stretch with all inputs and an output. Masked is flight "
        "1: Mach stuck, t+0:00.0 to t+277777:46:40.0: stays at 0"
    )
