"""Recorded flights with a known fault: what changes in the file, and nothing else."""

import csv
import io

import numpy as np
import pytest

from data_prep.config import LogsConfig
from eval.diagnosis.blind.altered import (
    ALTERATIONS,
    DRIVER,
    Alteration,
    Altered,
    alter,
    draw_altered,
    make_altered,
)
from eval.diagnosis.blind.cases import BlindPlan
from narxcal.support.errors import ConfigError, DataError

TIME_S = 100.0 + 0.1 * np.arange(600)
LOGS = LogsConfig.parse(
    {
        "files": ["*.csv"],
        "engines": {"left": "l_", "right": "r_"},
        "columns": {
            "time_s": {"column": "t"},
            "FF_kgph": {"column": "{engine}ff", "unit": "lb/h"},
            "N1_pct": {"column": "{engine}n1"},
            "EGT_C": {"column": "{engine}egt", "unit": "K"},
        },
    }
)


def of(effect, channel=None):
    return next(a for a in ALTERATIONS if a.id == effect and channel in (None, a.channel))


@pytest.fixture
def flight(tmp_path):
    names = ["t", "note", *(f"{side}_{n}" for side in "lr" for n in ("ff", "n1", "egt"))]
    wave = np.sin(0.2 * TIME_S)
    rows = [
        [f"{t:.1f}", "as is", *[f"{v:.4f}" for v in (900 + 90 * w, 60 + 9 * w, 800 + 50 * w)] * 2]
        for t, w in zip(TIME_S.tolist(), wave.tolist(), strict=True)
    ]
    rows[5][3] = ""
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows([names, *rows])
    (tmp_path / "flight_1.csv").write_text(text.getvalue(), "utf-8")
    return tmp_path / "flight_1.csv"


def columns(text):
    rows = list(csv.reader(io.StringIO(text)))
    return {name: [row[k] for row in rows[1:]] for k, name in enumerate(rows[0])}


def numbers(cells):
    return np.array([float(cell) if cell else np.nan for cell in cells])


def test_an_unaltered_flight_keeps_every_cell(flight):
    assert alter(Altered(flight, (), 0.0), LOGS, "FF_kgph") == flight.read_text("utf-8")


def test_one_channel_of_both_engines_changes_and_blanks_stay(flight):
    before = columns(flight.read_text("utf-8"))
    after = columns(alter(Altered(flight, ((of("time_skew", "N1_pct"), 0.3),), 1.0), LOGS, "x"))
    changed = {name for name in before if before[name] != after[name]}
    assert changed == {"l_n1", "r_n1"}
    assert after["l_n1"][5] == ""
    late = 60 + 9 * np.sin(0.2 * (TIME_S - 0.3))
    np.testing.assert_allclose(numbers(after["r_n1"])[10:], late[10:], atol=2e-4)


@pytest.mark.parametrize(
    ("effect", "size", "column", "expected"),
    [
        # 37 degC more are 37 K more; the meter's 2.5 % are 2.5 % in any unit, and
        # an engine that gets 2.5 % less than recorded has a record that is too large.
        (("sensor_bias", "EGT_C"), 37.0, "l_egt", lambda v: v + 37.0),
        (("sensor_drift", "EGT_C"), 36.0, "l_egt", lambda v: v + 0.01 * (TIME_S - TIME_S[0])),
        (("sensor_gain", "EGT_C"), 6.0, "l_egt", lambda v: 1.06 * v),
        (("driver_gain",), -2.5, "r_ff", lambda v: v / 0.975),
    ],
)
def test_sizes_are_in_the_canonical_unit(flight, effect, size, column, expected):
    before = numbers(columns(flight.read_text("utf-8"))[column])
    content = alter(Altered(flight, ((of(*effect), size),), 1.0), LOGS, "FF_kgph")
    np.testing.assert_allclose(numbers(columns(content)[column]), expected(before), rtol=1e-6)


def test_a_bias_of_a_channel_in_another_unit_is_converted(flight):
    bias = Alteration("sensor_bias", "FF_kgph", "bias", 1.0)
    before = numbers(columns(flight.read_text("utf-8"))["l_ff"])
    after = numbers(columns(alter(Altered(flight, ((bias, 10.0),), 1.0), LOGS, "x"))["l_ff"])
    np.testing.assert_allclose((after - before) * 0.45359237, 10.0, rtol=1e-4)


def test_a_driver_recorded_late_is_an_engine_that_answers_early(flight):
    late = of("throttle_delay")
    case = Altered(flight, ((late, -0.2),), 2.0)
    found = numbers(columns(alter(case, LOGS, "FF_kgph"))["l_ff"])
    expected = 900 + 90 * np.sin(0.2 * (TIME_S - 0.2))
    np.testing.assert_allclose(found[10:], expected[10:], atol=1e-2)
    row = case.row()["effects"][0]
    assert (row["id"], row["channel"]) == ("throttle_delay", None)
    assert row["parameters"] == {"delay_s": -0.2}


def test_a_lag_is_a_lag():
    step = np.where(TIME_S > 120.0, 1.0, 0.0)
    found = of("sensor_lag").applied(step, TIME_S, 2.0)
    at = int(np.searchsorted(TIME_S, 122.0))
    assert found[at] == pytest.approx(1.0 - np.exp(-1.0), abs=0.03)
    assert np.isnan(of("sensor_lag").applied(np.full(3, np.nan), TIME_S[:3], 2.0)).all()


def test_each_flight_is_a_null_once_and_pairs_are_of_two_channels(tmp_path):
    files = [tmp_path / "a.csv", tmp_path / "b.csv"]
    found = draw_altered(32, files, ALTERATIONS, np.random.default_rng(1))
    nulls = [each for each in found if not each.parts]
    assert sorted(each.file.name for each in nulls) == ["a.csv", "b.csv"]
    pairs = [each for each in found if len(each.parts) == 2]
    assert len(pairs) == 7
    assert all(each.parts[0][0].channel != each.parts[1][0].channel for each in pairs)
    for each in found:
        for alteration, size in each.parts:
            assert abs(size) == pytest.approx(each.times * abs(alteration.nameable))
    assert {each.times for each in found} == {0.0, 0.5, 1.0, 2.0}
    assert {each.row()["kind"] for each in found} == {"null", "single", "pair"}


def test_cases_of_flights_without_a_driver_or_with_clocks_that_are_no_numbers(flight, tmp_path):
    plan, bare = BlindPlan(cases=2), LogsConfig(files=("*.csv",))
    with pytest.raises(ConfigError, match="neither TRA_deg nor FF_kgph: nothing drives"):
        next(make_altered(tmp_path / "o", plan, bare, tmp_path))
    flight.write_text("t,l_n1,r_n1\n10:00:00,1,1\n10:00:01,1,1\n", "utf-8")
    with pytest.raises(DataError, match=r"flight_1.csv: the time stamps are no numbers"):
        alter(Altered(flight, (), 0.0), LOGS, DRIVER)
