"""Studies of the flights alone: correlation, smoothing, segments, against slow computations."""

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pandas as pd
import pytest

from data_prep.events import find_events
from eval.reproduce.data import cut, pieces, truth_of
from eval.reproduce.recordings import best_window, correlation, errors, leading, segments, smoothing


def test_coefficients_are_those_of_the_textbook(data):
    study = correlation(data)
    for name, rows in study.results["pearson"].items():
        for row, log in zip(rows, data.logs, strict=True):
            for source in data.inputs:
                expected = np.corrcoef(log[source], log[name])[0, 1]
                assert row[source] == pytest.approx(expected, abs=1e-12)
    assert [claim.unit for claim in study.claims] == ["%", "%"]


def test_the_lever_leads_where_it_is_strong_and_nothing_is_stronger():
    table = pd.DataFrame(
        {"TRA_deg": [0.9, 0.79, 0.85, -0.95], "Mach": [0.5, 0.1, -0.9, math.nan]},
        index=list("abcd"),
    )
    assert leading(table, "TRA_deg").tolist() == [True, False, False, True]


def test_a_lever_that_is_beaten_is_not_glossed_over(data):
    swapped = [
        replace(one, log=one.log.with_channels({"TRA_deg": one.log["Mach"]}))
        for one in data.prepared
    ]
    study = correlation(replace(data, prepared=tuple(swapped)))
    assert all(claim.met is False for claim in study.claims)
    assert all("elsewhere its rho is" in claim.remark for claim in study.claims)


def test_window_errors_are_those_of_a_loop_over_samples(data):
    for window in (3, 11):
        error, _ = errors(data, "N1_pct", window)
        log, half = data.raw[0], window // 2
        truth = truth_of(data, log, "N1_pct")
        for row in range(half, len(log) - half, 97):
            mean = sum(log["N1_pct"][row - half : row + half + 1]) / window
            assert error[row] == pytest.approx(mean - truth[row], abs=1e-9)


def test_smoothing_is_judged_against_the_truth(data):
    study = smoothing(data)
    assert study.results["against_truth"]
    rows = study.results["windows"]
    for row in rows:
        error, _ = errors(data, row["channel"], row["window"])
        assert row["rms"] == pytest.approx(math.sqrt(np.mean(error**2)))
    own = [row for row in rows if row["channel"] == "N1_pct" and row["window"] > 1]
    assert best_window(rows, "N1_pct") == min(own, key=lambda row: row["rms"])["window"]
    assert {claim.met for claim in study.claims} <= {True, False}


def test_without_truth_nothing_is_claimed(data):
    study = smoothing(replace(data, truth={}))
    assert study.claims == []
    assert not study.results["against_truth"]
    assert "not known" in study.text
    rms = [row["rms"] for row in study.results["windows"] if row["channel"] == "N1_pct"]
    assert rms == sorted(rms)


def test_every_event_is_counted_and_drawn(data):
    study = segments(data)
    found = [find_events(log, data.config.events) for log in data.logs]
    assert study.results["pushes"] == sum(event.label == 0 for each in found for event in each)
    assert [len(sheet.events) for sheet in study.sheets] == [len(each) for each in found]
    assert [row["found"] for row in study.results["data_sets"]] == [len(each) for each in found]
    assert len(study.pictures) == 2
    sets, pushes = study.claims
    assert (sets.value, sets.met) == (4.0, False)
    assert pushes.met is False
    roles = [row[1].text for row in study.tables[0].rows]
    assert roles == ["train", "train", "train", "test", ""]


def test_pieces_hold_one_event_each_and_never_overlap(data):
    for log in data.logs:
        found = pieces(log, data.config.events)
        assert len(found) == len(find_events(log, data.config.events.model_copy(
            update={"condition": ""})))  # fmt: skip
        ends = [part.log.name.partition("[")[2].rstrip("]").split(":") for part in found]
        rows = [(int(start), int(stop)) for start, stop in ends]
        assert all(before[1] <= after[0] for before, after in pairwise(rows))
        for part, (start, stop) in zip(found, rows, strict=True):
            (event,) = part.own_events
            assert np.array_equal(part.log["N1_pct"], log["N1_pct"][start:stop])
            assert part.log.time_s[event.start] == event.start_s
            assert event.stop == len(part.log)
            assert event.start * log.dt_s <= 3.0 + 1e-9


def test_a_log_in_which_nothing_moves_stays_whole(data):
    log = data.logs[0]
    still = replace(log, channels={**log.channels, "TRA_deg": np.full(len(log), 40.0)})
    assert cut([still], data.config.events) == (still,)


def test_only_training_logs_are_cut(data):
    found = data.training
    assert found.test == data.split.test
    assert len(found.train) > len(data.split.train)
