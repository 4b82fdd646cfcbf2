"""The flights' benchmark: what it shows outside the windows of unlogged loads."""

from types import SimpleNamespace

import numpy as np
import pytest

from eval.benchmarks.flights import Campaign, _outside, _windows
from training.responses.rules import TimeCheck, Verdict

WINDOWS = ((10.0, 20.0),)
CAMPAIGN = Campaign("two", "two.toml", {"N1_pct": 1.0}, {}, unlogged={"second": WINDOWS})


def log(name, error):
    """100 s at 1 Hz; in the window the model is off by 9 more, the last ten rows do not count."""
    time_s = np.arange(100.0)
    wrong = np.full((100, 1), error)
    wrong[10:21] += 9.0
    wrong[90:] = 99.0
    scored = time_s < 90.0
    measured = np.full((100, 1), 50.0)
    measured[50] = np.nan
    run = SimpleNamespace(
        channels=("N1_pct",), model=50.0 + wrong, measured=measured, scored=scored
    )
    check = TimeCheck(1.0, 1.1, 0.1, 0.25, 0.1, ok=True)
    events = [
        SimpleNamespace(start_s=start, verdict=Verdict("paper", ok=ok, Ti=check, Tt=check))
        for start, ok in ((5.0, True), (15.0, False), (20.0, False), (40.0, True), (60.0, False))
    ]
    source = SimpleNamespace(file=f"folder/{name}.csv")
    return SimpleNamespace(
        run=run, assessments=events, log=SimpleNamespace(time_s=time_s, source=source)
    )


def test_rows_and_events_within_the_windows_do_not_count():
    rules = SimpleNamespace(transients=SimpleNamespace(rules="paper"))
    found = SimpleNamespace(logs=[log("second", 3.0), log("second", 4.0)], config=rules)
    rows = list(_outside(CAMPAIGN, ("two", found), WINDOWS, {"N1_pct": 1.0}))
    assert rows[0].group == "two, outside unlogged loads"
    assert rows[0].value == pytest.approx(100.0 * 4 / 6)
    assert rows[0].note == "4 of 6 assessed; rules paper"
    assert rows[1].value == pytest.approx(np.sqrt(12.5))


@pytest.mark.parametrize(("names", "windows"), [(["second"], WINDOWS), (["first", "second"], ())])
def test_windows_belong_to_one_flight(names, windows):
    assert _windows(CAMPAIGN, [log(name, 0.0).log for name in names]) == windows
