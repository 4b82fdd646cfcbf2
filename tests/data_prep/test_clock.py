"""Clock times and dates as time stamps: what they mean, and what is no such thing."""

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from data_prep.reading import LogFile, LogsConfig, read_logs
from data_prep.stamps import clock_seconds, is_clock, past_midnight
from narxcal.support.errors import DataError

COLUMNS = {"columns": {"time_s": {"column": "UTC"}, "N1_pct": {"column": "fan"}}}
CLOCK = [f"23:59:5{k // 10}.{k % 10}" for k in range(40)]
DATES = [f"2026-03-01T12:00:0{k // 10}.{k % 10}Z" for k in range(40)]
MIDDAY_S = 20513 * 86400.0 + 43200.0  # 1 March 2026 is day 20513 after 1 January 1970


def write(folder, stamps, delimiter=",", decimal="."):
    rows = [f"{stamp}{delimiter}{80 + k}{decimal}5" for k, stamp in enumerate(stamps)]
    path = folder / "log.csv"
    path.write_text("\n".join([f"UTC{delimiter}fan", *rows]) + "\n", "utf-8")
    return path


@pytest.mark.parametrize(
    ("text", "seconds"),
    [
        ("12:34:56", 45296.0),
        (" 1:02:03,25 ", 3723.25),
        ("123:00:00:01.5", 123 * 86400.0 + 1.5),
        ("1:02:03.5 PM", 46923.5),
        ("12:00:01 am", 1.0),
        ("12:00:01 p.m.", 43201.0),
        ("1970-01-01T00:00:01.5", 1.5),
        ("1970-01-02 01:00:00+01:00", 86400.0),
        ("1970-01-01T00:01Z", 60.0),
    ],
)
def test_a_clock_time_counts_from_midnight_and_a_date_from_1970(text, seconds):
    assert is_clock(text)
    np.testing.assert_allclose(clock_seconds(pd.Series([text, None])), [seconds, np.nan])


@pytest.mark.parametrize(
    "text",
    ["12", "12:30", "1.5e3", "", "noon", "13:00:00 PM", "0:10:00 am", "2026-13-01T12:00:00"],
)
def test_anything_else_is_neither(text):
    assert np.isnan(clock_seconds(pd.Series([text]))).all()


@pytest.mark.parametrize(("stamps", "start_s"), [(CLOCK, 86390.0), (DATES, MIDDAY_S)])
def test_logs_and_rows_agree_on_the_stamps(tmp_path, stamps, start_s):
    config = LogsConfig.parse(COLUMNS)
    path = write(tmp_path, stamps, ";", ",")
    (log,) = read_logs(path, config)
    np.testing.assert_allclose(log.time_s, start_s + np.arange(40) / 10, rtol=0, atol=1e-6)
    np.testing.assert_array_equal(log["N1_pct"], 80.5 + np.arange(40))
    (block,) = LogFile(path, config).blocks([""])
    np.testing.assert_allclose(block[""]["time_s"], log.time_s, rtol=0, atol=1e-6)


def test_a_stamp_that_is_none_is_told_by_row_and_a_blank_is_dropped(tmp_path):
    config = LogsConfig.parse(COLUMNS)
    (log,) = read_logs(write(tmp_path, [*CLOCK[:20], "", *CLOCK[21:]]), config)
    assert ("*", "dropped", "no time stamp", 1) in [
        (entry.channel, entry.action, entry.reason, entry.samples) for entry in log.audit.entries
    ]
    path = write(tmp_path, [*CLOCK[:20], "soon", *CLOCK[21:]])
    with pytest.raises(DataError) as caught:
        read_logs(path, config)
    assert str(caught.value) == (
        f"{path}, channel UTC, row 21: expected a clock time or a date, found 'soon'. "
        "Correct it or leave it blank; row 1 is the first data row below the header"
    )


def test_other_columns_stay_numbers(tmp_path):
    config = LogsConfig.parse(
        {"columns": {"time_s": {"column": "fan"}, "N1_pct": {"column": "UTC"}}}
    )
    path = write(tmp_path, CLOCK)
    with pytest.raises(DataError, match=r"UTC, row 1: expected a number, found '23:59:50\.0'"):
        read_logs(path, config)


def test_a_clock_goes_on_past_midnight_and_a_late_row_finds_its_place(tmp_path):
    stamps = [f"23:59:{58 + k / 10:04.1f}" for k in range(20)]
    stamps += [f"00:00:{k / 10:04.1f}" for k in range(40)]
    stamps[19], stamps[20] = stamps[20], stamps[19]
    path, config = write(tmp_path, stamps), LogsConfig.parse(COLUMNS)
    (log,) = read_logs(path, config)
    np.testing.assert_allclose(log.time_s, 86398.0 + np.arange(60) / 10, rtol=0, atol=1e-6)
    values = 80.5 + np.arange(60)
    values[[19, 20]] = values[[20, 19]]
    np.testing.assert_array_equal(log["N1_pct"], values)
    moved = {e.reason: e.samples for e in log.audit.entries}
    assert moved["clock starts anew at midnight"] == 40


@given(
    start_s=st.floats(0.0, 86399.0),
    rows=st.integers(2, 60),
    cut=st.integers(1, 59),
    step_s=st.floats(0.02, 50.0),
)
def test_a_day_added_at_midnight_keeps_the_steps_however_the_rows_arrive(
    start_s, rows, cut, step_s
):
    true = start_s + step_s * np.arange(rows)
    shown = true % 86400.0
    first, days = past_midnight(shown[:cut])
    before = float(first[-1])
    second, days = past_midnight(shown[cut:], before, days)
    np.testing.assert_allclose(np.concatenate([first, second]), true, rtol=0, atol=1e-6)
    assert days == true[-1] // 86400.0 or shown[cut:].size == 0


@pytest.mark.parametrize("stamps", [[86350.0, 5.0, 90000.0], [90000.0, 5.0], [50000.0, 10.0]])
def test_what_is_no_clock_at_midnight_stays(stamps):
    found, days = past_midnight(np.array(stamps))
    if stamps[0] > 86400.0 or stamps[0] < 86340.0:
        np.testing.assert_array_equal(found, stamps)
        assert days == 0
    else:
        np.testing.assert_array_equal(found, [86350.0, 86405.0, 90000.0])
