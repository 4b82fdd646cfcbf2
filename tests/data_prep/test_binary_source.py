"""Parquet, MATLAB, HDF5 and MDF files give the bits of their CSV twin."""

import sys

import numpy as np
import pytest
from scipy.io import savemat

from data_prep.config import LogsConfig
from data_prep.reading import read_logs
from narxcal.support.errors import ConfigError, DataError, NarxcalError

RNG = np.random.default_rng(3)
TIME_S = np.arange(200) / 4
VALUES = {
    "N1": 80.0 + RNG.normal(0.0, 1.0, 200),
    "EGT": np.where(np.arange(200) % 50 == 7, np.nan, 600.0 + RNG.normal(0.0, 5.0, 200)),
    "ALT": 1000.0 + np.arange(50.0),
}
CONFIG = LogsConfig.parse(
    {
        "columns": {
            "time_s": {"column": "t"},
            "N1_pct": {"column": "N1"},
            "EGT_C": {"column": "EGT"},
            "ALT_ft": {"column": "ALT"},
        }
    }
)
EVERY_ROW = {
    **VALUES,
    "ALT": np.where(np.arange(200) % 4 == 0, np.repeat(VALUES["ALT"], 4), np.nan),
}
UNITS = {"N1": "%", "EGT": "K", "ALT": "m"}


def twin(folder, units):
    """The same as CSV: each number with all its digits, blank where there is none."""
    path = folder / "twin.csv"
    rows = zip(TIME_S, *(EVERY_ROW[name] for name in ("N1", "EGT", "ALT")), strict=True)
    cells = [",".join("" if np.isnan(each) else repr(float(each)) for each in row) for row in rows]
    below = ["s,%,K,m"] if units else []
    path.write_text("\n".join(["t,N1,EGT,ALT", *below, *cells]) + "\n", "utf-8")
    return path


def plain(path):
    savemat(path, {"t": TIME_S, **{name: each[:, None] for name, each in EVERY_ROW.items()}})


def rated(path):
    rates = {"N1": 4.0, "EGT": 4.0, "ALT": 1.0}
    savemat(
        path,
        {
            name: {"data": each, "Rate": rates[name], "Units": UNITS[name], "Description": name}
            for name, each in VALUES.items()
        },
    )


def hdf5(path):
    h5py = pytest.importorskip("h5py")
    with h5py.File(path, "w") as file:
        file["t"] = TIME_S
        for name, each in EVERY_ROW.items():
            file[name] = each[None, :]
            file[name].attrs["units"] = UNITS[name]


def matlab_73(path):
    """The layout of MATLAB's own file: 512 bytes of text before HDF5, text as numbers."""
    h5py = pytest.importorskip("h5py")
    rates = {"N1": 4.0, "EGT": 4.0, "ALT": 1.0}
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, each in VALUES.items():
            group = file.create_group(name)
            group["data"], group["Rate"] = each[None, :], [[rates[name]]]
            group["Units"] = np.array([[ord(letter)] for letter in UNITS[name]], dtype=np.uint16)
            group["Units"].attrs["MATLAB_class"] = np.bytes_("char")
    with path.open("r+b") as raw:
        raw.write(b"MATLAB 7.3 MAT-file".ljust(512))


def matrix(path):
    """The layout of N-CMAPSS: matrices, each with another one of the names of its columns."""
    h5py = pytest.importorskip("h5py")
    with h5py.File(path, "w") as file:
        file["A_dev"], file["A_var"] = TIME_S[:, None], np.array([b"t"])
        file["X_s_dev"] = np.column_stack(list(EVERY_ROW.values()))
        file["X_s_var"] = np.array([name.encode() for name in EVERY_ROW])


def mdf(path):
    """Groups with stamps of their own, as a test cell writes them."""
    asammdf = pytest.importorskip("asammdf")
    with asammdf.MDF(version="4.10") as file:
        for name, each in VALUES.items():
            stamps = TIME_S if len(each) == len(TIME_S) else TIME_S[::4]
            file.append([asammdf.Signal(each, stamps, unit=UNITS[name], name=name)])
        file.save(path.with_suffix(".mf4"), overwrite=True)
    path.with_suffix(".mf4").rename(path)


def table(path, **columns):
    """A Parquet file; the arrays are doubles, blank ones null."""
    pa = pytest.importorskip("pyarrow", reason="the extra 'parquet' is not installed")
    parquet = pytest.importorskip("pyarrow.parquet")
    columns = columns or {"t": TIME_S, **EVERY_ROW}
    own = {name: pa.array(each, from_pandas=True) for name, each in columns.items()}
    parquet.write_table(pa.table(own), path)
    return path


@pytest.mark.parametrize(
    ("write", "units"),
    [(plain, False), (rated, True), (hdf5, True), (matlab_73, True), (matrix, False), (mdf, True),
     (table, False)],
)  # fmt: skip
def test_a_file_of_arrays_is_read_as_its_twin(tmp_path, write, units):
    path = tmp_path / "log.mat"
    write(path)
    (log,) = read_logs(path, CONFIG)
    (same,) = read_logs(twin(tmp_path, units), CONFIG)
    np.testing.assert_array_equal(log.time_s, same.time_s)
    for name in ("N1_pct", "EGT_C", "ALT_ft"):
        np.testing.assert_array_equal(log[name], same[name])
    assert log.interpolated.keys() == same.interpolated.keys() == {"ALT_ft"}


def error_of(path):
    with pytest.raises(NarxcalError) as caught:
        read_logs(path, CONFIG)
    return str(caught.value).replace(str(path), "FILE")


def test_arrays_without_time_or_rates_ask_for_them(tmp_path):
    savemat(tmp_path / "log.mat", {"clock": TIME_S, **EVERY_ROW})
    assert error_of(tmp_path / "log.mat") == (
        "FILE, channel time_s: the file has no column 't', and its channels have no rates. "
        "Name the column of time: clock, N1, EGT, ALT"
    )


def test_rates_that_do_not_divide_are_refused(tmp_path):
    rates = {"N1": 4.0, "EGT": 4.0, "ALT": 3.0}
    each = {name: {"data": VALUES[name], "Rate": rate} for name, rate in rates.items()}
    savemat(tmp_path / "log.mat", each)
    assert error_of(tmp_path / "log.mat") == (
        "FILE, channel ALT: a rate of 3 Hz does not divide that of 4 Hz of another column. "
        "Write the columns that do to a file of their own"
    )


def test_columns_of_different_lengths_and_damaged_files_are_refused(tmp_path):
    path = tmp_path / "log.mat"
    savemat(path, {"t": TIME_S, **VALUES})
    assert error_of(path) == (
        "FILE: columns of one table differ in rows: t 200, N1 200, EGT 200, ALT 50"
    )
    savemat(path, {"t": TIME_S, **VALUES, "N1": VALUES["N1"] + 1j})
    assert error_of(path) == "FILE, channel N1: expected a column of numbers, found complex128"
    path.write_bytes(path.read_bytes()[:2000])
    assert "FILE: the file cannot be read (" in error_of(path)
    savemat(path, {"name": "a text"})
    assert error_of(path) == "FILE: the file holds no columns of numbers"


def test_nulls_are_missing_and_flags_are_numbers(tmp_path):
    channels = {"N1_pct": np.full(3, np.nan), "WOW": np.ones(3, dtype=bool)}
    (log,) = read_logs(table(tmp_path / "a.parquet", time_s=[0.0, 0.1, 0.2], **channels))
    assert log.audit.masked() == {"N1_pct": {"missing": 3}}
    np.testing.assert_array_equal(log["WOW"], 1.0)


def test_dates_and_durations_are_time_stamps_but_no_other_channel(tmp_path):
    pa = pytest.importorskip("pyarrow", reason="the extra 'parquet' is not installed")
    for kind, start_s in ((pa.timestamp("ms"), 1.7e9), (pa.duration("us"), 0.0)):
        ticks = 1_000 if kind == pa.timestamp("ms") else 1_000_000
        stamps = pa.array([round((start_s + k / 10) * ticks) for k in range(20)], "i8").cast(kind)
        path = table(tmp_path / "a.parquet", time_s=stamps, N1_pct=np.arange(20.0))
        (log,) = read_logs(path)
        np.testing.assert_allclose(log.time_s, start_s + np.arange(20) / 10, rtol=0, atol=1e-6)
        path = table(tmp_path / "b.parquet", time_s=np.arange(20.0), N1_pct=stamps)
        with pytest.raises(DataError, match="N1_pct: expected a column of numbers, found"):
            read_logs(path)


def test_text_and_damage_are_refused(tmp_path):
    path = table(tmp_path / "a.parquet", time_s=[0.0, 0.1], N1_pct=["x", "y"])
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
    path = table(tmp_path / "a.parquet", time_s=[0.0, 0.1])
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(ConfigError) as caught:
        read_logs(path)
    assert str(caught.value) == (
        f"{path}: Parquet needs pyarrow. Install it with: pip install 'narxcal[parquet]'"
    )
