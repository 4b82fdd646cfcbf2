"""`narxcal simulate --effects` with a simulator that can be run again, and with its logs."""

import json

import numpy as np
import pandas as pd
import pytest

from narxcal.calibration.bundle import load_bundle

ENGINE = """\
def run(inputs, dt_s):
    lever = inputs["TRA_deg"]
    return {"N1_pct": 25.0 + lever, "N2_pct": 55.0 + 0.5 * lever, "EGT_C": 400.0 + 5.0 * lever}
"""
SIGNALS = {
    "inputs": ["TRA_deg", "ALT_ft"],
    "outputs": ["N1_pct", "N2_pct", "EGT_C"],
    "dt_s": 0.125,
    "driver": "TRA_deg",
    "low": [25.0, 55.0, 400.0],
    "high": [95.0, 90.0, 750.0],
    "lever": [0.0, 70.0],
    "active": ["TRA_deg"],
}
GAP = {
    "schema": "narxcal.gap/2",
    "verdict": {"kind": "effects", "effects": ["throttle_bias", "sensor_bias:EGT_C"]},
    "effects": [
        {"id": "throttle_bias", "parameters": {"bias_deg": {"value": 2.0}}},
        {"id": "sensor_bias", "channel": "EGT_C", "parameters": {"bias": {"value": 3.0}}},
    ],
    "quality": {"signals": SIGNALS},
}


@pytest.fixture
def here(tmp_path, monkeypatch):
    """A folder with an engine, its logs, inputs alone on another clock, and a `gap.json`."""
    time_s = 0.1 * np.arange(200)
    lever = 20.0 + 10.0 * np.sin(time_s)
    inputs = {"time_s": time_s + 50.0, "TRA_deg": lever, "ALT_ft": 5000.0 + 0.0 * lever}
    outputs = {"N1_pct": 25.0 + lever, "N2_pct": 55.0 + 0.5 * lever, "EGT_C": 400.0 + 5.0 * lever}
    for name, channels in (("inputs", inputs), ("sim", {**inputs, "time_s": time_s, **outputs})):
        (tmp_path / name).mkdir()
        pd.DataFrame(channels).to_csv(tmp_path / name / "f.csv", index=False)
    (tmp_path / "gap.json").write_text(json.dumps(GAP), "utf-8")
    (tmp_path / "bench_engine.py").write_text(ENGINE, "utf-8")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_a_function_is_told_inputs_with_the_effect_on_them(here, narxcal):
    words = ("--sim", "bench_engine:run", "--effects", "gap.json", "--inputs", "inputs")
    done = narxcal("simulate", *words, "--out", "out")
    assert (done.code, done.err) == (0, "")
    assert "throttle_bias: applied on its inputs, and the simulator run again" in done.out
    assert "sensor_bias:EGT_C: applied on its outputs" in done.out
    made, given = pd.read_csv(here / "out" / "f.csv"), pd.read_csv(here / "inputs" / "f.csv")
    # The inputs in the file are those that were given, not those that arrive.
    np.testing.assert_allclose(made[list(given)], given, rtol=1e-8)
    np.testing.assert_allclose(made["N1_pct"], 27.0 + given["TRA_deg"], rtol=1e-8)
    np.testing.assert_allclose(made["EGT_C"], 413.0 + 5.0 * given["TRA_deg"], rtol=1e-8)
    done = narxcal("simulate", *words, "--out", "out", "--json")
    document = json.loads(done.out)
    assert document["simulator"] == "function"
    assert document["applied"] == {
        "throttle_bias": "on its inputs, and the simulator run again",
        "sensor_bias:EGT_C": "on its outputs",
    }
    assert document["logs"][0]["rms_change"]["N1_pct"] == pytest.approx(2.0)


def test_logs_need_the_emulator_for_an_effect_on_inputs(here, narxcal):
    words = ("--sim", "sim", "--effects", "gap.json", "--inputs", "inputs", "--out", "out")
    done = narxcal("simulate", *words)
    assert done.code == 2
    assert "effect 'throttle_bias' needs the emulator, which is not next to gap.json" in done.err
    assert "Keep the whole folder that narxcal diagnose wrote, with emulator/ in it" in done.err
    assert not (here / "out").exists()


def test_logs_take_effects_on_readings_and_the_clock_of_the_inputs(here, narxcal):
    verdict = {**GAP, "verdict": {"kind": "effects", "effects": ["sensor_bias:EGT_C"]}}
    (here / "gap.json").write_text(json.dumps(verdict), "utf-8")
    words = ("--sim", "sim", "--effects", "gap.json", "--inputs", "inputs", "--out", "out")
    done = narxcal("simulate", *words)
    assert (done.code, done.err) == (0, "")
    made, sim = pd.read_csv(here / "out" / "f.csv"), pd.read_csv(here / "sim" / "f.csv")
    assert made["time_s"][0] == 50.0
    np.testing.assert_allclose(made["EGT_C"], sim["EGT_C"] + 3.0, rtol=1e-8)


def test_samples_of_which_the_simulator_says_nothing_are_told_and_left_blank(here, narxcal):
    verdict = {**GAP, "verdict": {"kind": "effects", "effects": ["sensor_bias:EGT_C"]}}
    (here / "gap.json").write_text(json.dumps(verdict), "utf-8")
    sim = pd.read_csv(here / "sim" / "f.csv")
    sim.loc[50:119, "EGT_C"] = np.nan
    sim.to_csv(here / "sim" / "f.csv", index=False)
    words = ("--sim", "sim", "--effects", "gap.json", "--inputs", "inputs", "--out", "out")
    done = narxcal("simulate", *words, "--json")
    assert done.code == 0
    assert done.err == (
        "narxcal: warning: f: the simulator gives no EGT_C in 70 of 200 samples: they are "
        "left blank\n"
    )
    row = json.loads(done.out)["logs"][0]
    assert row["blank"] == {"EGT_C": 70}
    assert row["rms_change"]["EGT_C"] == pytest.approx(3.0)
    assert pd.read_csv(here / "out" / "f.csv")["EGT_C"].isna().sum() == 70


def test_a_run_works_on_its_own_raster(project, narxcal, tmp_path):
    """The model runs at 8 Hz, the flights are at 32 Hz."""
    quality = {"signals": {**SIGNALS, "active": []}}
    gap = {**GAP, "verdict": {"kind": "none", "effects": []}, "quality": quality}
    (tmp_path / "gap.json").write_text(json.dumps(gap), "utf-8")
    words = ("--sim", project / "run", "--effects", tmp_path, "--inputs", project / "flights")
    done = narxcal("simulate", *words, "--out", tmp_path / "out")
    assert (done.code, done.err) == (0, "")
    made, given = (pd.read_csv(f / "flight_3.csv") for f in (tmp_path / "out", project / "flights"))
    assert len(made) == len(given)
    np.testing.assert_allclose(made["time_s"], given["time_s"], atol=1e-6)
    own = load_bundle(project / "run").calibration
    inputs = given[list(own.input_names)].to_numpy(float)[::4]
    slow = own.simulate(inputs)
    for column, name in zip(slow.T, own.output_names, strict=True):
        np.testing.assert_allclose(made[name][::4], column, atol=1e-6 * np.ptp(column))
        between = made[name].to_numpy()[2:-4:4]
        np.testing.assert_allclose(between, 0.5 * (column[:-1] + column[1:])[: len(between)])
