"""Virtual flights in files: bytes that come again, truth out of the readers' way, known effects."""

import gzip
import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from data_prep.config import LogsConfig
from data_prep.reading import read_logs
from narxcal.channels import CHANNELS
from narxcal.flight_test.fly import (
    TRUE_CHANNELS,
    TRUTH,
    TRUTH_SCHEMA,
    WriteOptions,
    fly,
    load_scenario,
    write_flights,
)
from narxcal.flight_test.scenario import FlightScenario
from narxcal.flight_test.signals import first_order
from narxcal.support.errors import ConfigError, ModelError

ROOT = Path(__file__).parents[2]
SHIPPED = sorted(file.name for file in (ROOT / "configs").glob("fly_*.toml"))
LAG = {"id": "sensor_lag", "channel": "EGT_C", "parameters": {"tau_s": 1.5}}


def scenario(**table):
    """The shortest flights at a slow rate: quick to fly."""
    quick = {"flights": 2, "plan": {"duration_s": 480.0, "rate_hz": 8.0}}
    return FlightScenario.parse({**quick, **table})


def virtual_scenario(**table):
    return scenario(flights=1, **table)


def contents(folder):
    return {str(f.relative_to(folder)): f.read_bytes() for f in folder.rglob("*") if f.is_file()}


@pytest.fixture(scope="module")
def virtual():
    """One flight of the virtual engine, perfectly measured, and with an effect of each side."""
    exact = virtual_scenario(engines=["left"], sensors={"preset": "perfect"})
    spool = {"id": "spool_lag", "parameters": {"factor": 2.0}}
    changed = exact.model_copy(update={"effects": virtual_scenario(effects=[LAG, spool]).effects})
    return fly(exact, 1)[0], fly(changed, 1)[0]


# Bytes


def test_another_seed_gives_other_bytes_and_more_flights_the_same_first_ones(tmp_path):
    folders = [tmp_path / name for name in "abc"]
    for folder, table in zip(folders, ({}, {"seed": 1, "flights": 1}, {"flights": 1}), strict=True):
        write_flights(folder, scenario(engines=["left"], **table))
    first, other, fewer = (contents(folder) for folder in folders)
    assert not set(first.values()) & set(other.values())
    assert fewer.items() <= first.items()
    assert len(set(first.values())) == 2


def test_zipped_logs_hold_what_plain_ones_do(tmp_path):
    write_flights(tmp_path / "plain", scenario(flights=1))
    write_flights(tmp_path / "zipped", scenario(flights=1), WriteOptions(gzipped=True))
    plain = contents(tmp_path / "plain")
    assert len(set(plain.values())) == 2  # the engines are two
    zipped = contents(tmp_path / "zipped")
    assert {f"{name}.gz": data for name, data in plain.items()} == {
        name: gzip.decompress(data) for name, data in zipped.items()
    }


def test_effects_and_sensors_of_one_channel_leave_the_other_columns_as_they_were(tmp_path):
    plain, lagged = fly(scenario(), 1)[0], fly(scenario(effects=[LAG]), 1)[0]
    for name, values in plain.recorded.items():
        assert (values == lagged.recorded[name]).all() == (name != "EGT_C")


# Logs and truth


@pytest.mark.slow
def test_logs_read_back_as_they_were_flown_and_no_pattern_finds_the_truth(tmp_path):
    given = scenario(sensors={"channels": {"EGT_C": {"dropouts_per_h": 60.0}}})
    write_flights(tmp_path, given, WriteOptions(true_channels=True))
    (tmp_path / TRUTH).write_text("{}", "utf-8")
    files = LogsConfig(folder=str(tmp_path)).resolve(tmp_path)
    assert [file.name for file in files] == [
        f"flight_0{flight}_{engine}.csv" for flight in (1, 2) for engine in ("left", "right")
    ]
    flown = [log for flight in (1, 2) for log in fly(given, flight)]
    for file, log in zip(files, flown, strict=True):
        assert file.name == f"{log.name}.csv"
        raw = pd.read_csv(file)
        assert list(raw.columns) == list(log.recorded) == [c for c in CHANNELS if c in log.recorded]
        np.testing.assert_allclose(raw, pd.DataFrame(log.recorded), rtol=1e-7, atol=1e-7)
        assert raw["EGT_C"].isna().any()
        (read,) = read_logs(file)
        np.testing.assert_array_equal(read.time_s, log.recorded["time_s"])
        assert set(read.channels) == set(log.recorded) - {"time_s"}
        assert set(read.audit.masked()) <= {"EGT_C"}
    true = sorted((tmp_path / TRUE_CHANNELS).iterdir())
    assert [file.name for file in true] == [file.name for file in files]
    np.testing.assert_allclose(pd.read_csv(true[0])["EGT_C"], flown[0].true["EGT_C"], rtol=1e-7)


def test_the_truth_says_all_that_was_drawn(tmp_path):
    given = scenario(
        name="trial",
        seed=5,
        effects=[{**LAG, "flights": [2], "engines": ["right"]}],
        sensors={"channels": {"N1_pct": {"dropouts_per_h": 60.0}}},
    )
    progress = []
    truth = write_flights(tmp_path, given, progress=lambda *step: progress.append(step))
    assert json.loads(json.dumps(truth)) == truth
    assert (truth["schema"], truth["name"], truth["seed"]) == (TRUTH_SCHEMA, "trial", 5)
    assert FlightScenario.parse(truth["scenario"]) == given
    assert [(row["flight"], row["engine"]) for row in truth["logs"]] == [
        (1, "left"), (1, "right"), (2, "left"), (2, "right")
    ]  # fmt: skip
    assert [len(row["effects"]) for row in truth["logs"]] == [0, 0, 0, 1]
    assert truth["logs"][3]["effects"][0]["parameters"] == {"tau_s": 1.5}
    for row in truth["logs"]:
        assert row["samples"] == 3840
        assert row["duration_s"] == 480.0
        assert (tmp_path / row["file"]).is_file()
        assert row["sensors"]["EGT_C"]["bias"] != 0.0
        assert {move["kind"] for move in row["lever_moves"]} == {"push", "pull"}
    assert progress == [(1, 2, "flight 1"), (2, 2, "flight 2")]
    blank = pd.read_csv(tmp_path / "flight_01_left.csv").N1_pct.isna()
    spans = truth["logs"][0]["sensors"]["N1_pct"]["dropouts_s"]
    time_s = np.arange(3840) / 8.0
    wanted = np.any([(time_s >= start) & (time_s < end) for start, end in spans], axis=0)
    np.testing.assert_array_equal(blank, wanted)


def test_lever_moves_are_where_the_log_shows_them(tmp_path):
    (log, _) = fly(scenario(sensors={"inputs": "exact"}), 1)
    time_s, lever = log.recorded["time_s"], log.recorded["TRA_deg"]
    assert len(log.facts["lever_moves"]) > 10
    for move in log.facts["lever_moves"]:
        start, stop = np.searchsorted(time_s, [move["start_s"], move["stop_s"]])
        assert lever[start] == move["from_deg"]
        assert lever[stop] == move["to_deg"]
        assert lever[start + 1] != lever[start]


def test_data_sets_of_the_paper_are_ten_logs(tmp_path, monkeypatch):
    whole = FlightScenario.planned

    def begun(given, flight):
        """The first tenth of a flight: hours of it are not needed here."""
        return {
            side: {name: values[: len(values) // 10] for name, values in channels.items()}
            for side, channels in whole(given, flight).items()
        }

    monkeypatch.setattr(FlightScenario, "planned", begun)
    paper = scenario(records="fast_push", flights=None, plan={"rate_hz": 8.0})
    truth = write_flights(tmp_path, paper)
    assert [row["file"] for row in truth["logs"]] == [f"data_set_{n:02d}.csv" for n in range(1, 11)]
    assert len({row["samples"] for row in truth["logs"]}) == 10


def test_only_the_outputs_and_engines_that_were_asked_for_are_recorded(tmp_path):
    given = scenario(outputs=["EGT_C", "N1_pct"], engines=["right"])
    (log,) = fly(given, 1)
    assert log.name == "flight_01_right"
    recorded = [name for name in log.recorded if CHANNELS[name].role == "output"]
    assert recorded == ["N1_pct", "EGT_C"]
    assert {"N2_pct", "FF_kgph"} <= set(log.true)


# The virtual engine


def test_the_virtual_engine_records_all_its_outputs_and_tells_its_inner_state(virtual):
    plain, _ = virtual
    assert list(plain.recorded) == [
        "time_s", "TRA_deg", "ALT_ft", "Mach", "dT_C", "WOW", "Approach", "ECS", "NAI", "WAI",
        "N1_pct", "N2_pct", "EGT_C", "FF_kgph", "FN_kN", "FPR", "EPR",
    ]  # fmt: skip
    assert "T45_K" in plain.true
    for name in plain.recorded:
        if CHANNELS[name].role == "output":
            np.testing.assert_array_equal(plain.recorded[name], plain.true[name])


def test_effects_of_the_engine_act_in_it_and_effects_of_a_sensor_behind_it(virtual):
    plain, changed = virtual
    # Heavier spools: same places, later. The lag of the sensor: the engine's own, lagged.
    assert (changed.true["N2_pct"] != plain.true["N2_pct"]).any()
    np.testing.assert_array_equal(changed.recorded["N2_pct"], changed.true["N2_pct"])
    lagged = first_order(changed.true["EGT_C"], 1.5, 0.125)
    np.testing.assert_allclose(changed.recorded["EGT_C"], lagged, rtol=1e-12)
    np.testing.assert_array_equal(changed.recorded["TRA_deg"], plain.recorded["TRA_deg"])


# Files


@pytest.mark.parametrize("name", SHIPPED)
def test_shipped_scenarios_load_by_path_and_by_any_of_their_names(name):
    found = load_scenario(ROOT / "configs" / name)
    short = name.removeprefix("fly_").removesuffix(".toml")
    for alias in (name, name.removesuffix(".toml"), short, f"{short}.toml"):
        assert load_scenario(alias) == found
    assert FlightScenario.parse(found.model_dump(mode="json", by_alias=True)) == found


def test_a_local_file_wins_over_a_shipped_one(tmp_path, monkeypatch):
    (tmp_path / "demo").write_text("schema = 'narxcal.fly/1'\nseed = 77\n", "utf-8")
    monkeypatch.chdir(tmp_path)
    assert load_scenario("demo").seed == 77


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("", "expected schema = 'narxcal.fly/1', found nothing. Write it as the first line"),
        (
            "schema = 'narxcal.config/1'",
            (
                "expected schema = 'narxcal.fly/1', found 'narxcal.config/1'. "
                "Write it as the first line"
            ),
        ),
        (
            "schema = 'narxcal.fly/1'\n[plan]\nstile = 1",
            "unknown key 'plan.stile'. Did you mean 'style'?",
        ),
        (
            "schema = 'narxcal.fly/1'\n[[effects]]\nid = 'spool_lag'\n",
            "effect 'spool_lag' has no size. Give factor",
        ),
    ],
)
def test_a_file_that_is_no_scenario_is_refused(tmp_path, content, message):
    file = tmp_path / "fly.toml"
    file.write_text(content, "utf-8")
    with pytest.raises(ConfigError) as error:
        load_scenario(file)
    assert str(error.value) == f"{file}: {message}"


def test_what_is_no_toml_or_not_there_is_refused(tmp_path):
    file = tmp_path / "fly.toml"
    file.write_text("schema = ", "utf-8")
    with pytest.raises(ConfigError, match=r"fly\.toml: not TOML: "):
        load_scenario(file)
    with pytest.raises(ConfigError) as error:
        load_scenario(tmp_path)
    shipped = ", ".join(sorted(name[4:-5] for name in SHIPPED))
    assert str(error.value) == (
        f"{tmp_path}: the scenario does not exist. Name a file, or one of the shipped {shipped}"
    )


def test_a_flight_beyond_the_engines_envelope_is_named(monkeypatch):
    given = virtual_scenario()
    plans = given.planned(1)
    plans["left"]["ALT_ft"][7] = 50_000.0
    monkeypatch.setattr(FlightScenario, "planned", lambda _scenario, _flight: plans)
    with pytest.raises(ModelError) as error:
        fly(given, 1)
    assert str(error.value).startswith("flight_01_left: sample 7: ALT_ft is 50000 ft, outside")
