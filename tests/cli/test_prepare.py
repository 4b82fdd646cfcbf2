"""`narxcal prepare`: files of one flight are one log, and what a log shows to be wrong is said."""

import json

import numpy as np
import pandas as pd
import pytest

from tests.turboprop import flown

CONFIG = """\
schema = "narxcal.config/1"

[logs]
folder = "flights"
flights = ["{flight}_engine.csv", "{flight}_air.csv"]

[events]
response = ["N2_pct"]

[narx]
outputs = ["N2_pct", "EGT_C"]

[steady_state]
inputs = ["TRA_deg", "ALT_ft", "Mach"]
"""


@pytest.fixture
def flight(tmp_path):
    """Engine and air data of a flight in files of their own; the altitude is that of one moment."""
    run = flown(2, 240.0)
    engine = {"TRA_deg": run["lever"], "N2_pct": run["ng"], "EGT_C": run["itt"]}
    air = {"ALT_ft": np.full(len(run["t"]), 5000.0), "Mach": run["mach"], "SAT_C": run["t"] * -0.05}
    (tmp_path / "flights").mkdir()
    for name, table in (("engine", engine), ("air", air)):
        path = tmp_path / "flights" / f"f7_{name}.csv"
        pd.DataFrame({"time_s": run["t"], **table}).to_csv(path, index=False)
    (tmp_path / "mine.toml").write_text(CONFIG, "utf-8")
    return tmp_path


def test_files_of_a_flight_are_one_log_and_its_findings_are_reported(flight, narxcal):
    done = narxcal("prepare", flight / "mine.toml", "--out", flight / "prepared")
    assert done.code == 0
    document = json.loads((flight / "prepared/prepare.json").read_text("utf-8"))
    (log,) = document["logs"]
    assert (log["log"], log["prepared"]) == ("f7", "logs/f7.csv.gz")
    assert {"N2_pct", "ALT_ft", "Mach"} <= set(log["channels"])
    (found,) = [each for each in log["findings"] if each["channel"] == "ALT_ft"]
    assert found["kind"] == "stuck"
    (said,) = [text for text in document["cautions"] if text.startswith("f7: ALT_ft stuck")]
    assert said.replace(",", "") in done.err.replace(",", "")
    assert "f7: ALT_ft stuck" in (flight / "prepared/prepare.html").read_text("utf-8")
