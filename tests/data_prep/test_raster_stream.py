"""Rows put on the raster as they come are those of the whole file put on the raster at once."""

import tomllib
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from data_prep.config import LogsConfig
from data_prep.reading import read_logs
from data_prep.stream import RasterStream
from eval.stream import CsvStream, Pace

ROOT = Path(__file__).parents[2]
DATA = ROOT / "../shared/data"


def streamed(path, config, dt_s, lines=4096, look_ahead_s=5.0):
    """Parts of the log of the first engine: time and channels of each recording."""
    stream = CsvStream(path, config, Pace(lines=lines))
    engine = stream.engines[0]
    raster = RasterStream(config, dt_s, look_ahead_s, str(path), stream.constants)
    pieces = [piece for block in stream.blocks([engine]) for piece in raster.push(block[engine])]
    pieces += raster.push({}, last=True)
    starts = [i for i, piece in enumerate(pieces) if piece.starts] + [len(pieces)]
    groups = [pieces[a:b] for a, b in pairwise(starts)]
    return [
        (
            np.concatenate([piece.time_s for piece in group]),
            {
                name: np.concatenate([piece.channels[name] for piece in group])
                for name in group[0].channels
            },
        )
        for group in groups
    ]


def assert_same(parts, logs, rtol=1e-7):
    assert len(parts) == len(logs)
    for (time_s, channels), log in zip(parts, logs, strict=True):
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
    # Stamps that lie 1.000 % of an interval off the raster may be taken for on it by one of both.
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
    [(_, channels)] = streamed(log, LogsConfig(), 0.1, lines=50)
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
