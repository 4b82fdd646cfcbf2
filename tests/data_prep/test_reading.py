"""The public door: files in, logs on a grid out, every changed sample accounted for."""

import gzip
import hashlib
import re
import tomllib
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from data_prep.config import LogsConfig
from data_prep.reading import read_logs, shared_interval_s
from data_prep.sources import units
from narxcal.support.errors import ConfigError, DataError, NarxcalError

ROOT = Path(__file__).parents[2]


def write(folder, text, name="log.csv"):
    path = Path(folder) / name
    path.write_text(text, encoding="utf-8")
    return path


def table(time, **channels):
    rows = [",".join(["time_s", *channels])]
    rows += [
        ",".join("" if np.isnan(cell) else repr(float(cell)) for cell in row)
        for row in zip(time, *channels.values(), strict=True)
    ]
    return "\n".join(rows) + "\n"


def counts(log, channel):
    return {
        (each.action, each.reason): each.samples
        for each in log.audit.entries
        if each.channel == channel
    }


def error_of(path, config=None):
    with pytest.raises(NarxcalError) as caught:
        read_logs(path, config)
    return str(caught.value).replace(str(path), "FILE")


def shipped(name):
    path = ROOT / "configs" / f"{name}.toml"
    config = LogsConfig.parse(tomllib.loads(path.read_text(encoding="utf-8"))["logs"], path)
    if not (path.parent / config.folder).is_dir():
        pytest.skip("the shared recordings are not beside this checkout")
    return config, config.resolve(path.parent)


def test_samples_on_the_grid_are_taken_over_bit_for_bit(tmp_path):
    rng = np.random.default_rng(1)
    time, n1 = np.arange(200) / 32, rng.normal(80, 5, 200)
    path = write(tmp_path, table(time, N1_pct=n1))
    (log,) = read_logs(path)
    assert log.name == "log.csv"
    assert log.dt_s == 1 / 32
    np.testing.assert_array_equal(log["N1_pct"], n1)
    assert log.audit.entries == ()
    assert log.source.sha256 == hashlib.sha256(path.read_bytes()).hexdigest()


def test_jittered_samples_are_interpolated_without_phase_shift(tmp_path):
    rng = np.random.default_rng(2)
    time = np.arange(2000) * 0.1 + rng.uniform(-0.03, 0.03, 2000)
    path = write(tmp_path, table(time, N1_pct=80 + 5 * np.sin(time)))
    (log,) = read_logs(path)
    assert log.dt_s == pytest.approx(0.1)
    # Curvature bound of a straight line over at most 0.16 s: 5 * 0.16^2 / 8.
    np.testing.assert_allclose(log["N1_pct"], 80 + 5 * np.sin(log.time_s), atol=0.016)


def test_stamps_printed_with_five_digits_get_their_even_spacing_back(tmp_path):
    exact = np.arange(36000) / 32
    time = np.array([float(f"{each:.5g}") for each in exact])
    n1 = np.random.default_rng(3).normal(80, 5, len(time))
    (log,) = read_logs(write(tmp_path, table(time, N1_pct=n1)))
    np.testing.assert_array_equal(log.time_s, exact)
    np.testing.assert_array_equal(log["N1_pct"], n1)
    assert counts(log, "*").keys() == {("repaired", "rounded time stamp")}


def test_a_fast_recording_is_averaged_onto_a_slower_grid_without_shift(tmp_path):
    time = np.arange(3200) / 320
    path = write(tmp_path, table(time, N1_pct=80 + time))
    (log,) = read_logs(path, LogsConfig(raster_hz=32.0))
    np.testing.assert_allclose(log["N1_pct"], 80 + log.time_s, rtol=1e-12)
    assert counts(log, "N1_pct") == {("repaired", "averaged: faster than the grid"): len(log)}


def test_files_of_different_rates_share_the_median_interval(tmp_path):
    steps = {"one.csv": 0.1046, "two.csv": 0.107, "three.csv": 0.1063}
    paths = [
        write(tmp_path, table(step * np.arange(400), N1_pct=np.full(400, 50.0)), name)
        for name, step in steps.items()
    ]
    found = shared_interval_s(read_logs(paths))
    assert found == pytest.approx(0.1063, rel=1e-3)
    assert shared_interval_s(read_logs(paths, LogsConfig().every(found))) is None


def test_a_slower_channel_is_bridged_between_its_own_samples(tmp_path):
    time = np.arange(201) * 0.1
    slow = np.where(np.arange(201) % 10 == 0, 1000 + 10 * time, np.nan)
    (log,) = read_logs(write(tmp_path, table(time, N1_pct=80 + time, ALT_ft=slow)))
    np.testing.assert_allclose(log["ALT_ft"], 1000 + 10 * time)
    assert counts(log, "ALT_ft") == {("filled", "slower than the grid"): 180}


def test_short_blanks_are_filled_and_long_ones_stay_missing(tmp_path):
    time = np.arange(100) * 0.1
    n1 = 80 + time
    n1[10:13] = np.nan
    n1[40:70] = np.nan
    (log,) = read_logs(write(tmp_path, table(time, N1_pct=n1, N2_pct=80 + time)))
    np.testing.assert_allclose(log["N1_pct"][:40], 80 + time[:40])
    assert np.isnan(log["N1_pct"][40:70]).all()
    assert counts(log, "N1_pct") == {("filled", "blank"): 3, ("masked", "missing"): 30}
    (masked,) = [each for each in log.audit.entries if each.action == "masked"]
    assert masked.spans_s[0] == pytest.approx((4.0, 6.9))


def test_a_switch_keeps_its_last_value(tmp_path):
    time = np.arange(10) * 0.1
    wow = np.full(10, np.nan)
    wow[[1, 6]] = 1.0, 0.0
    (log,) = read_logs(write(tmp_path, table(time, N1_pct=time, WOW=wow)))
    np.testing.assert_array_equal(log["WOW"], [np.nan, 1, 1, 1, 1, 1, 0, 0, 0, 0])


def test_an_empty_channel_is_missing_not_an_error(tmp_path):
    time = np.arange(10) * 0.1
    (log,) = read_logs(write(tmp_path, table(time, N1_pct=time, N2_pct=np.full(10, np.nan))))
    assert log.audit.masked() == {"N2_pct": {"missing": 10}}


def test_late_and_repeated_rows_are_put_right_and_counted(tmp_path):
    time = np.array([0.0, 0.1, 0.3, 0.2, 0.4, 0.4, 0.5, 0.6])
    n1 = np.array([0.0, 1.0, 3.0, 2.0, 9.0, 4.0, 5.0, 6.0])
    (log,) = read_logs(write(tmp_path, table(time, N1_pct=n1)), LogsConfig(raster_hz=10.0))
    np.testing.assert_array_equal(log["N1_pct"], np.arange(7.0))
    assert counts(log, "*") == {("repaired", "out of order"): 1}
    assert counts(log, "N1_pct") == {("dropped", "duplicate time stamp"): 1}


def test_rows_without_a_sound_stamp_are_dropped_and_counted(tmp_path):
    time = np.arange(20) * 0.1
    time[5], time[12] = np.nan, 1e6
    (log,) = read_logs(write(tmp_path, table(time, N1_pct=np.arange(20.0))))
    np.testing.assert_allclose(log["N1_pct"], np.arange(20.0))
    assert counts(log, "*") == {
        ("dropped", "no time stamp"): 1,
        ("dropped", "lone wrong time stamp"): 1,
    }


def test_a_gap_splits_the_log_and_nothing_is_filled_across_it(tmp_path):
    time = np.concatenate([np.arange(50) * 0.1, 60 + np.arange(30) * 0.1])
    first, second = read_logs(write(tmp_path, table(time, N1_pct=time)))
    assert (first.name, len(first)) == ("log.csv", 50)
    assert (second.name, len(second), second.time_s[0]) == ("log.csv#2", 30, 60.0)


def test_each_engine_becomes_a_log_in_canonical_units(tmp_path):
    config = LogsConfig.parse(
        {
            "engines": {"left": "l_", "right": "r_"},
            "columns": {
                "time_s": {"column": "t", "unit": "ms"},
                "FF_kgph": {"column": "{engine}ff", "unit": "lb/h"},
                "N1_pct": {"column": "{engine}rpm", "scale": 0.01},
                "EGT_C": {"column": "{engine}itt", "unit": "K", "optional": True},
                "ALT_ft": {"constant": 0.0},
                "SAT_C": {"column": "oat", "unit": "degF"},
            },
        }
    )
    rows = "".join(f"{100 * k},100,200,7000,8000,59\n" for k in range(5))
    left, right = read_logs(write(tmp_path, "t,l_ff,r_ff,l_rpm,r_rpm,oat\n" + rows), config)
    assert (left.name, right.name) == ("log.csv:left", "log.csv:right")
    assert right.source.engine == "right"
    np.testing.assert_allclose(left["FF_kgph"], 45.359237)
    np.testing.assert_allclose(right["N1_pct"], 80.0)
    np.testing.assert_allclose(left["dT_C"], 0.0, atol=1e-9)
    assert "EGT_C" not in left.channels
    assert counts(left, "ALT_ft") == {("filled", "constant of the config"): 5}


HEAD = "time_s,N1_pct\n"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "FILE: the file is empty. Expected a header line and data rows"),
        (HEAD, "FILE: no rows follow the header"),
        (
            HEAD + "0,50\n",
            "FILE, channel time_s: expected samples at two or more times, found 1",
        ),
        (
            HEAD + "0,50\n0.1,fifty\n",
            (
                "FILE, channel N1_pct, row 2: expected a number, found 'fifty'. "
                "Correct it or leave it blank; row 1 is the first data row below the header"
            ),
        ),
        (
            HEAD + "0,50\n0.1,50,7\n",
            (
                "FILE, row 2: the row holds more fields than the header, which has 2. "
                "Check the delimiter and the decimal mark"
            ),
        ),
        (
            "time_s,N1_pct,N1_pct\n0,1,2\n",
            "FILE: column 'N1_pct' occurs 2 times in the header. Rename all but one",
        ),
        (
            HEAD + '0,50\n0.1,"51\n',
            (
                "FILE: rows 1 to 2 cannot be parsed (Error tokenizing data. C error: EOF inside "
                "string starting at row 2). Look for a quote that is never closed"
            ),
        ),
        (
            "times,N1_pct\n0,1\n",
            (
                "FILE: column 'time_s' is missing. Did you mean 'times'? "
                "Or map the columns under [logs.columns]"
            ),
        ),
        (
            HEAD + "".join(f"{k / 10},1\n" for k in [*range(100), *range(50)]),
            (
                "FILE, channel time_s, row 101: time goes back from 9.9 s to 0 s. "
                "It holds more than one recording: split the file there, or name the column "
                "that tells them apart in [logs] instances"
            ),
        ),
        (
            HEAD + "0,1\n10,2\n20,3\n",
            (
                "FILE, channel time_s: no two samples are closer than max_gap_s = 2 s. "
                "Raise [logs] max_gap_s or check the unit of time_s"
            ),
        ),
    ],
)
def test_a_bad_file_is_refused_with_what_to_do(tmp_path, text, message):
    assert error_of(write(tmp_path, text)) == message


def mapped(**columns):
    columns = {"time_s": {"column": "t"}, **columns}
    return LogsConfig.parse({"columns": columns})


def test_a_missing_column_and_a_wrong_prefix_name_what_is_there(tmp_path):
    path = write(tmp_path, "t,lh_fan,rh_fan\n0,1,2\n1,1,2\n")
    assert error_of(path, mapped(N1_pct={"column": "lh_fam"})) == (
        "FILE, channel N1_pct: column 'lh_fam' is missing. Did you mean 'lh_fan' or 'rh_fan'? "
        "Where a file may lack it: optional = true"
    )
    assert error_of(path, mapped(time_s={"column": "tt"})) == (
        "FILE, channel time_s: column 'tt' is missing. Did you mean 't'?"
    )
    config = LogsConfig.parse(
        {
            "engines": {"left": "eng1_"},
            "columns": {"time_s": {"column": "t"}, "N1_pct": {"column": "{engine}fan"}},
        }
    )
    assert error_of(path, config) == (
        "FILE, channel N1_pct: no column name holds the prefix 'eng1_' of engine 'left'. "
        "Prefixes in the file: 'lh_', 'rh_'"
    )


def test_every_unit_is_documented():
    page = ROOT / "docs" / "configuration.md"
    (listed,) = re.findall(r"^Units: (.*?)\n\n", page.read_text("utf-8"), re.MULTILINE | re.DOTALL)
    assert set(re.findall("`([^`]+)`", listed)) - {"scale"} == set(units._UNITS)


@pytest.mark.parametrize(
    ("channel", "unit", "message"),
    [
        ("FF_kgph", "lb/hh", "unknown unit 'lb/hh'. Did you mean 'lb/h'?"),
        (
            "FF_kgph",
            "kt",
            (
                "unit 'kt' is a speed, this channel is a mass flow. Units that fit: kg/h, kg/s, "
                "kg/min, g/s, lb/h, lb/s, lb/min"
            ),
        ),
        (
            "N2_pct",
            "rpm",
            (
                "unit 'rpm' is a rotational speed, this channel is a ratio. Leave it out "
                "and set scale to 100 / (rpm at 100 %)"
            ),
        ),
        ("ALT_ft", "zzz", "unknown unit 'zzz'. Units that fit: ft, m, km, FL"),
        ("EGT_C", "DEGC", "unknown unit 'DEGC'. Did you mean 'degC'?"),
    ],
)
def test_a_wrong_unit_names_the_nearest_or_those_that_fit(channel, unit, message):
    with pytest.raises(ConfigError) as caught:
        mapped(**{channel: {"column": "f", "unit": unit}})
    assert str(caught.value) == f"channel {channel}: {message}"


def test_configuration_errors_name_what_is_missing():
    with pytest.raises(ConfigError, match=r"unknown channel 'N1_pc'. Did you mean 'N1_pct'"):
        mapped(N1_pc={"column": "f"})
    with pytest.raises(ConfigError, match="belong together"):
        LogsConfig.parse({"engines": {"left": "l"}})
    with pytest.raises(ConfigError, match="lacks time_s"):
        LogsConfig.parse({"columns": {"N1_pct": {"column": "a"}}})
    with pytest.raises(ConfigError, match="either a column or a constant"):
        mapped(N1_pct={})


@pytest.mark.parametrize(
    ("table", "message"),
    [
        (
            {"delimiter": ";;"},
            "key 'delimiter': expected 'auto' or a single character, found ';;'",
        ),
        ({"delimiter": ",", "decimal": ","}, "delimiter, decimal and comment have to differ"),
        ({"delimiter": "#"}, "delimiter, decimal and comment have to differ"),
    ],
)
def test_a_dialect_that_cannot_be_is_refused(table, message):
    with pytest.raises(ConfigError, match=re.escape(message)):
        LogsConfig.parse(table)


@pytest.mark.parametrize(
    ("derive", "channel", "lacks"),
    [
        ({"dT_C": "SAT_C"}, "dT_C", "SAT_C and ALT_ft"),
        ({"WOW": {"airspeed": "TAS_kt"}}, "WOW", "TAS_kt"),
    ],
)
def test_what_cannot_be_derived_says_what_it_needs(tmp_path, derive, channel, lacks):
    path = write(tmp_path, HEAD + "0,50\n0.1,50\n")
    assert error_of(path, LogsConfig.parse({"derive": derive})) == (
        f"FILE, channel {channel}: it cannot be derived without {lacks}. Map it under "
        "[logs.columns] or take the derivation out of [logs.derive]"
    )


def test_weight_on_wheels_follows_from_mach_and_altitude(tmp_path):
    time = np.arange(40) / 10
    mach = np.repeat([0.05, 0.3], 20)  # 33 and 198 kt at sea level
    text = table(time, N1_pct=80 + time, ALT_ft=np.full(40, 10.0), Mach=mach)
    (log,) = read_logs(write(tmp_path, text), LogsConfig.parse({"derive": {"WOW": {}}}))
    np.testing.assert_array_equal(log["WOW"], np.repeat([1.0, 0.0], 20))


@pytest.mark.parametrize("airspeed", ["CAS_kt", "TAS_kt", "TAT_C"])
def test_mach_comes_from_airspeed_and_altitude_where_it_is_missing(tmp_path, airspeed):
    """250 kt CAS at 10 000 ft are Mach 0.4523 and 288.7 kt TAS on a standard day."""
    time = np.arange(20) / 10
    channels = {"N1_pct": 80 + time, "ALT_ft": np.full(20, 10_000.0)}
    channels |= {"SAT_C": np.full(20, -4.812), "CAS_kt": np.full(20, 250.0)}
    if airspeed != "CAS_kt":
        channels["TAS_kt"] = np.full(20, 288.7)
        del channels["CAS_kt"]
    if airspeed == "TAT_C":
        static_k = channels.pop("SAT_C") + 273.15
        channels["TAT_C"] = static_k * (1.0 + 0.2 * 0.45229**2) - 273.15
    (log,) = read_logs(write(tmp_path, table(time, **channels)))
    np.testing.assert_allclose(log["Mach"], 0.4523, atol=2e-4)
    np.testing.assert_allclose(log["dT_C"], 0.0, atol=1e-2)
    (own,) = read_logs(write(tmp_path, table(time, **channels, Mach=np.full(20, 0.5))))
    assert set(own["Mach"]) == {0.5}


def test_missing_files_and_folders_are_named(tmp_path):
    assert error_of(tmp_path / "no.csv") == "FILE: the file does not exist"
    with pytest.raises(DataError, match="the folder of the logs does not exist"):
        LogsConfig(folder="nowhere").resolve(tmp_path)
    (tmp_path / "file").touch()
    with pytest.raises(DataError, match="the folder of the logs is a file"):
        LogsConfig(folder="file").resolve(tmp_path)
    with pytest.raises(DataError, match=r"no file matches \*.csv or \*.csv.gz"):
        LogsConfig().resolve(tmp_path)


def test_a_broken_off_archive_is_refused(tmp_path):
    whole = gzip.compress(table(np.arange(5000) / 10, N1_pct=np.arange(5000.0)).encode())
    path = tmp_path / "log.csv.gz"
    path.write_bytes(whole[: len(whole) // 2])
    assert error_of(path) == "FILE: the compressed file is truncated or damaged. Copy it again"


def test_a_wrong_time_unit_does_not_fill_the_memory(tmp_path):
    path = write(tmp_path, table(1000.0 * np.arange(5.0), N1_pct=np.zeros(5)))
    assert error_of(path, LogsConfig(raster_hz=1000.0, max_gap_s=2000.0)) == (
        "FILE, channel time_s: 5 rows would become 4000001 samples at 1000 Hz. "
        "Check the unit of time_s and set [logs] raster_hz"
    )
    path = write(tmp_path, table(45000.0 + np.arange(500.0) / 864000, N1_pct=np.zeros(500)))
    assert error_of(path) == (
        "FILE, channel time_s: the rows are 1.16e-06 s apart, which no recorder of flights does. "
        "Set the unit of time_s: days (of a worksheet) are 'd', hours 'h', minutes 'min'"
    )
    days = LogsConfig.parse(
        {"columns": {"time_s": {"column": "time_s", "unit": "d"}, "N1_pct": {"column": "N1_pct"}}}
    )
    (log,) = read_logs(path, days)
    assert log.dt_s == pytest.approx(0.1)


def test_a_comma_seen_late_is_still_a_decimal_mark(tmp_path):
    rows = [f"{k};50" for k in range(300)] + ["300;50,5"]
    (log,) = read_logs(write(tmp_path, "time_s;N1_pct\n" + "\n".join(rows)))
    assert log["N1_pct"][-1] == 50.5


@given(
    values=st.lists(
        st.floats(-1e9, 1e9, allow_nan=False).map(lambda value: round(value, 6)),
        min_size=2,
        max_size=20,
    ),
    delimiter=st.sampled_from([",", ";", "\t", "|"]),
    way=st.tuples(st.booleans(), st.booleans(), st.booleans(), st.sampled_from(["\n", "\r\n"])),
)
def test_any_dialect_reads_back_what_was_written(tmp_path, values, delimiter, way):
    comma, bom, zipped, ending = way
    rows = [f"{k / 10}{delimiter}{value!r}" for k, value in enumerate(values)]
    if comma and delimiter != ",":
        rows = [row.replace(".", ",") for row in rows]
    text = ending.join([f"time_s{delimiter}EGT_C", *rows, ""])
    data = text.encode("utf-8-sig" if bom else "utf-8")
    path = tmp_path / "any.csv"
    path.write_bytes(gzip.compress(data) if zipped else data)
    (log,) = read_logs(path, LogsConfig(raster_hz=10.0))
    np.testing.assert_array_equal(log["EGT_C"], values)


cells = st.sampled_from(
    ["", "0", "1", "2.5", "1e400", "-inf", "nan", "x", '"', "'", ",", ";", "\n", "#", "\0", "\r",
     "1,5", "time_s", "N1_pct", "\t", "|", " ", "1e308", "-1e308", "0.1", "0.2", "0.3", "é"]
)  # fmt: skip


@given(
    content=st.one_of(
        st.binary(max_size=200),
        st.lists(cells, max_size=40).map(lambda parts: "".join(parts).encode()),
        st.lists(st.tuples(cells, cells), max_size=15).map(
            lambda rows: ("time_s,N1_pct\n" + "\n".join(map(",".join, rows))).encode()
        ),
        st.binary(max_size=60).map(lambda tail: b"\x1f\x8b" + tail),
        st.binary(max_size=60).map(lambda tail: b"\xff\xfe" + tail),
        st.binary(max_size=60).map(lambda tail: b"PAR1" + tail),
        st.binary(max_size=600).map(lambda tail: b"MATLAB 5.0 MAT" + tail),
        st.binary(max_size=60).map(lambda tail: b"\x89HDF\r\n\x1a\n" + tail),
        st.binary(max_size=60).map(lambda tail: b"MDF     " + tail),
    )
)
def test_whatever_the_bytes_are_they_read_or_are_refused(tmp_path, content):
    path = tmp_path / "fuzz.csv"
    path.write_bytes(content)
    try:
        logs = read_logs(path)
    except NarxcalError:
        return
    assert all(len(log) >= 2 and (np.diff(log.time_s) > 0).all() for log in logs)


@pytest.mark.parametrize("mark", ["\x1e", "\xa0"])
def test_what_only_python_takes_for_a_blank_is_named(tmp_path, mark):
    path = write(tmp_path, HEAD + f"0,50\n0.1,50{mark}\n0.2,50\n")
    assert error_of(path).startswith(
        f"FILE, channel N1_pct, row 2: expected a number, found '50{ascii(mark)[1:-1]}'"
    )


def test_a_row_with_a_missing_field_is_masked_and_never_shifted(tmp_path):
    rows = [f"{k / 10},{80 + k},{500 + k}" for k in range(40)]
    rows[7], rows[20], rows[33] = "0.7,507", "100,520", '3.3,"113"'
    path = write(tmp_path, "\n".join(["time_s,N1_pct,EGT_C", *rows]) + "\n")
    (log,) = read_logs(path)
    np.testing.assert_allclose(log["N1_pct"], 80.0 + np.arange(40))
    np.testing.assert_allclose(log["EGT_C"], 500.0 + np.arange(40))
    assert counts(log, "*") == {
        ("masked", "row with a missing field"): 3,
        ("dropped", "no time stamp"): 3,
    }
    assert counts(log, "EGT_C") == {("filled", "blank"): 3}


@given(lost=st.dictionaries(st.integers(1, 38), st.integers(0, 3), max_size=6))
def test_whatever_field_is_missing_no_value_gets_into_another_column(tmp_path, lost):
    rows = [[f"{k / 10}", f"{80 + k / 10}", f"{500 + k}", f"{2000 + k}"] for k in range(40)]
    for row, field in lost.items():
        del rows[row][field]
    text = "\n".join(["time_s,N1_pct,EGT_C,ALT_ft", *map(",".join, rows)])
    (log,) = read_logs(write(tmp_path, text), LogsConfig(raster_hz=10.0))
    time = np.arange(40) / 10
    np.testing.assert_allclose(log.time_s, time)
    for name, values in (("N1_pct", 80 + time), ("EGT_C", 500 + 10 * time)):
        known = np.isfinite(log[name])
        np.testing.assert_allclose(log[name][known], values[known])
    masked = counts(log, "*").get(("masked", "row with a missing field"), 0)
    assert masked == len(lost)


@pytest.mark.parametrize("delimiter", [",", ";", "\t", " "])
def test_a_delimiter_that_ends_rows_or_the_header_is_no_field(tmp_path, delimiter):
    for header_end, row_end in ((delimiter, ""), ("", delimiter), (delimiter, delimiter)):
        rows = [f"{k / 10}{delimiter}{80 + k}{row_end}" for k in range(9)]
        text = "\n".join([f"time_s{delimiter}N1_pct{header_end}", *rows]) + "\n"
        (log,) = read_logs(write(tmp_path, text))
        np.testing.assert_array_equal(log["N1_pct"], 80.0 + np.arange(9))
        assert log.audit.entries == ()


def test_rows_shorter_than_the_header_throughout_are_refused(tmp_path):
    rows = "".join(f"{k / 10},{80 + k}\n" for k in range(9))
    assert error_of(write(tmp_path, f"time_s,TRA_deg,N1_pct\n{rows}")) == (
        "FILE: the rows have 2 fields and the header has 3 names. "
        "Write a blank field where a value is missing"
    )


@pytest.mark.parametrize(
    "text",
    [
        "root:x:0:0:root:/root:/bin/sh\nsecret:x:1:1::/:/bin/sh\n",
        "KEY = 'secret', 1\nimport os, sys\n",
        '{"user": "secret", "password": "secret"}\n{"user": "b", "password": "c"}\n',
    ],
)
def test_a_file_that_is_no_log_is_refused_without_quoting_it(tmp_path, text):
    assert error_of(write(tmp_path, text)) == (
        "FILE: the file is no log: it has no column 'time_s' and hardly any numbers. "
        "Expected a header and rows of numbers; [logs] files names the files to read"
    )


@pytest.mark.parametrize("rows", [None, 2, 1000])
def test_a_line_without_an_end_does_not_fill_the_memory(tmp_path, rows):
    head = "" if rows is None else HEAD + "".join(f"{k / 10},1\n" for k in range(rows))
    path = tmp_path / "log.csv.gz"
    path.write_bytes(gzip.compress(head.encode() + b"1" * 2_000_000))
    assert error_of(path) == (
        "FILE: a line is longer than 1,000,000 characters. "
        "Expected a CSV file with one row of samples in each line"
    )


@pytest.mark.parametrize("pattern", ["../*.csv", "a/../../*.csv", "/data/*.csv", ""])
def test_patterns_of_files_stay_below_their_folder(pattern):
    with pytest.raises(ConfigError, match="expected patterns of files below \\[logs\\] folder"):
        LogsConfig.parse({"files": [pattern]})


def test_the_citation_flights_come_in_whole():
    config, files = shipped("citation2")
    logs = read_logs(files, config)
    assert [log.name.split(":")[1] for log in logs] == ["left", "right"] * 2
    assert [len(log) for log in logs[::2]] == [48321, 43391]
    assert not any(log.audit.entries for log in logs)
    assert all(np.isfinite(log["dT_C"]).all() and set(log["WOW"]) == {0.0, 1.0} for log in logs)


def test_the_simulated_flights_keep_every_row_at_32_hz():
    config, files = shipped("agtf30")
    logs = read_logs(files, config)
    assert [len(log) for log in logs] == [38400, 28800, 30720]
    assert all(log.dt_s == 1 / 32 for log in logs)
    assert all(
        {each.reason for each in log.audit.entries} == {"rounded time stamp"} for log in logs
    )


def test_the_micro_turbojet_gets_one_rate():
    config, files = shipped("jetcat")
    assert [log.dt_s for log in read_logs(files, config)] == pytest.approx([0.1, 0.1])


def test_a_column_of_time_that_is_called_optional_is_needed_all_the_same(tmp_path):
    file = tmp_path / "log.csv"
    file.write_text("TRA_deg,N1_pct\n1,2\n2,3\n", encoding="utf-8")
    columns = {name: {"column": name, "optional": True} for name in ("time_s", "N1_pct")}
    with pytest.raises(DataError, match=r"channel time_s: column 'time_s' is missing"):
        read_logs([file], LogsConfig.parse({"columns": columns}))
