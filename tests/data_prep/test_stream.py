"""Rows put on the grid as they come are those of the whole file put on the grid at once."""

import tomllib
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from data_prep.config import LogsConfig
from data_prep.reading import read_logs
from data_prep.sources import log_file
from data_prep.sources.csv_source import Pace
from data_prep.sources.log_file import LogFile

ROOT = Path(__file__).parents[2]
DATA = ROOT / "../shared/data"


def streamed(path, config, dt_s, lines=4096, look_ahead_s=5.0):
    """Parts of the log of the first engine: time, channels and audit of each recording."""
    file = LogFile(path, config)
    engine = file.engines[0]
    stream = file.stream(dt_s, look_ahead_s)
    pieces, audits = [], []
    blocks = (block[engine] for block in file.blocks([engine], Pace(lines=lines)))
    for rows, last in [*((rows, False) for rows in blocks), ({}, True)]:
        for piece in stream.push(rows, last=last):
            if piece.starts and pieces:
                audits.append(stream.ended)
            pieces.append(piece)
    audits.append(stream.audit.taken())
    starts = [i for i, piece in enumerate(pieces) if piece.starts] + [len(pieces)]
    groups = [pieces[a:b] for a, b in pairwise(starts)]
    return [
        (
            np.concatenate([piece.time_s for piece in group]),
            {
                name: np.concatenate([piece.channels[name] for piece in group])
                for name in group[0].channels
            },
            audit,
        )
        for group, audit in zip(groups, audits, strict=True)
    ]


def assert_same(parts, logs, rtol=1e-7):
    assert len(parts) == len(logs)
    for (time_s, channels, _), log in zip(parts, logs, strict=True):
        np.testing.assert_allclose(time_s, log.time_s, atol=1e-9)
        assert channels.keys() == log.channels.keys()
        for name, values in log.channels.items():
            scale = max(1e-6, float(np.nanmax(np.abs(values)))) if np.isfinite(values).any() else 1
            np.testing.assert_allclose(
                channels[name], values, rtol=rtol, atol=rtol * scale, err_msg=name
            )


def write(path, columns):
    rows = zip(*columns.values(), strict=True)
    path.write_text("\n".join([",".join(columns), *map(",".join, rows)]) + "\n", encoding="utf-8")
    return path


def texts(values, form="{:.6g}"):
    return ["" if np.isnan(value) else form.format(value) for value in values]


FLIGHTS = [
    ("flights/citation_20180312_flight1.csv.gz", "citation2", 0.1),
    ("flights/citation_20190312_flight2.csv.gz", "citation2", 0.1),
    ("flights/jetcat_p300_20230109_120101.csv.gz", "jetcat", None),
    ("agtf30/flight_1.csv.gz", "agtf30", 1 / 32),
]


@pytest.mark.parametrize(("name", "settings_name", "dt_s"), FLIGHTS)
def test_measured_flights_come_out_as_read_at_once(name, settings_name, dt_s):
    path = DATA / name
    config_file = ROOT / "configs" / f"{settings_name}.toml"
    if not path.is_file() or not config_file.is_file():
        pytest.skip(f"{name} or its configuration is not there")
    config = LogsConfig.parse(tomllib.loads(config_file.read_text(encoding="utf-8"))["logs"])
    logs = read_logs(path, config)
    first = [log for log in logs if log.source.engine == logs[0].source.engine]
    # Stamps that lie 1.000 % of an interval off the grid may be taken for on it by one of both.
    rtol = 1e-4 if settings_name == "jetcat" else 1e-7
    assert_same(streamed(path, config, dt_s or first[0].dt_s), first, rtol)


@pytest.mark.parametrize("rate", [10.0, 25.0])
@pytest.mark.parametrize(("seed", "lines"), [(0, 1), (1, 7), (2, 50), (3, 400)])
def test_blanks_and_other_rates_give_the_batch_however_the_rows_arrive(tmp_path, rate, seed, lines):
    rng = np.random.default_rng(seed)
    samples = 300
    time_s = np.arange(samples) / 16.0
    n2 = 70.0 + 5.0 * np.sin(time_s)
    n2[rng.random(samples) < 0.1 * seed] = np.nan
    slow = np.where(np.arange(samples) % 8 == 0, 1000.0 + time_s, np.nan)  # twice a second
    switch = np.where(np.arange(samples) % 100 == 50, (time_s > 8.0) * 1.0, np.nan)
    columns = {"time_s": time_s, "N2_pct": n2, "ALT_ft": slow, "WOW": switch}
    log = write(tmp_path / "log.csv", {k: texts(v, "{:.9f}") for k, v in columns.items()})
    config = LogsConfig(raster_hz=rate)
    assert_same(streamed(log, config, 1.0 / rate, lines), read_logs(log, config), rtol=1e-6)


@pytest.mark.parametrize("digits", ["{:.5g}", "{:.2f}", "{:.6f}"])
def test_stamps_printed_with_few_digits_are_put_right_as_in_the_batch(tmp_path, digits):
    time_s = np.arange(40_000) / 32.0
    columns = {"time_s": texts(time_s, digits), "N2_pct": texts(60.0 + np.sin(time_s))}
    log = write(tmp_path / "log.csv", columns)
    logs = read_logs(log)
    assert len(logs[0]) == 40_000
    assert_same(streamed(log, LogsConfig(), 1 / 32), logs)


def test_gaps_split_and_lone_rows_between_them_are_dropped(tmp_path):
    time_s = np.concatenate([np.arange(100), [200.0], np.arange(300, 400)]) * 0.1
    columns = {"time_s": texts(time_s), "N2_pct": texts(time_s)}
    log = write(tmp_path / "log.csv", columns)
    config = LogsConfig(raster_hz=10.0)
    for lines in (1, 30, 4096):
        assert_same(streamed(log, config, 0.1, lines), read_logs(log, config))


def test_a_switch_stands_where_it_was_put_long_ago(tmp_path):
    time_s = np.arange(3000) * 0.1
    weight = np.where(time_s == 5.0, 1.0, np.nan)
    columns = {"time_s": texts(time_s), "WOW": texts(weight), "N2_pct": texts(time_s)}
    log = write(tmp_path / "log.csv", columns)
    [(_, channels, _)] = streamed(log, LogsConfig(), 0.1, lines=50)
    assert np.isnan(channels["WOW"][:50]).all()
    assert (channels["WOW"][50:] == 1.0).all()


def test_weight_on_wheels_remembers_within_its_hysteresis_between_blocks(tmp_path):
    time_s = np.arange(600) * 0.1
    speed = np.interp(time_s, [0.0, 10.0, 20.0, 60.0], [0.0, 100.0, 65.0, 65.0])
    columns = {"time_s": texts(time_s), "CAS_kt": texts(speed), "N2_pct": texts(time_s)}
    log = write(tmp_path / "log.csv", columns)
    config = LogsConfig.parse({"derive": {"WOW": {}}})
    logs = read_logs(log, config)
    assert logs[0]["WOW"][-1] == 0.0
    for lines in (1, 50):
        assert_same(streamed(log, config, 0.1, lines, look_ahead_s=0.0), logs)


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


def entries(audit):
    return {
        (entry.channel, entry.action, entry.reason): (entry.samples, entry.spans_s)
        for entry in audit.entries
    }


def assert_same_audit(found, expected):
    found, expected = entries(found), entries(expected)
    assert found.keys() == expected.keys()
    for key, (samples, spans) in expected.items():
        assert found[key][0] == samples, key
        np.testing.assert_allclose(found[key][1], spans, atol=1e-6)


@pytest.mark.parametrize("lines", [pytest.param(1, marks=pytest.mark.slow), 7, 4096, 100_000])
@pytest.mark.parametrize("raster_hz", [20.0, 8.0])
def test_samples_and_audit_are_those_of_the_whole_for_any_block(tmp_path, lines, raster_hz):
    path, config = faulty(tmp_path / "log.csv"), LogsConfig(raster_hz=raster_hz)
    logs = read_logs(path, config)
    parts = streamed(path, config, 1.0 / raster_hz, lines)
    assert_same(parts, logs)
    for (_, _, audit), log in zip(parts, logs, strict=True):
        assert_same_audit(audit, log.audit)


@pytest.mark.parametrize("cells", [200, 3000])
@pytest.mark.parametrize("raster_hz", [None, 8.0])
def test_a_file_larger_than_a_block_gives_the_same_logs(tmp_path, monkeypatch, cells, raster_hz):
    path, config = faulty(tmp_path / "log.csv"), LogsConfig(raster_hz=raster_hz)
    whole = read_logs(path, config)
    monkeypatch.setattr(log_file, "BLOCK_CELLS", cells)
    monkeypatch.setattr(
        Pace.__init__, "__kwdefaults__", {**Pace.__init__.__kwdefaults__, "lines": 40}
    )
    found = read_logs(path, config)
    assert [log.name for log in found] == [log.name for log in whole] == ["log.csv", "log.csv#2"]
    assert_same([(log.time_s, log.channels, log.audit) for log in found], whole)
    for log, expected in zip(found, whole, strict=True):
        assert log.source == expected.source
        assert_same_audit(log.audit, expected.audit)
