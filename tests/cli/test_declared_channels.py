"""Engines beyond turbofans through the command line, by channels that are declared."""

import json
import re

import numpy as np
import pandas as pd
import pytest

from narxcal.calibration.bundle import load_bundle
from tests.turboprop import flown, write

RANGES = {"PropSpeed_rpm": [0, 2200], "Torque_Nm": [-500, 9000], "ShaftPower_kW": [-50, 1500]}
SHORT = """
[train]
horizons_s = [30.0]
iterations = [4]
choice_s = 0.0
delay_s = 0.0
threads = 1
"""
CELL = """\
schema = "narxcal.config/1"

[logs]
folder = "cell"

[logs.channels]
Valve_pct = { range = [0.0, 100.0] }
SHP_kW = { range = [-50.0, 1500.0] }

[events]
driver = "Valve_pct"
response = ["N2_pct"]

[steady_state]
inputs = ["Valve_pct"]
corrected = false

[narx]
outputs = ["N2_pct", "SHP_kW"]
schedule = ["Valve_pct"]
lag_limits = false

[split]
train = ["run_[12]*"]
test = ["run_3*"]
"""


def drafted(folder, narxcal):
    """A configuration by `init`, with the columns that it offers declared and modelled."""
    for seed in (1, 2, 3):
        write(folder / "flights" / f"flight_{seed}.csv", seed)
    out = folder / "mine.toml"
    assert narxcal("init", *sorted((folder / "flights").iterdir()), "--out", out).code == 0
    text = re.sub(r"^# (\w+_(rpm|Nm|kW) = )", r"\1", out.read_text("utf-8"), flags=re.MULTILINE)
    text = text.replace("# [logs.channels]", "[logs.channels]")
    for name, ends in RANGES.items():
        text = text.replace(f'{name} = {{ range = ["?", "?"]', f"{name} = {{ range = {ends}")
    outputs = '"N2_pct", "EGT_C", "PropSpeed_rpm", "Torque_Nm"'
    text = text.replace(
        'outputs = ["N2_pct", "EGT_C"]', f"outputs = [{outputs}]\nlag_limits = true"
    )
    out.write_text(text + SHORT, "utf-8")
    return out


@pytest.mark.slow
def test_a_turboprop_from_its_recorder_file_to_c(tmp_path, narxcal):
    config, run = drafted(tmp_path, narxcal), tmp_path / "run"
    done = narxcal("train", config, "--out", run, "--quiet")
    assert done.code == 0
    document = json.loads((run / "bundle.json").read_text("utf-8"))
    assert document["units"]["Torque_Nm"] == "Nm"
    assert document["units"]["PropSpeed_rpm"] == "rpm"

    done = narxcal("evaluate", run, "--out", tmp_path / "ev", "--quiet")
    assert done.code in (0, 1)
    judged = json.loads((tmp_path / "ev/evaluate.json").read_text("utf-8"))
    scores = judged["logs"][0]["channels"]["Torque_Nm"]
    assert scores["rmse"] < 0.1 * scores["steady_state_rmse"]
    assert scores["rmse"] < 100.0  # of 6000 Nm; 8 Nm are noise
    page = (tmp_path / "ev/evaluate.html").read_text("utf-8")
    assert "Torque [Nm]" in page
    assert "PropSpeed [rpm]" in page

    log, out = tmp_path / "flights/flight_3.csv", tmp_path / "replayed.csv"
    assert narxcal("replay", run, log, "--out", out).code == 0
    replayed = pd.read_csv(out)
    truth = flown(3)["torque"]
    assert np.sqrt(np.mean((replayed["Torque_Nm_fused"] - truth) ** 2)) < 100.0
    bare, made = tmp_path / "inputs.csv", tmp_path / "simulated.csv"
    measured = ("NG", "ITT", "Prop", "Torque", "SHP")
    table = pd.read_csv(log)
    known = [name for name in table if not name.startswith(measured)]
    table[known].to_csv(bare, index=False)
    assert narxcal("simulate", run, bare, "--out", made).code == 0
    runs = pd.read_csv(made)["Torque_Nm"], replayed["Torque_Nm_free_run"]
    np.testing.assert_allclose(*(run[-800:] for run in runs), rtol=1e-3)  # they start apart

    done = narxcal("export", run, "--to", "onnx", "--out", tmp_path / "model.onnx", "--json")
    assert done.code == 0
    assert load_bundle(run).calibration.output_names[-1] == "Torque_Nm"


@pytest.mark.slow
def test_a_test_cell_is_driven_by_a_declared_input(tmp_path, narxcal):
    (tmp_path / "cell").mkdir()
    for seed in (1, 2, 3):
        run = flown(seed)
        table = {"time_s": run["t"], "Valve_pct": run["lever"] / 0.9, "N2_pct": run["ng"]}
        pd.DataFrame({**table, "SHP_kW": run["power"]}).to_csv(
            tmp_path / "cell" / f"run_{seed}.csv", index=False
        )
    (tmp_path / "cell.toml").write_text(CELL + SHORT, "utf-8")
    done = narxcal("train", tmp_path / "cell.toml", "--out", tmp_path / "run", "--quiet")
    assert (done.code, done.err.count("error")) == (0, 0)
    bundle = load_bundle(tmp_path / "run")
    assert bundle.calibration.input_names == ("Valve_pct",)
    assert bundle.calibration.reach.high[0] <= 100.0
    done = narxcal("evaluate", tmp_path / "run", "--out", tmp_path / "ev", "--quiet")
    assert done.code in (0, 1)
    scores = json.loads((tmp_path / "ev/evaluate.json").read_text("utf-8"))["pooled"]["channels"]
    assert scores["SHP_kW"]["rmse"] < scores["SHP_kW"]["steady_state_rmse"]

    done = narxcal(
        "diagnose", "--real", tmp_path / "cell", "--sim", tmp_path / "run", "--config",
        tmp_path / "cell.toml", "--out", tmp_path / "gap",
    )  # fmt: skip
    assert done.code == 2
    assert done.err == (
        f"narxcal: error: {tmp_path / 'run'}, channel Valve_pct: an input of the run is a declared "
        "channel, and a diagnosis simulates from built-in ones alone. Train a run without it in "
        "[steady_state] inputs\n"
    )


def test_a_declared_channel_without_a_column_in_the_file_is_named(tmp_path, narxcal):
    write(tmp_path / "flights" / "flight_1.csv", 1, 20.0)
    (tmp_path / "mine.toml").write_text(
        'schema = "narxcal.config/1"\n[logs]\nfolder = "flights"\n'
        "[logs.channels]\nTRQ_pct = { range = [0.0, 130.0] }\n[logs.columns]\n"
        'time_s = { column = "Time (s)" }\nN2_pct = { column = "NG (%)" }\n'
        'TRQ_pct = { column = "TQ" }\n',
        "utf-8",
    )
    done = narxcal("prepare", tmp_path / "mine.toml", "--out", tmp_path / "prepared")
    assert done.code == 2
    file = tmp_path / "flights" / "flight_1.csv"
    assert f"{file}, channel TRQ_pct: column 'TQ' is missing." in done.err
