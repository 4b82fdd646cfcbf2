"""A large file read block by block gives the logs, and the audit, of one read at once."""

import tomllib
from pathlib import Path

import numpy as np
import pytest

from data_prep import reading as large
from data_prep.config import LogsConfig
from data_prep.csv_source import CsvSource
from data_prep.reading import read_logs
from narxcal.support.errors import DataError

ROOT = Path(__file__).parents[2]
FLIGHTS = ROOT / "../shared/data/flights"


@pytest.fixture
def in_blocks(monkeypatch):
    """Reads as if every file were large; blocks of so many rows."""

    def read(path, config=None, rows=97):
        monkeypatch.setattr(large, "LARGE_BYTES", 0)
        monkeypatch.setattr(CsvSource.__init__, "__defaults__", (rows,))
        return read_logs(path, config)

    return read


def write(path, columns):
    rows = zip(*columns.values(), strict=True)
    path.write_text("\n".join([",".join(columns), *map(",".join, rows)]) + "\n", encoding="utf-8")
    return path


def texts(values, form="{:.6g}"):
    return ["" if np.isnan(value) else form.format(value) for value in values]


def faulty(path):
    """Two recordings of a fast channel with all kinds of faults, and a slow one."""
    rng = np.random.default_rng(0)
    time_s = np.concatenate([np.arange(1500), 4000 + np.arange(800)]) / 20.0
    n2 = 70.0 + np.sin(time_s)
    n2[300:360] = np.nan
    n2[rng.random(len(n2)) < 0.02] = np.nan
    n2[700] = np.inf
    slow = np.where(np.arange(len(time_s)) % 10 == 0, 1000.0 + time_s, np.nan)
    stamps = texts(time_s, "{:.3f}")
    stamps[40] = ""
    stamps[500], stamps[501] = stamps[501], stamps[500]
    stamps[900] = stamps[899]
    stamps[1200] = "99999"
    return write(path, {"time_s": stamps, "N2_pct": texts(n2, "{:.9f}"), "ALT_ft": texts(slow)})


def entries(log):
    return {
        (entry.channel, entry.action, entry.reason): (entry.samples, entry.spans_s)
        for entry in log.audit.entries
    }


@pytest.mark.parametrize("rows", [97, 400, 50_000])
@pytest.mark.parametrize("raster_hz", [None, 8.0])
def test_logs_and_audit_are_those_of_the_whole(tmp_path, in_blocks, rows, raster_hz):
    path, config = faulty(tmp_path / "log.csv"), LogsConfig(raster_hz=raster_hz)
    whole = read_logs(path, config)
    found = in_blocks(path, config, rows)
    assert [log.name for log in found] == [log.name for log in whole] == ["log.csv", "log.csv#2"]
    for log, expected in zip(found, whole, strict=True):
        np.testing.assert_allclose(log.time_s, expected.time_s, atol=1e-9)
        for name, values in expected.channels.items():
            np.testing.assert_allclose(log[name], values, rtol=1e-7, err_msg=name)
        assert log.source == expected.source
        for key, (samples, spans) in entries(expected).items():
            assert entries(log)[key][0] == samples, key
            np.testing.assert_allclose(entries(log)[key][1], spans, atol=1e-6)
        assert entries(log).keys() == entries(expected).keys()


@pytest.mark.parametrize("engine", ["left", "right"])
def test_a_measured_flight_is_the_same_in_blocks(in_blocks, engine):
    path = FLIGHTS / "citation_20180312_flight1.csv.gz"
    if not path.is_file():
        pytest.skip("the Citation flights are not there")
    text = (ROOT / "configs/citation2.toml").read_text(encoding="utf-8")
    config = LogsConfig.parse(tomllib.loads(text)["logs"])
    whole, found = read_logs(path, config), in_blocks(path, config, 20_000)
    [log] = [log for log in found if log.source.engine == engine]
    [expected] = [log for log in whole if log.source.engine == engine]
    for name, values in expected.channels.items():
        np.testing.assert_allclose(log[name], values, rtol=1e-6, atol=1e-9, err_msg=name)
    assert log.audit.masked() == expected.audit.masked()


def test_text_far_down_is_named_with_its_row(tmp_path, in_blocks):
    values = texts(60.0 + np.arange(500.0))
    values[400] = "off"
    path = write(tmp_path / "log.csv", {"time_s": texts(0.1 * np.arange(500)), "N2_pct": values})
    with pytest.raises(DataError) as error:
        in_blocks(path)
    assert str(error.value) == (
        f"{path}, channel N2_pct, row 401: expected a number, found 'off'. "
        "Correct it or leave it blank; row 1 is the first data row below the header"
    )


def test_a_decimal_comma_that_comes_late_is_seen(tmp_path, in_blocks):
    path = tmp_path / "log.csv"
    values = [*map(str, range(300)), *(f"{k},5" for k in range(300))]
    rows = (f"{k};{value}" for k, value in enumerate(values))
    path.write_text("\n".join(["time_s;N2_pct", *rows]) + "\n", encoding="utf-8")
    [log] = in_blocks(path)
    assert log["N2_pct"].tolist() == read_logs(path)[0]["N2_pct"].tolist()
    assert log["N2_pct"][300:302].tolist() == [0.5, 1.5]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("time_s,N2_pct\n", "no rows follow the header"),
        ("time_s,N2_pct\n0,1\n100,1\n200,1\n", "no two samples are closer than max_gap_s = 2 s"),
    ],
)
def test_a_file_without_a_log_is_refused(tmp_path, in_blocks, text, message):
    path = tmp_path / "log.csv"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(DataError, match=message):
        in_blocks(path)


def test_a_wrong_unit_of_time_does_not_fill_the_memory(tmp_path, in_blocks):
    columns = {"time_s": texts(1.5 * np.arange(50.0)), "N2_pct": texts(np.arange(50.0))}
    path = write(tmp_path / "log.csv", columns)
    with pytest.raises(DataError, match=r"rows 1.5 s apart would become samples at 1000 Hz"):
        in_blocks(path, LogsConfig(raster_hz=1000.0))


def test_small_files_and_long_bridges_are_read_at_once(tmp_path):
    path = tmp_path / "log.csv"
    path.write_bytes(b"0" * 1000)
    assert not large.is_large(path, LogsConfig())
    with path.open("wb") as sparse:
        sparse.truncate(large.LARGE_BYTES + 1)
    assert large.is_large(path, LogsConfig())
    assert not large.is_large(path, LogsConfig(bridge_s=20.0))
