"""Preparation on logs that nobody here wrote: real flights and third-party simulations."""

from __future__ import annotations

import time
import tomllib
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from data_prep.clean import CleanConfig, clean
from data_prep.events import EventsConfig, find_events
from data_prep.log import Log
from data_prep.prepare import Preparation, prepare
from data_prep.reading import LogsConfig, read_logs
from data_prep.smooth import SmoothConfig, smooth
from narxcal.support.arrays import runs

ROOT = Path(__file__).parents[2]
DATA = ROOT.parent / "shared" / "data"


def table(name):
    return tomllib.loads((ROOT / "configs" / f"{name}.toml").read_text("utf-8"))


@cache
def recorded(name):
    """All logs that the shipped configuration `name` maps, raw."""
    path = ROOT / "configs" / f"{name}.toml"
    config = LogsConfig.parse(table(name)["logs"])
    if not DATA.is_dir():
        pytest.skip(f"the recorded flights are not at {DATA}")
    return read_logs(config.resolve(path.parent), config)


@cache
def cleaned(name, number):
    """One of those logs, cleaned as it is."""
    return clean(recorded(name)[number])


@cache
def gap_logs(kind):
    files = sorted((DATA / "gap_example").glob(f"case_*/{kind}*/*.csv.gz"))
    if not files:
        pytest.skip(f"the gap cases are not at {DATA}")
    return read_logs(files)


def prepared(name):
    tables = table(name)
    sections = Preparation(
        clean=CleanConfig.parse(tables.get("clean", {})),
        smooth=SmoothConfig.parse(tables["smooth"]),
    )
    logs = [one.log for one in prepare(recorded(name), sections)]
    return logs, EventsConfig.parse(tables["events"])


def test_prepare_cleans_then_smooths():
    values = 75 + np.random.default_rng(0).normal(0, 0.05, 3200)
    values[1000] = 95.0
    log = Log("f", np.arange(3200) / 32, {"N1_pct": values})
    done = prepare([log])[0].log
    expected = smooth(clean(log))
    np.testing.assert_array_equal(done["N1_pct"], expected["N1_pct"])
    assert done.audit == expected.audit
    assert abs(done["N1_pct"][1000] - 75) < 0.1


@pytest.mark.parametrize("name", ["citation2", "agtf30", "jetcat"])
def test_no_good_recording_is_masked_and_few_samples_are_repaired(name):
    for log in recorded(name):
        entries = clean(log).audit.entries[len(log.audit.entries) :]
        assert [entry for entry in entries if entry.action == "masked"] == []
        for entry in entries:
            assert entry.samples < 0.004 * len(log), (log.name, entry)


@pytest.mark.parametrize("kind", ["sim", "real"])
def test_no_gap_case_is_masked_nor_a_noise_free_output_touched(kind):
    for log in gap_logs(kind):
        entries = clean(log).audit.entries[len(log.audit.entries) :]
        assert [entry for entry in entries if entry.action == "masked"] == []
        if kind == "sim":
            assert {entry.channel for entry in entries} <= {"ALT_ft", "Mach", "dT_C"}


def fault(values, kind, rows, rng):
    """Put one kind of sensor fault into `rows`; returns the channel and the rows it hit."""
    broken = values.copy()
    if kind == "frozen":
        broken[rows] = broken[rows[0]]
    elif kind == "spiking":
        rows = rows[rng.random(len(rows)) < 0.3]
        size = 0.5 * np.ptp(np.percentile(values, (1, 99)))
        broken[rows] += size * rng.uniform(0.5, 1.5, len(rows)) * rng.choice([-1, 1], len(rows))
    else:
        broken[rows] = float(kind)
    return broken, rows


@pytest.mark.parametrize("name", ["citation2", "agtf30"])
@pytest.mark.parametrize(
    ("channel", "kind", "seconds"),
    [
        ("N2_pct", "frozen", 40),
        ("EGT_C", "spiking", 20),
        ("FF_kgph", "0", 30),
        ("FF_kgph", "9999", 30),
        ("N1_pct", "0", 3),
    ],
)
def test_injected_faults_are_found_and_only_they(name, channel, kind, seconds):
    rng = np.random.default_rng(7)
    for number in (-2, -1):
        log, base = recorded(name)[number], cleaned(name, number)
        values, hits = log[channel], []
        near = np.zeros(len(log), dtype=np.bool_)
        for part in (0.04, 0.3, 0.72):
            first = round(part * len(log))
            rows = np.arange(first, first + round(seconds / log.dt_s))
            values, hit = fault(values, kind, rows, rng)
            hits.append(hit)
            near[first - 1 : rows[-1] + 2] = True
        done = clean(log.with_channels({channel: values}))
        lost = np.isnan(done[channel])
        touched = lost | (done[channel] != values)
        assert all(touched[hit].mean() > 0.95 for hit in hits)
        assert not lost[~near].any()
        for other in log.channels:
            if other != channel:
                np.testing.assert_array_equal(done[other], base[other])


def test_every_lever_move_of_the_simulated_flights_is_an_event_with_its_exact_start():
    logs, config = prepared("agtf30")
    for log in logs:
        moving = np.flatnonzero(np.diff(log["TRA_deg"]) != 0)
        first = np.concatenate(([True], np.diff(moving) > 16))
        assert [event.start for event in find_events(log, config)] == moving[first].tolist()


def rapid_changes(speed, dt_s, sign):
    """The independent criterion: N1 by more than 15 % within 8 s, as spans of samples."""
    window = round(8.0 / dt_s)
    starts, stops = runs(sign * (speed[window:] - speed[:-window]) > 15.0)
    spans = []
    for start, stop in zip(starts.tolist(), stops.tolist(), strict=True):
        if spans and start - spans[-1][1] < 2.0 / dt_s:
            spans[-1][1] = stop
        else:
            spans.append([start, stop])
    return [(start - round(1.0 / dt_s), stop + window) for start, stop in spans]


def test_every_rapid_push_and_pull_of_the_citation_is_an_event():
    logs, config = prepared("citation2")
    everywhere = config.model_copy(update={"condition": ""})
    for log in logs:
        events = find_events(log, everywhere)
        for label, sign, fewest, most in ((0, 1, 9, 14), (1, -1, 5, 12)):
            spans = rapid_changes(log["N1_pct"], log.dt_s, sign)
            starts = [event.start for event in events if event.label == label]
            assert fewest <= len(spans) <= most
            for start, stop in spans:
                assert any(start <= at <= stop for at in starts), (log.name, label, start)


def test_citation_events_in_flight_hold_no_sample_on_the_ground():
    logs, config = prepared("citation2")
    for log in logs:
        events = find_events(log, config)
        assert len(events) > 10
        for event in events:
            assert (log["WOW"][event.start : event.stop] == 0).all()


def test_finding_the_events_of_an_80_minute_flight_is_no_loop_over_samples():
    logs, config = prepared("citation2")
    log = max(logs, key=len)
    best = float("inf")
    for _ in range(3):
        start = time.process_time()
        find_events(log, config)
        best = min(best, time.process_time() - start)
    assert best < 2.0  # it takes some 50 ms
