"""Four short data sets of the stand-in engine with their truth, read once for all tests."""

from pathlib import Path

import pandas as pd
import pytest

from eval.reproduce.data_sets import read_data_sets
from eval.reproduce.effort import Effort
from narxcal.standin import INPUT_NAMES, StandInEngine
from narxcal.standin_pilot import fly
from training.config import RunConfig

RATE_HZ = 8.0
INPUTS = list(INPUT_NAMES)


def write(folder, number, seed, *, truth=True):
    """One flight as `data_set_NN.csv`, and its outputs without sensors beside it."""
    flight = fly(seed, 150.0, RATE_HZ)
    name = f"data_set_{number:02d}.csv"
    Path(folder).mkdir(parents=True, exist_ok=True)
    pd.DataFrame(flight).to_csv(folder / name, index=False, float_format="%.8g")
    if truth:
        (folder / "truth").mkdir(exist_ok=True)
        clean = StandInEngine().simulate({key: flight[key] for key in INPUTS}, 1.0 / RATE_HZ)
        table = pd.DataFrame({"time_s": flight["time_s"], **clean})
        table.to_csv(folder / "truth" / name, index=False, float_format="%.8g")


def configured(folder, **sections):
    table = {
        "schema": "narxcal.config/1",
        "logs": {"folder": str(folder), "files": ["data_set_*.csv"], "raster_hz": RATE_HZ},
        "smooth": {"window": 3},
        "split": {"train": ["*"], "test": ["data_set_04*", "take_off_approach/*_02*"]},
        "narx": {"hidden": 2, "lags": 1},
        "train": {"horizons_s": [5.0, 30.0], "iterations": [1, 1], "local_trim": False},
        "steady_state": {
            "kind": "callable", "source": "narxcal.standin:maker_model", "inputs": INPUTS,
        },
        **sections,
    }  # fmt: skip
    return RunConfig.parse(table)


@pytest.fixture(scope="session")
def flights(tmp_path_factory):
    """A folder of four data sets and of two further records."""
    folder = tmp_path_factory.mktemp("sets")
    for number in range(1, 5):
        write(folder, number, number)
    for number in (1, 2):
        write(folder / "take_off_approach", number, 10 + number, truth=False)
    return folder


@pytest.fixture(scope="session")
def data(flights):
    return read_data_sets(configured(flights), Path())


@pytest.fixture(scope="session")
def effort():
    return Effort((1, 1), 2, 1)


@pytest.fixture
def write_set():
    return write


@pytest.fixture
def make_config():
    return configured
