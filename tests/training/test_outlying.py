"""Logs that contradict the others as a whole: which are left out, and what is said of them."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.training.test_masking import CONFIG
from tests.training.test_screening import flights
from tests.training.test_steady_fit import LAYOUT, truth
from training.config import RunConfig, SteadyFitConfig
from training.methods import TrainOptions
from training.pipeline import calibrate
from training.records import Split
from training.screening.masking import training_data
from training.steady.steady_choice import Outlier, contradicting, outliers, steady_state, without
from training.steady.steady_fit import SteadySamples

ROWS = 300


def samples(number, lever_deg=0.0, dT_C=0.0, scatter=(0.5, 8.0)):
    """A flight of an engine of the type, with a lever or an air temperature that reads too much."""
    rng = np.random.default_rng(number)
    low, high = [5.0, 0.0, 0.0, -10.0], [80.0, 30000.0, 0.8, 20.0]
    inputs = rng.uniform(low, high, (ROWS, 4))
    outputs = truth(inputs) + np.clip(rng.normal(size=2), -2.0, 2.0) * scatter
    return SteadySamples(
        inputs + np.array([lever_deg, 0.0, 0.0, dT_C]), outputs, log=f"{number}.csv"
    )


def names(parts):
    return [each.log for each in outliers(parts, LAYOUT, SteadyFitConfig())]


@given(first=st.integers(0, 10_000), count=st.integers(3, 12))
def test_engines_within_twice_their_scatter_are_not_accused(first, count):
    assert not names([samples(first + k) for k in range(count)])


@pytest.mark.parametrize("count", [3, 4, 8, 20])
@pytest.mark.parametrize("fault", [{"lever_deg": 8.0}, {"lever_deg": -8.0}, {"dT_C": 30.0}])
def test_the_log_with_a_wrong_input_is_found_among_any_number(count, fault):
    parts = [samples(0, **fault), *(samples(k) for k in range(1, count))]
    assert names(parts) == ["0.csv"]


def test_its_errors_are_those_of_the_fit_to_the_others():
    parts = [samples(k, scatter=(0.0, 0.0)) for k in range(6)]
    parts[2] = replace(parts[2], outputs=parts[2].outputs + np.array([0.0, 120.0]))
    [found] = outliers(parts, LAYOUT, SteadyFitConfig())
    assert found.log == "2.csv"
    assert found.errors["EGT_C"] == pytest.approx(120.0, rel=0.05)
    assert found.errors["N1_pct"] < 1.0
    assert found.words.startswith(
        "2.csv contradicts the other logs as a whole: their steady state misses its N1_pct by "
    )
    assert "EGT_C by 1" in found.words
    assert "nothing was learned from it" in found.words


def test_of_two_logs_and_of_halves_neither_is_accused():
    assert not names([samples(0), samples(1, lever_deg=8.0)])
    assert not names([samples(0), samples(1), samples(2, 8.0), samples(3, 8.0)])


def test_parts_of_a_log_are_one_log_and_empty_ones_none():
    parts = [samples(0, lever_deg=8.0), samples(1), samples(2)]
    halves = [
        replace(one, inputs=one.inputs[rows], outputs=one.outputs[rows])
        for one in parts
        for rows in (slice(0, 150), slice(150, None), slice(0, 0))
    ]
    assert names(halves) == ["0.csv"]


def test_an_output_that_a_log_lacks_does_not_count():
    parts = [samples(0, lever_deg=8.0), *(samples(k) for k in range(1, 5))]
    lacking = parts[3].outputs * [1.0, np.nan]
    parts[3] = replace(parts[3], outputs=lacking)
    parts[0] = replace(parts[0], outputs=parts[0].outputs * [1.0, np.nan])
    [found] = outliers(parts, LAYOUT, SteadyFitConfig())
    assert found.log == "0.csv"
    assert "EGT_C" not in found.words


INPUTS = ("TRA_deg", "ALT_ft", "Mach", "dT_C")
BY_LEVER = RunConfig.parse(
    {
        **CONFIG.model_dump(mode="json", by_alias=True),
        "events": {"driver": "TRA_deg", "condition": ""},
        "steady_state": {
            "inputs": list(INPUTS), "driver": "TRA_deg", "blend": ["Mach"], "switches": [],
        },
    }
)  # fmt: skip


@pytest.fixture(scope="module")
def rigged():
    """Four flights with a lever that asks for a fan speed; in the second it reads 8 deg more."""
    logs = []
    for seed, log in enumerate(flights(1, 2, 3, 4), start=1):
        lever_deg = np.clip(log["N1_pct"] - 20.0, 0.0, 85.0) + (8.0 if seed == 2 else 0.0)
        logs.append(log.with_channels({"TRA_deg": lever_deg}))
    return logs


@pytest.mark.slow
def test_it_is_not_learned_from_and_that_is_said_and_counted(rigged):
    screened = TrainOptions(screened=True)
    config = BY_LEVER.having(train={"choice_s": 0.0})  # the network alone
    bundle = calibrate(config, Path(), Split(tuple(rigged), (), ()), screened)
    found = bundle.record.screening
    assert [row.left_out_rows for row in found.logs] == [0, len(rigged[1]), 0, 0]
    assert [row.log for row in found.contradicting] == ["2.csv"]
    assert list(bundle.record.logs("train")) == [log.name for log in rigged if log is not rigged[1]]
    [text] = bundle.record.doubtful_logs
    assert text.startswith("2.csv contradicts the other logs as a whole")
    sound = training_data(Split((rigged[0], *rigged[2:]), (), ()), BY_LEVER, screen=False).split
    quality = steady_state(BY_LEVER, Path(), sound.train)[1]
    assert bundle.record.steady_state.rms == quality.rms


def test_parts_go_with_their_log(rigged):
    found = contradicting(BY_LEVER, rigged)
    parts = [log.part(a, b) for log in rigged for a, b in ((0, 900), (900, len(log)))]
    assert [log.source.file for log in without(parts, found)] == (
        ["1.csv"] * 2 + ["3.csv"] * 2 + ["4.csv"] * 2
    )
    assert without(parts, [Outlier("x.csv", {})]) == tuple(parts)
