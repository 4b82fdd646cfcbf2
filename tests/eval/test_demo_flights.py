"""The demonstration's logs are canonical files that come out the same every time."""

import time

import numpy as np
import pandas as pd

from eval.demo_flights import write_logs
from narxcal.channels import CHANNELS


def test_files_are_canonical_and_on_an_exact_raster(tmp_path):
    (path,) = write_logs(tmp_path, flights=1)
    table = pd.read_csv(path)
    assert path.name == "flight_1.csv"
    assert set(table.columns) <= set(CHANNELS)
    assert np.array_equal(table["time_s"], np.arange(480 * 32) / 32.0)
    assert not table.isna().any(axis=None)


def test_the_same_seed_gives_the_same_bytes_and_another_seed_other_ones(tmp_path):
    first = write_logs(tmp_path / "a", seed=1, flights=2, duration_s=150.0)
    again = write_logs(tmp_path / "b", seed=1, flights=2, duration_s=150.0)
    other = write_logs(tmp_path / "c", seed=2, flights=2, duration_s=150.0)
    assert [p.read_bytes() for p in first] == [p.read_bytes() for p in again]
    assert len({p.read_bytes() for p in (*first, *other)}) == 4


def test_six_flights_take_seconds(tmp_path):
    started = time.process_time()
    assert len(write_logs(tmp_path)) == 6
    assert time.process_time() - started < 15.0
