"""Studies of the Spey paper: claims of its tables, simulated engines, logs of two flights."""

from dataclasses import dataclass

import numpy as np
import pytest

import eval.reproduce.spey_flights as flights
from data_prep.log import Log, Source
from eval.reproduce.spey import paper_study
from eval.reproduce.spey_simulated import Trial, coverage, simulated_study, truth
from narxcal.output_error.engine import EngineFromSteady
from training.config import load_config
from training.output_error_flights import steady_record


def by_start(study):
    """Claims by their number in the list of the paper's claims, or first words."""
    return [(claim.what[:3].strip(), claim.met) for claim in study.claims]


def test_what_the_papers_tables_bear_out_and_what_they_contradict():
    assert by_start(paper_study()) == [
        ("S3", True), ("S5", False), ("S6", False), ("S9", True), ("S10", False),
        ("S2", True), ("S4", False), ("S6", True), ("S7", True), ("S8", True),
    ]  # fmt: skip
    contradicted = [claim for claim in paper_study().claims if claim.met is False]
    assert all(claim.remark for claim in contradicted)
    four = next(claim for claim in contradicted if claim.what.startswith("S4"))
    assert four.value == 4
    assert "C_HL -11 % (significant)" in four.remark


def test_the_twin_differs_from_the_left_engine_in_tau_h_alone():
    left, twin = truth("left"), truth("twin")
    assert {name for name in left if left[name] != twin[name]} == {"tau_H", "tau_engine"}


@pytest.mark.slow
def test_a_study_has_its_claims_and_tables():
    told = []
    study = simulated_study(1, watch=lambda *row: told.append(row[1:]))
    assert told == [(1, 1)]
    found = {claim.what[:3].strip(): claim for claim in study.claims}
    assert found["S12"].met
    power = next(claim for claim in study.claims if "35 %" in claim.what)
    assert power.met
    shares = study.results["coverage"]
    assert shares["pooled"] > 65.0
    assert len(study.tables[0].rows) == len(shares) - 1
    bias = {row[0].text: float(row[4].text) for row in study.tables[1].rows}
    assert bias["alpha"] > 3.0


def test_coverage_counts_both_engines_and_pools_what_was_estimated():
    exact = {engine: truth(engine) for engine in ("left", "right")}

    def estimates(errors):
        return {
            engine: {
                name: (exact[engine][name] + error, 1.0)
                for name, error in zip(("tau_H", "alpha", "tau_engine"), errors, strict=True)
            }
            for engine in exact
        }

    # The half width of a 90 % interval is 1.645 standard deviations.
    trials = [
        Trial(estimates((1.64, 1.65, 9.0)), estimates((0.0, 9.0, 0.0)), {}, 1.0),
        Trial(estimates((-1.64, 0.0, 0.0)), estimates((0.0, 9.0, 0.0)), {}, 1.0),
    ]
    assert coverage(trials) == {"tau_H": 100.0, "alpha": 50.0, "tau_engine": 50.0, "pooled": 75.0}
    assert coverage(trials, coloured=True)["pooled"] == 50.0


WEIGHTED = ": weighted means of the parts, 5 % over all parameters together"


@dataclass(frozen=True)
class Curves:
    input_names: tuple = ("FF_kgph",)
    output_names: tuple = ("N1_pct", "N2_pct", "EGT_C")

    def outputs(self, inputs):
        x = inputs[..., 0] / 600.0
        return np.stack([100 * x**0.6, 50 + 45 * x**0.5, 350 + 300 * x], axis=-1)


def made_log(file, engine, seed, tau_H):
    rng = np.random.default_rng(seed)
    fuel = np.interp(np.arange(3000), np.arange(60) * 50, rng.uniform(100, 600, 60))
    zero = dict.fromkeys(("N1_pct", "N2_pct", "EGT_C"), np.zeros(3000))
    log = Log(f"{file}:{engine}", np.arange(3000) * 0.1, {"FF_kgph": fuel} | zero,
              source=Source(file, "", engine))  # fmt: skip
    model = EngineFromSteady(0.1)
    values = {one.name: one.start for one in model.parameters} | {"tau_H": tau_H, "tau_M": 0.3}
    y = model.simulate(values, steady_record(log, Curves(), "FF_kgph").u)
    N2, N1, T = (y + rng.normal(size=y.shape) * [0.1, 0.1, 1.0]).T
    return log.with_channels({"N2_pct": N2, "N1_pct": N1, "EGT_C": T})


@pytest.mark.slow
def test_two_flights_of_two_engines(monkeypatch):
    monkeypatch.setattr(flights, "steady_state", lambda *_: (Curves(), None))
    config, base = load_config("citation2.toml")
    logs = [
        made_log(file, engine, 10 * k + j, tau_H)
        for k, file in enumerate(("one", "two"))
        for j, (engine, tau_H) in enumerate((("left", 0.7), ("right", 1.0)))
    ]
    study = flights.flights_study(logs, config, base)
    tables = {table.caption: table for table in study.tables}
    left_right = tables[f"one:left against one:right{WEIGHTED}"]
    significant = {row[0].text for row in left_right.rows if row[-1].text == "yes"}
    assert "tau_H" in significant
    same = tables[f"one:left against two:left{WEIGHTED}"]
    assert [row[-1].text for row in same.rows] == ["no"] * len(same.rows)
    predictions = tables["RMS error of the free run over whole logs"].rows
    assert len(predictions) == 4 + 4
    dynamic = [float(row[5].text) for row in predictions]
    assert max(dynamic) < 0.12  # N2 in percent; its sensor has 0.1
    better = next(claim for claim in study.claims if claim.what.startswith("S12"))
    assert better.met
    assert set(study.results["meter"]) == {log.name for log in logs}
