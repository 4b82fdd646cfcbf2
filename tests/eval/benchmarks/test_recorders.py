"""The bench of recorders: its divisions, its figures, and what counts as a false finding."""

import math
from dataclasses import replace

import numpy as np
import pytest

from data_prep.log import Finding, Log, Source
from eval.benchmarks import recorders
from eval.benchmarks.flights import Passes
from eval.benchmarks.recorders import Figure, Measured, Recorder, Screened
from training.config import RunConfig


def log(name, engine="", n=600):
    time_s = 0.1 * np.arange(n)
    channels = {"N1_pct": 50.0 + np.sin(time_s), "FF_kgph": 100.0 + 5.0 * np.sin(time_s)}
    return Log(f"{name}:{engine}", time_s, channels, source=Source(name, name, engine))


def recorder():
    recordings = {name: [log(name, side) for side in ("left", "right")] for name in "abc"}
    return Recorder("some", RunConfig(), recordings)


def test_each_recording_is_a_side_of_its_own_with_both_engines():
    found = list(recorder().divisions())
    assert [name for name, _, _ in found] == ["a", "b", "c"]
    for name, train, judged in found:
        assert {one.source.file for one in train} == {name}
        assert {one.source.file for one in judged} == {*"abc"} - {name}
        assert len(train) == 2
        assert len(judged) == 4


def test_the_halves_of_one_flight_are_two_recordings():
    halves = list(recorders._halves(log("flight.csv", "engine1")))
    assert [one.source.file for one in halves] == ["first half", "second half"]
    assert halves[0].source.sha256 != halves[1].source.sha256
    np.testing.assert_array_equal(
        np.concatenate([one["N1_pct"] for one in halves]), log("flight.csv")["N1_pct"]
    )


def test_a_figure_is_compared_with_the_best_baseline():
    one = Figure("N1_pct", 1.0, {"steady": 2.0, "arx": 0.8, "output error": math.nan})
    assert one.best == 0.8
    assert one.ratio == pytest.approx(1.25)
    assert math.isnan(Figure("N1_pct", math.nan).ratio)


def summary(figures=(), passes=(), seen=()):
    return {row.name: row for row in recorders._summary("some", Measured(figures, passes, seen))}


def test_lost_figures_are_counted_and_left_out_of_the_mean():
    figures = [
        Figure("N1_pct", 2.0, {"steady": 4.0}),
        Figure("N2_pct", 2.0, {"steady": 1.0}),
        Figure("EGT_C", math.nan, why="every sample is masked"),
    ]
    rows = summary(figures)
    assert rows["geometric mean over the best"].value == pytest.approx(1.0)
    assert rows["worst over the best"].value == pytest.approx(2.0)
    assert rows["figures lost"].value == 1.0


def test_response_times_of_all_divisions_come_first():
    rows = summary([Figure("N1_pct", 2.0, {"steady": 4.0})], [Passes(3, 4, 2), Passes(0, 6, 2)])
    assert next(iter(rows)) == "Ti and Tt passed"
    assert rows["Ti and Tt passed"].value == pytest.approx(30.0)
    assert rows["Ti and Tt passed"].target == pytest.approx(40.0)
    assert rows["Ti and Tt passed"].note == "3 of 10; best baseline 4"
    assert summary(passes=[Passes(0, 0, 0)])["Ti and Tt passed"].reached is None


def test_masked_samples_and_logs_with_findings_are_shares_of_all():
    seen = [Screened("a", 2.0, 1000, 0, ()), Screened("b", 2.0, 1000, 10, ("N1_pct stuck",))]
    rows = summary(seen=seen)
    assert rows["sound samples masked"].value == pytest.approx(0.5)
    assert rows["sound logs with a finding, per 100 h"].value == pytest.approx(25.0)


def test_a_known_fault_is_no_false_finding_and_has_to_be_masked_to_its_ends(monkeypatch):
    sound = log("bad", "left")
    monkeypatch.setattr(recorders, "KNOWN", {"bad:left": ("FF_kgph", 0.0, 30.0)})
    fault = Finding("scale", "FF_kgph", 0.0, 31.0, 50.0, "%", 0.999, "+50 %", log=sound.name)
    names = ("FF_kgph", "N1_pct")
    right = recorders._screened(replace(sound, findings=(fault,)), names)
    assert (right.found, right.masked, right.findings) == (True, 0, ())
    whole = recorders._screened(replace(sound, findings=(replace(fault, end_s=60.0),)), names)
    assert whole.found is False
    assert whole.masked == 249  # from 35.1 s on
    assert len(whole.findings) == 1
    assert recorders._screened(sound, names).found is False


def test_an_unknown_set_is_refused_with_the_known_ones():
    assert recorders.options_of("a321,jetcat") == ("a321", "jetcat")
    with pytest.raises(ValueError, match=r"^no set 'b747'; sets are citation, a321, jetcat, "):
        recorders.options_of("b747")
