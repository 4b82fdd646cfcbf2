"""Phases by what a log says where the lever moves."""

import numpy as np
import pytest

from data_prep.events import Event
from data_prep.log import Log
from eval.reproduce.data import phase_of

DT_S = 0.5


def log_of(climb_ftpm=0.0, **switches):
    time_s = DT_S * np.arange(400)
    channels = {
        "TRA_deg": np.linspace(0.0, 80.0, 400),
        "ALT_ft": 20_000.0 + climb_ftpm / 60.0 * time_s,
        **{name: np.full(400, value) for name, value in switches.items()},
    }
    return Log("a.csv", time_s, channels)


def event(label=0, after=80.0):
    lever = {"lever_before": 40.0, "lever_after": after}
    ended = {"settled": True, "interrupted": False}
    return Event("a.csv", 200, 300, label, "fast", 100.0, **lever, **ended)


@pytest.mark.parametrize(
    ("log", "moved", "phase"),
    [
        (log_of(), event(), "cruise"),
        (log_of(499.0), event(), "cruise"),
        (log_of(1500.0), event(), "climb"),
        (log_of(-1500.0), event(1), "descent"),
        (log_of(-700.0, Approach=1.0), event(), "approach"),
        (log_of(0.0, WOW=1.0), event(0, 80.0), "take-off"),
        (log_of(0.0, WOW=1.0), event(0, 40.0), "ground"),
        (log_of(0.0, WOW=1.0), event(1, 80.0), "ground"),
        (log_of(0.0, WOW=0.0, Approach=0.0), event(), "cruise"),
        (log_of(0.0, WOW=np.nan), event(), "cruise"),
    ],
)
def test_a_phase_is_read_from_switches_and_climb_rate(log, moved, phase):
    assert phase_of(log, moved, "TRA_deg") == phase


def test_without_altitude_all_flight_is_cruise():
    log = log_of(2000.0)
    bare = Log("a.csv", log.time_s, {"TRA_deg": log["TRA_deg"]})
    assert phase_of(bare, event(), "TRA_deg") == "cruise"
    unknown = {"TRA_deg": log["TRA_deg"], "ALT_ft": np.full(400, np.nan)}
    assert phase_of(Log("a.csv", log.time_s, unknown), event(), "TRA_deg") == "cruise"
