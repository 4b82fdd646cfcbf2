"""Steady parts of a log, against a slow twin, and the parts in which the engine runs."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from data_prep.equilibrium import QuasiSteadyConfig, RunningConfig, quasi_steady, while_running
from data_prep.log import Log
from data_prep.prepare import Preparation, prepare
from narxcal.support.errors import ConfigError

DT_S = 0.5


def log(lever, n1):
    time_s = DT_S * np.arange(len(lever))
    channels = {"TRA_deg": np.array(lever, dtype=float), "N1_pct": np.array(n1, dtype=float)}
    return Log("flight", time_s, channels)


def still(given_, **config):
    return quasi_steady(given_, "TRA_deg", ("N1_pct",), QuasiSteadyConfig(**config))


def test_a_slam_is_not_steady_and_what_is_far_from_it_is():
    lever = np.r_[np.full(40, 10.0), np.full(40, 70.0)]
    found = still(log(lever, lever), window_s=6.0)
    # The window reaches 6 samples to either side of the slam between samples 39 and 40.
    assert np.flatnonzero(~found).tolist() == list(range(34, 46))


def test_a_window_longer_than_the_log_is_as_long_as_the_log():
    lever = np.r_[np.full(40, 10.0), np.full(40, 70.0)]
    assert not still(log(lever, lever), window_s=1e12).any()
    assert still(log(np.full(80, 10.0), np.full(80, 70.0)), window_s=1e12).all()


def test_a_speed_that_still_moves_is_not_steady():
    lever = np.r_[np.full(20, 10.0), np.full(80, 70.0)]
    n1 = 70.0 - 50.0 * np.exp(-np.maximum(np.arange(100) - 20, 0) / 8.0)
    found = still(log(lever, n1), window_s=2.0, speed_pct=1.0)
    settled = np.flatnonzero(found & (np.arange(100) > 22))
    assert settled[0] > 35
    assert found[-10:].all()


def test_nothing_is_steady_beside_an_unknown_sample():
    n1 = np.full(50, 40.0)
    n1[20] = np.nan
    found = still(log(np.linspace(10.0, 10.01, 50) * 0 + 10.0, n1), window_s=2.0)
    assert np.flatnonzero(~found).tolist() == [18, 19, 20, 21, 22]


def test_a_log_without_its_driver_is_never_steady():
    assert not still(log(np.full(30, np.nan), np.full(30, 40.0))).any()


@given(
    seed=st.integers(0, 999),
    window_s=st.sampled_from([1.0, 3.0, 6.0]),
    speed_pct=st.sampled_from([0.5, 2.0, 8.0]),
)
def test_it_is_what_a_loop_over_windows_finds(seed, window_s, speed_pct):
    rng = np.random.default_rng(seed)
    n1 = np.cumsum(rng.normal(size=60))
    n1[rng.integers(0, 60)] = np.nan
    lever = np.repeat(rng.uniform(0.0, 80.0, 4), 15)
    found = still(log(lever, n1), window_s=window_s, speed_pct=speed_pct)
    half = round(0.5 * window_s / DT_S)
    low, high = np.percentile(lever, [1, 99])
    for k in range(60):
        part = slice(max(k - half, 0), k + half + 1)
        expected = (
            np.isfinite(n1[part]).all()
            and np.ptp(n1[part]) <= speed_pct
            and np.ptp(lever[part]) <= 0.03 * (high - low)
        )
        assert found[k] == expected


@pytest.mark.parametrize("key", ["window_s", "speed_pct", "driver_fraction"])
def test_bounds_have_to_be_positive(key):
    with pytest.raises(ValueError, match="greater than 0"):
        QuasiSteadyConfig(**{key: 0.0})


HZ = 4


def speeds(*stretches):
    """N2 that stays at each value for so many seconds."""
    return np.concatenate(
        [np.full(round(HZ * length), float(value)) for value, length in stretches]
    )


def n2_log(n2, **channels):
    every = {"N2_pct": n2, **channels}
    return Log("flight.csv", np.arange(len(n2)) / HZ, every)


def test_start_and_shutdown_go_with_their_margins_and_are_counted():
    [kept] = while_running([n2_log(speeds((0, 60), (70, 200), (0, 60)))], RunningConfig())
    assert (kept.time_s[0], kept.time_s[-1]) == (80.0, 239.75)
    assert kept.name == "flight.csv"
    [entry] = kept.audit.entries
    assert (entry.action, entry.reason) == ("dropped", "engine not running")
    assert entry.samples == HZ * 160


def test_an_engine_that_is_stopped_and_started_again_makes_two_logs():
    parts = while_running([n2_log(speeds((70, 100), (0, 50), (70, 100)))], RunningConfig())
    assert [part.name for part in parts] == ["flight.csv", "flight.csv#2"]
    assert [len(part) for part in parts] == [HZ * 80, HZ * 80]
    assert sum(entry.samples for part in parts for entry in part.audit.entries) == HZ * 90


def test_numbers_go_on_after_a_split_at_a_gap():
    first = n2_log(speeds((70, 100), (0, 50), (70, 100)))
    second = Log("flight.csv#2", first.time_s + 1000, first.channels)
    names = [part.name for part in while_running([first, second], RunningConfig())]
    assert names == ["flight.csv", "flight.csv#2", "flight.csv#3", "flight.csv#4"]


@pytest.mark.parametrize(
    "whole",
    [
        n2_log(speeds((70, 300))),
        n2_log(speeds((70, 100), (0, 4), (70, 100))),  # shorter than an engine can stop and start
        n2_log(speeds((0, 300))),  # never runs: another unit, or another question
        n2_log(speeds((70, 100), (np.nan, 60), (70, 100))),  # no reading says nothing
        n2_log(speeds((70, 100), (0, 60), (70, 100)), N1_pct=np.full(260 * HZ, 50.0)),  # a sensor
        Log("other.csv", np.arange(50.0), {"EGT_C": np.zeros(50)}),
    ],
)
def test_all_else_stays_as_it_is(whole):
    [kept] = while_running([whole], RunningConfig())
    assert kept is whole or kept.channels == whole.channels
    assert kept.audit.entries == ()


def test_nothing_above_keeps_everything():
    whole = n2_log(speeds((0, 60), (70, 200)))
    [kept] = while_running([whole], RunningConfig.parse({"above": {}}))
    assert len(kept) == len(whole)


def test_an_unknown_channel_is_refused():
    with pytest.raises(ConfigError, match="unknown channel 'N3_pct'"):
        Preparation.parse({"running": {"above": {"N3_pct": 40.0}}})


def test_preparation_cuts_before_it_cleans():
    noise = np.random.default_rng(0).normal(0.0, 0.01, HZ * 260)
    kept = prepare([n2_log(speeds((0, 60), (70, 200)) + noise)])[0].log
    assert kept.time_s[0] == 80.0
    assert kept["N2_pct"].min() > 69.0


def test_an_engine_that_windmills_does_not_run():
    running = np.r_[np.full(200, 1.0), np.zeros(200), np.full(200, 1.0)]
    channels = {
        "N1_pct": 14.0 + 50.0 * running,
        "N2_pct": 20.0 + 60.0 * running,
        "FF_kgph": 300.0 * running,
    }
    parts = while_running([Log("flight", DT_S * np.arange(600), channels)], RunningConfig())
    assert [part.name for part in parts] == ["flight", "flight#2"]
    assert all(part["N2_pct"].min() > 40.0 for part in parts)


def test_a_meter_that_fails_does_not_stop_an_engine():
    channels = {
        "N1_pct": np.full(300, 60.0),
        "N2_pct": np.full(300, 80.0),
        "FF_kgph": np.r_[np.full(100, 300.0), np.zeros(200)],
    }
    [kept] = while_running([Log("flight", DT_S * np.arange(300), channels)], RunningConfig())
    assert len(kept) == 300
