"""A recorder that stops for a moment gives one log: one free run, one set of figures."""

from dataclasses import replace

import numpy as np
import pytest

from data_prep.sources.grid import joined


def fragments(log, every_s=20.0, gap_s=4.0, late_s=0.0):
    """Parts of a log between gaps, as reading leaves them; each clock is `late_s` off the grid."""
    parts, start = [], 0
    step = round(every_s / log.dt_s)
    lost = round(gap_s / log.dt_s)
    while start < len(log):
        part = log.part(start, min(start + step - lost, len(log)))
        number = f"#{len(parts) + 1}" if parts else ""
        shift = late_s * (len(parts) % 2)
        parts.append(replace(part, name=f"{log.name}{number}", time_s=part.time_s + shift))
        start += step
    return parts


def test_parts_are_one_log_again_with_its_gaps_counted(flight):
    log = flight(1)
    parts = fragments(log)
    (whole,) = joined(parts)
    known = np.isfinite(whole["N1_pct"])
    assert whole.name == log.name
    assert known.sum() == sum(map(len, parts))
    np.testing.assert_array_equal(whole["N1_pct"][known], log["N1_pct"][: len(whole)][known])
    assert whole.audit.masked()["N1_pct"]["gap in the recording"] == int((~known).sum())


def test_a_part_off_the_grid_is_laid_on_it(flight):
    log = flight(1)
    slow = log.with_channels({"ALT_ft": 10.0 * log.time_s})
    (whole,) = joined(fragments(slow, late_s=0.04))
    known = np.isfinite(whole["ALT_ft"])
    # A clock that is 0.04 s late says what was measured 0.04 s before.
    late = 10.0 * (whole.time_s - whole["ALT_ft"] / 10.0)[known]
    assert set(np.round(late, 6)) <= {0.0, 0.4}


def test_a_recorder_that_was_off_for_long_wrote_several_recordings(flight):
    log = flight(1)
    first, second = log.part(0, 400), log.part(400, 800)
    later = replace(second, name=f"{log.name}#2", time_s=second.time_s + 3600.0)
    assert joined([first, later]) == [first, later]


@pytest.mark.parametrize("engine", ["left", "right"])
def test_engines_and_files_stay_apart(flight, engine):
    logs = [flight(1), flight(2)]
    other = replace(logs[0], source=replace(logs[0].source, engine=engine))
    assert joined([*logs, other]) == [*logs, other]
