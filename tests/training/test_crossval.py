"""Divisions hold every event once, on one side only, and come out the same every time."""

import itertools
import re

import numpy as np
import pytest

from data_prep.events import EventsConfig, find_events
from data_prep.log import Log, Source
from narxcal.support.errors import DataError
from training.folds import (
    CrossvalConfig,
    cut_segments,
    leave_one_flight_out,
    random_splits,
)

EVENTS = EventsConfig(condition="", response=("N1_pct",))
DT_S = 0.1


def log_of(file, engine, seed=0, samples=3000):
    """Slams every 15 s, N1 a first-order lag behind."""
    time_s = DT_S * np.arange(samples)
    levels = np.random.default_rng(seed).uniform(10.0, 80.0, samples // 150 + 1)
    levels[1::2] = levels[0::2][: len(levels[1::2])] + 10.0
    lever = levels[(time_s // 15.0).astype(int)]
    n1 = np.empty(samples)
    n1[0] = 20.0 + lever[0]
    for k in range(1, samples):
        n1[k] = n1[k - 1] + 0.1 * (20.0 + lever[k] - n1[k - 1])
    source = Source(f"/flights/{file}", "sha-" + file, engine)
    return Log(f"{file}:{engine}", time_s, {"TRA_deg": lever, "N1_pct": n1}, source=source)


def logs():
    return [
        log_of(file, engine, seed)
        for seed, (file, engine) in enumerate(
            [("a.csv", "left"), ("a.csv", "right"), ("b.csv", "left"), ("b.csv", "right")]
        )
    ]


def test_both_engines_of_a_flight_stay_together():
    plans = leave_one_flight_out(logs(), EVENTS)
    assert [plan.name for plan in plans] == ["without a.csv", "without b.csv"]
    for plan, held_back in zip(plans, ("a.csv", "b.csv"), strict=True):
        assert [part.log.name for part in plan.test] == [f"{held_back}:left", f"{held_back}:right"]
        assert all(held_back not in part.log.name for part in plan.train)
        assert len(plan.train) == 2


def test_one_flight_cannot_be_left_out():
    expected = (
        "/flights/a.csv: leaving one flight out takes two flights or more, found 1. "
        "Add flights to [logs] files, or set leave_one_flight_out = false"
    )
    with pytest.raises(DataError, match=f"^{re.escape(expected)}$"):
        leave_one_flight_out(logs()[:2], EVENTS)


def test_segments_hold_every_row_once_and_one_event_each():
    log = logs()[0]
    segments = cut_segments(log, EVENTS, 3.0)
    assert len(segments) == len(find_events(log, EVENTS)) > 10
    assert segments[0].start == 0
    assert segments[-1].stop == len(log)
    for one, following in itertools.pairwise(segments):
        assert one.stop == following.start
    for part in segments:
        (event,) = part.own_events
        assert 0 <= event.start < event.stop <= len(part.log)
        assert part.log.time_s[event.start] == pytest.approx(event.start_s)


def test_a_segment_begins_before_its_lever_moves():
    segments = cut_segments(logs()[0], EVENTS, 3.0)
    leads = [part.own_events[0].start * DT_S for part in segments[1:]]
    assert min(leads) > 0.0
    assert np.median(leads) == pytest.approx(3.0)


def test_a_log_without_events_has_no_segments():
    log = logs()[0]
    still = log.with_channels({"TRA_deg": np.full(len(log), 30.0)})
    assert cut_segments(still, EVENTS, 3.0) == []


def test_no_row_is_on_both_sides_and_none_is_lost():
    given = logs()
    for plan in random_splits(given, EVENTS, CrossvalConfig(random_splits=3)):
        for log in given:
            used = np.zeros(len(log), dtype=int)
            for part in (*plan.train, *plan.test):
                if part.whole is log:
                    used[part.start : part.stop] += 1
            assert np.array_equal(used, np.ones(len(log), dtype=int))


def test_seven_of_ten_events_are_trained_on():
    for plan in random_splits(logs(), EVENTS, CrossvalConfig()):
        trained = sum(len(part.events) for part in plan.train)
        tested = sum(len(part.events) for part in plan.test)
        assert trained == round(0.7 * (trained + tested))
        assert all(len(part.events) == 1 for part in plan.test)


def test_the_same_seed_divides_alike_and_the_next_one_differently():
    first, again, other = (
        [[part.log.name for part in plan.test] for plan in random_splits(logs(), EVENTS, config)]
        for config in (CrossvalConfig(seed=4), CrossvalConfig(seed=4), CrossvalConfig(seed=5))
    )
    assert first == again
    assert first[1:] == other[:-1]  # split i of seed s is split i - 1 of seed s + 1
    assert first[0] != other[0]


def test_neighbouring_training_segments_are_one_log():
    (plan,) = random_splits(logs(), EVENTS, CrossvalConfig(random_splits=1))
    for one, following in zip(plan.train, plan.train[1:], strict=False):
        assert one.whole is not following.whole or one.stop < following.start


def test_too_few_events_to_divide_are_refused():
    log = logs()[0].part(0, 290)
    expected = (
        "expected at least two events to divide, found 1. Check [events], or set random_splits = 0"
    )
    with pytest.raises(DataError, match=f"^{re.escape(expected)}$"):
        random_splits([log], EVENTS, CrossvalConfig())
