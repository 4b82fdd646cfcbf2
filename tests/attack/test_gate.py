"""Nothing of a run is executed without trust: every command and function that opens a run.

The planted run stores a table, which executes nothing, and names a function of a file beside it as
the steady state of its configuration: whoever trains again from that would run it.
"""

import sys

import numpy as np
import pandas as pd
import pytest

import narxcal
from eval.diagnosis.learned import learn_left_out
from eval.diagnosis.simulators import open_simulator
from narxcal import load_bundle
from narxcal.calibration.bundle import Bundle, check_bundle, read_document, save_bundle
from narxcal.calibration.dynamic import DynamicCalibration
from narxcal.calibration.run_record import RunRecord
from narxcal.cli import main
from narxcal.cli.app import COMMANDS
from narxcal.narx.config import NarxConfig
from narxcal.narx.module import NarxNet
from narxcal.narx.network import NarxModel, Scaling
from narxcal.steady.table import SteadyTable
from narxcal.support.errors import NarxcalError
from training.config import RunConfig

NAMES = (("TRA_deg", "ALT_ft"), ("N1_pct", "N2_pct", "EGT_C"))
MAKER = """\
from pathlib import Path
Path(__file__).with_name("executed").touch()
def engine(u):
    return u[:, [0, 0, 0]]
"""
# What is left out opens no run: it makes its own, or takes the configuration of the user.
COMMANDS_OF_RUNS = {
    "evaluate": ("RUN", "--out", "OUT"),
    "compare": ("RUN", "--out", "OUT"),
    "fleet": ("FLEET.toml", "--out", "OUT"),
    "replay": ("RUN", "LOG", "--out", "OUT.csv"),
    "simulate": ("RUN", "LOG", "--out", "OUT.csv"),
    "info": ("RUN",),
    "card": ("RUN", "--aircraft", "LIMITS.toml", "--out", "OUT.html"),
    "qtg": ("RUN", "--out", "OUT.pdf"),
    "export": ("RUN", "--to", "table", "--out", "OUT.csv"),
    "diagnose": ("--real", "FLIGHTS", "--sim", "RUN", "--out", "OUT"),
    "diagnose --learn": ("--out", "RUN"),
}
OTHERS = {
    "demo", "init", "prepare", "train", "identify", "crossval", "fly", "reproduce", "benchmark",
    "blind", "watch",
}  # fmt: skip


def calibration():
    points = np.array([[0.0, 0.0], [0.0, 4e4], [80.0, 0.0], [80.0, 4e4]])
    settled = np.column_stack(
        [20.0 + points[:, 0], 50.0 + 0.5 * points[:, 0], 400.0 + points[:, 0]]
    )
    net = NarxNet(NarxConfig(lags=1, hidden=1, moving=3), 6, 3).double()
    for parameter in net.parameters():
        parameter.data.zero_()
    plain = [Scaling(np.zeros(n), np.ones(n)) for n in (6, 3)]
    return DynamicCalibration(
        SteadyTable(NAMES, points, settled), NarxModel(net, *plain), 0.125, ()
    )


@pytest.fixture
def planted(tmp_path, flight):
    """A folder with flights, the planted run, and the file that nobody may execute."""
    flights = tmp_path / "flights"
    flights.mkdir()
    for seed in (1, 2):
        log = flight(seed, duration_s=120.0)
        table = pd.DataFrame({"time_s": log.time_s, **log.channels})
        table.to_csv(flights / log.name, index=False)
    for folder in (tmp_path, flights):
        (folder / "maker.py").write_text(MAKER, encoding="utf-8")
    config = RunConfig.parse({
        "schema": "narxcal.config/1",
        "logs": {"folder": str(flights), "files": ["flight_*.csv"]},
        "split": {"train": ["flight_1*"], "test": ["flight_2*"]},
        "events": {"condition": ""},
        "steady_state": {"kind": "callable", "source": "maker:engine", "inputs": list(NAMES[0])},
    })  # fmt: skip
    record = RunRecord.parse({
        "config": config.model_dump(mode="json", by_alias=True),
        "configured": config.model_dump(mode="json", by_alias=True),
        "base": str(tmp_path),
        "split": {"train": ["flight_1.csv"], "validate": [], "test": ["flight_2.csv"]},
        "steady_state": {"fitted": True, "samples": 1, "coverage": 1.0},
    })  # fmt: skip
    save_bundle(tmp_path / "run", Bundle(calibration(), record))
    fleet = 'schema = "narxcal.fleet/1"\nflights = "flights"\nrun = "run"\ntail = "(_)"\n'
    (tmp_path / "fleet.toml").write_text(fleet, encoding="utf-8")
    limits = 'schema = "narxcal.limits/1"\naltitude_ft = [0, 1000]\nmach = [0.0, 0.1]\n'
    limits += "climb_ft_min = 1000\nlever = [10, 70]\nlever_per_s = 60\n"
    (tmp_path / "limits.toml").write_text(limits, encoding="utf-8")
    yield tmp_path
    sys.modules.pop("maker", None)


def executed(folder):
    return [str(each) for each in folder.rglob("executed")]


def test_the_list_of_commands_is_whole():
    assert {name.partition(" ")[0] for name in COMMANDS_OF_RUNS} | OTHERS == COMMANDS.keys()


@pytest.mark.parametrize("command", COMMANDS_OF_RUNS)
def test_no_command_executes_what_a_run_names(planted, command, monkeypatch, capsys):
    monkeypatch.chdir(planted)
    places = {
        "RUN": "run", "FLIGHTS": "flights", "LOG": "flights/flight_2.csv", "OUT": "out",
        "OUT.csv": "out.csv", "OUT.pdf": "out.pdf", "FLEET.toml": "fleet.toml",
        "LIMITS.toml": "limits.toml", "OUT.html": "out.html",
    }  # fmt: skip
    given = [places.get(word, word) for word in COMMANDS_OF_RUNS[command]]
    assert main([*command.split(), *given, "--quiet"]) == 2
    assert "would run 'maker:engine' of its configuration" in capsys.readouterr().err
    assert executed(planted) == []


@pytest.mark.parametrize(
    "opened",
    [
        load_bundle,
        narxcal.load_bundle,
        lambda run: open_simulator(str(run)),
        learn_left_out,
    ],
)
def test_no_function_that_opens_a_run_executes_what_it_names(planted, monkeypatch, opened):
    monkeypatch.chdir(planted)
    with pytest.raises(NarxcalError, match="would run 'maker:engine' of its configuration"):
        opened(planted / "run")
    check_bundle(planted / "run")
    read_document(planted / "run")
    assert executed(planted) == []


def test_with_trust_it_opens_and_what_it_names_may_run(planted, monkeypatch):
    monkeypatch.chdir(planted)
    assert load_bundle(planted / "run", trust=True).record.config["steady_state"]["kind"]
