"""Four short data sets of the virtual engine with their truth, read once for all tests."""

from pathlib import Path

import pytest

from eval.reproduce.data import Effort, read_data_sets
from training.config import RunConfig

RATE_HZ = 8.0


@pytest.fixture(scope="session")
def write_set(piece):
    """Write a data set and, where wanted, its truth."""

    def write(folder, number, seed, *, truth=True):
        """One flight as `data_set_NN.csv`, and its outputs without sensors next to it."""
        flight, name = piece(seed), f"data_set_{number:02d}.csv"
        Path(folder).mkdir(parents=True, exist_ok=True)
        flight.to_csv(folder / name)
        if truth:
            (folder / "truth").mkdir(exist_ok=True)
            flight.true_to_csv(folder / "truth" / name)

    return write


@pytest.fixture(scope="session")
def make_config(maker_table):
    """A configuration of the logs in a folder; sections may be given."""

    def configured(folder, **sections):
        return RunConfig.parse(plain(folder) | {"steady_state": maker_table} | sections)

    return configured


def plain(folder):
    return {
        "schema": "narxcal.config/1",
        "logs": {"folder": str(folder), "files": ["data_set_*.csv"], "raster_hz": RATE_HZ},
        "smooth": {"window": 3},
        "split": {"train": ["*"], "test": ["data_set_04*", "take_off_approach/*_02*"]},
        "narx": {"hidden": 2, "lags": 1, "lag_limits": False},
        "train": {"horizons_s": [5.0, 30.0], "iterations": [1, 1], "local_trim": False,
                  "choice_s": 0.0},
    }  # fmt: skip


@pytest.fixture(scope="session")
def flights(tmp_path_factory, write_set):
    """A folder of four data sets and of two further records."""
    folder = tmp_path_factory.mktemp("sets")
    for number in range(1, 5):
        write_set(folder, number, number)
    for number in (1, 2):
        write_set(folder / "take_off_approach", number, 10 + number, truth=False)
    return folder


@pytest.fixture(scope="session")
def data(flights, make_config):
    return read_data_sets(make_config(flights), Path())


@pytest.fixture(scope="session")
def effort():
    return Effort((1, 1), 1, 1)
