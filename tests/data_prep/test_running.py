"""Logs are cut to where the engine runs."""

import numpy as np
import pytest

from data_prep.equilibrium import RunningConfig, while_running
from data_prep.log import Log
from data_prep.prepare import prepare
from narxcal.support.errors import ConfigError

HZ = 4


def speeds(*stretches):
    """N2 that stands at each value for so many seconds."""
    return np.concatenate(
        [np.full(round(HZ * length), float(value)) for value, length in stretches]
    )


def log(n2, **channels):
    every = {"N2_pct": n2, **channels}
    return Log("flight.csv", np.arange(len(n2)) / HZ, every)


def test_start_and_shutdown_go_with_their_margins_and_are_counted():
    [kept] = while_running([log(speeds((0, 60), (70, 200), (0, 60)))], RunningConfig())
    assert (kept.time_s[0], kept.time_s[-1]) == (80.0, 239.75)
    assert kept.name == "flight.csv"
    [entry] = kept.audit.entries
    assert (entry.action, entry.reason) == ("dropped", "engine not running")
    assert entry.samples == HZ * 160


def test_an_engine_that_is_stopped_and_started_again_makes_two_logs():
    parts = while_running([log(speeds((70, 100), (0, 50), (70, 100)))], RunningConfig())
    assert [part.name for part in parts] == ["flight.csv", "flight.csv#2"]
    assert [len(part) for part in parts] == [HZ * 80, HZ * 80]
    assert sum(entry.samples for part in parts for entry in part.audit.entries) == HZ * 90


def test_numbers_go_on_after_a_split_at_a_gap():
    first = log(speeds((70, 100), (0, 50), (70, 100)))
    second = Log("flight.csv#2", first.time_s + 1000, first.channels)
    names = [part.name for part in while_running([first, second], RunningConfig())]
    assert names == ["flight.csv", "flight.csv#2", "flight.csv#3", "flight.csv#4"]


@pytest.mark.parametrize(
    "whole",
    [
        log(speeds((70, 300))),
        log(speeds((70, 100), (0, 4), (70, 100))),  # shorter than an engine can stop and start
        log(speeds((0, 300))),  # never runs: another unit, or another question
        log(speeds((70, 100), (np.nan, 60), (70, 100))),  # no reading says nothing
        log(speeds((70, 100), (0, 60), (70, 100)), N1_pct=np.full(260 * HZ, 50.0)),  # a sensor
        Log("other.csv", np.arange(50.0), {"EGT_C": np.zeros(50)}),
    ],
)
def test_all_else_stays_as_it_is(whole):
    [kept] = while_running([whole], RunningConfig())
    assert kept is whole or kept.channels == whole.channels
    assert kept.audit.entries == ()


def test_nothing_above_keeps_everything():
    whole = log(speeds((0, 60), (70, 200)))
    [kept] = while_running([whole], RunningConfig.parse({"above": {}}))
    assert len(kept) == len(whole)


def test_an_unknown_channel_is_refused():
    with pytest.raises(ConfigError, match="unknown channel 'N3_pct'"):
        RunningConfig.parse({"above": {"N3_pct": 40.0}})


def test_preparation_cuts_before_it_cleans():
    noise = np.random.default_rng(0).normal(0.0, 0.01, HZ * 260)
    kept = prepare([log(speeds((0, 60), (70, 200)) + noise)])[0].log
    assert kept.time_s[0] == 80.0
    assert kept["N2_pct"].min() > 69.0
