"""A log is known by its samples: copies under other names, clocks and rates are no new logs."""

from dataclasses import replace

import numpy as np
import pytest

from data_prep.cleaning.identity import Identity, duplicates, refuse_duplicates
from data_prep.log import Source
from narxcal.support.errors import DataError, ModelError

KINDS = (
    "renamed", "cut", "resampled", "EGT x 1.2", "four digits", "masked", "recalibrated", "smoothed"
)  # fmt: skip


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_copy_is_recognised_by_its_samples(flight, copies, kind, seed):
    log = flight(seed)
    copy = copies[kind](log)
    found = log.identity.within(copy)
    assert found is not None
    assert found.share > 0.7


@pytest.mark.parametrize("kind", KINDS)
def test_a_whole_flight_holds_a_training_log_that_was_cut_out_of_it(flight, copies, kind):
    log = flight(4)
    assert copies[kind](log).identity.within(log) is not None


@pytest.mark.parametrize("stretch", [0.98, 1.005, 1.02])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_recalibrated_copy_with_another_clock_is_recognised(flight, copies, seed, stretch):
    log = flight(seed)
    copy = copies["recalibrated"](replace(log, time_s=stretch * log.time_s))
    assert log.identity.within(copy) is not None


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_log_of_which_half_is_a_copy_is_recognised_at_four_levels(flight, copies, seed):
    log, other = (flight(each, 500.0, 1.0, 120.0) for each in (seed, seed + 50))
    rows = log.time_s < 250.0
    half = {name: np.where(rows, log[name], other[name]) for name in log.channels}
    found = log.identity.within(copies["renamed"](other.with_channels(half)))
    assert found is not None
    assert 0.4 < found.share < 0.7
    assert log.identity.within(other) is None


def test_other_flights_and_the_same_levels_flown_again_with_a_drift_are_new(flight):
    logs = [flight(seed) for seed in range(5)]
    assert not duplicates(logs)
    again = flight(7, levels=1)
    warmer = again.with_channels({"EGT_C": again["EGT_C"] + 4.0, "N1_pct": 1.004 * again["N1_pct"]})
    assert logs[1].identity.within(warmer) is None
    assert flight(1, 3600.0).identity.within(flight(2, 3600.0)) is None


@pytest.mark.parametrize("noise", [1.0, 0.1, 0.0])
def test_a_programme_that_is_flown_again_is_new(flight, noise):
    """Also by a slower engine in other air, and by a simulation without noise."""
    log, again = (flight(seed, 600.0, levels=3, noise=noise) for seed in (3, 4))
    slower = replace(again, time_s=1.05 * again.time_s)
    air = {"ALT_ft": 0.9 * slower["ALT_ft"], "N1_pct": 0.99 * slower["N1_pct"]}
    assert not duplicates([log, slower.with_channels(air)])
    assert not noise or not duplicates([log, again])


def test_engines_of_one_flight_are_two_recordings(flight):
    left = flight(1)
    source = Source(left.source.file, left.source.sha256, "right")
    right = replace(flight(9, levels=1), name="flight_1.csv:right", source=source)
    assert not duplicates([left, right])


def test_an_identity_is_stored_and_read_back(flight, copies):
    log = flight(1)
    stored = Identity.from_json(log.identity.to_json())
    assert stored.within(copies["cut"](log)) is not None
    assert stored.within(flight(2)) is None


@pytest.mark.parametrize("damage", [{"moves": "!"}, {"moves": "AAAA"}, {"channels": None}])
def test_a_damaged_identity_is_refused(flight, damage):
    with pytest.raises(ModelError, match="the identity of a log cannot be read"):
        Identity.from_json({**flight(1).identity.to_json(), **damage})


def test_the_same_recording_on_both_sides_is_refused_by_name(flight, copies):
    log = flight(1)
    with pytest.raises(DataError) as error:
        refuse_duplicates([log, flight(2), copies["cut"](log)], "it would be judged on itself")
    start = "copy.csv holds the samples of flight_1.csv: 100 % of it, 1"
    end = "it would be judged on itself. Leave one of the two out of [logs] files, or of [split]"
    assert str(error.value).startswith(start)
    assert str(error.value).endswith(end)
