"""The validator on a flight that nobody here wrote."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from data_prep.cleaning.smooth import SmoothConfig, smooth
from data_prep.events import EventsConfig, find_events
from data_prep.reading import read_logs
from training.responses.transients import Overlay, TransientsConfig, assess_events, tally

FLIGHT = Path(__file__).parents[2] / "../shared/data/agtf30/flight_1.csv.gz"
CHANNELS = ("N1_pct", "N2_pct", "EGT_C")
CONFIG = TransientsConfig(channels=CHANNELS)


@pytest.fixture(scope="module")
def flight():
    if not FLIGHT.exists():
        pytest.skip("the AGTF30 flights are not in ../shared/data")
    (log,) = read_logs(FLIGHT)
    log = smooth(log, SmoothConfig())
    return log, find_events(log, EventsConfig(condition=""))


def assess(flight, delay=0):
    """Assess the flight against itself, `delay` samples late."""
    log, events = flight
    y = log.matrix(CHANNELS)
    late = np.concatenate((np.repeat(y[:1], delay, axis=0), y[: len(y) - delay]))
    return assess_events(events, Overlay(log.time_s, y, late, CHANNELS), CONFIG)


def test_a_flight_passes_against_itself_and_most_settled_moves_are_assessed(flight):
    result = assess(flight)
    count = tally(result)
    assert count.passed == count.assessed
    settled = sum(event.settled and event.speed != "small" for event in flight[1])
    assert count.assessed >= 0.8 * settled * len(CHANNELS)
    assert {one.label for one in result if one.verdict.ok} == {0, 1}


def test_a_flight_a_third_of_a_second_late_fails_Ti_and_only_Ti(flight):  # noqa: N802
    delay = 11
    judged = [one for one in assess(flight, delay) if one.verdict.ok is not None]
    assert all(one.verdict.Tt.ok for one in judged)
    for one in judged:
        assert one.verdict.Ti.error_s == pytest.approx(delay / 32, abs=0.1)
        assert one.verdict.Ti.ok is (one.verdict.Ti.error_s <= one.verdict.Ti.allowed_s)
    assert sum(not one.verdict.Ti.ok for one in judged) > 0.8 * len(judged)
