"""Parquet files read like CSV files of the same content."""

import sys

import numpy as np
import pytest

from data_prep.reading import read_logs
from narxcal.support.errors import ConfigError, DataError

pa = pytest.importorskip("pyarrow", reason="the extra 'parquet' is not installed")
parquet = pytest.importorskip("pyarrow.parquet", reason="the extra 'parquet' is not installed")


def write(path, **columns):
    parquet.write_table(pa.table(columns), path)
    return path


def test_a_parquet_file_reads_like_the_csv_of_the_same_numbers(tmp_path):
    time, n1 = np.arange(50) / 10, np.random.default_rng(1).normal(80, 5, 50)
    csv = tmp_path / "log.csv"
    rows = "".join(f"{t!r},{v!r},1\n" for t, v in zip(time.tolist(), n1.tolist(), strict=True))
    csv.write_text("time_s,N1_pct,WOW\n" + rows, encoding="utf-8")
    path = write(tmp_path / "log.parquet", time_s=time, N1_pct=n1, WOW=np.ones(50, bool))
    (left,), (right,) = read_logs(csv), read_logs(path)
    for name in ("N1_pct", "WOW"):
        np.testing.assert_array_equal(left[name], right[name])


def test_nulls_are_missing(tmp_path):
    path = write(tmp_path / "a.parquet", time_s=[0.0, 0.1, 0.2], N1_pct=pa.array([None] * 3, "f8"))
    (log,) = read_logs(path)
    assert log.audit.masked() == {"N1_pct": {"missing": 3}}


def test_dates_and_durations_are_time_stamps_but_no_other_channel(tmp_path):
    for kind, start_s in ((pa.timestamp("ms"), 1.7e9), (pa.duration("us"), 0.0)):
        ticks = 1_000 if kind == pa.timestamp("ms") else 1_000_000
        stamps = pa.array([round((start_s + k / 10) * ticks) for k in range(20)], "i8").cast(kind)
        path = write(tmp_path / "a.parquet", time_s=stamps, N1_pct=np.arange(20.0))
        (log,) = read_logs(path)
        np.testing.assert_allclose(log.time_s, start_s + np.arange(20) / 10, rtol=0, atol=1e-6)
        path = write(tmp_path / "b.parquet", time_s=np.arange(20.0), N1_pct=stamps)
        with pytest.raises(DataError, match="N1_pct: expected a column of numbers, found"):
            read_logs(path)


def test_text_and_damage_are_refused(tmp_path):
    path = write(tmp_path / "a.parquet", time_s=[0.0, 0.1], N1_pct=["x", "y"])
    with pytest.raises(DataError) as caught:
        read_logs(path)
    assert str(caught.value) == (
        f"{path}, channel N1_pct: expected a column of numbers, found string"
    )
    broken = tmp_path / "b.parquet"
    broken.write_bytes(path.read_bytes()[:40])
    with pytest.raises(DataError) as caught:
        read_logs(broken)
    assert str(caught.value) == f"{broken}: the Parquet file is damaged. Copy it again"


def test_without_pyarrow_the_extra_is_named(tmp_path, monkeypatch):
    path = write(tmp_path / "a.parquet", time_s=[0.0, 0.1])
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(ConfigError) as caught:
        read_logs(path)
    assert str(caught.value) == (
        f"{path}: Parquet needs pyarrow. Install it with: pip install 'narxcal[parquet]'"
    )
