"""Time stamps: clock times, dates, midnight, and rows that share a whole second."""

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from data_prep.config import LogsConfig
from data_prep.reading import read_logs
from data_prep.sources.clock import Clock, is_clock
from data_prep.sources.log_file import LogFile
from data_prep.sources.stamps import DAY_S, shared_interval, undo_rounding, unwrap_clock
from data_prep.sources.stream import GridStream
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
        ("30:00:01.5", 108001.5),
    ],
)
def test_a_clock_time_counts_from_midnight_and_a_date_from_1970(text, seconds):
    assert is_clock(text)
    np.testing.assert_allclose(Clock().seconds(pd.Series([text, None])), [seconds, np.nan])


@pytest.mark.parametrize(
    "text", ["10:61:00", "1:10:46:61", "10:46:39:05", "75:80.5", "12", "12:30"]
)
def test_anything_else_is_no_clock(text):
    assert not is_clock(text)


@pytest.mark.parametrize(
    "text", ["1.5e3", "", "noon", "13:00:00 PM", "0:10:00 am", "2026-13-01T12:00:00", "12", "12:30"]
)
def test_what_looks_like_a_clock_and_is_none_has_no_time(text):
    assert np.isnan(Clock().seconds(pd.Series([text]))).all()


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
    first, days = unwrap_clock(DAY_S, shown[:cut])
    before = float(first[-1])
    second, days = unwrap_clock(DAY_S, shown[cut:], (before, days))
    np.testing.assert_allclose(np.concatenate([first, second]), true, rtol=0, atol=1e-6)
    assert days == true[-1] // 86400.0 or shown[cut:].size == 0


@pytest.mark.parametrize("stamps", [[86350.0, 5.0, 90000.0], [90000.0, 5.0], [50000.0, 10.0]])
def test_what_is_no_clock_at_midnight_stays(stamps):
    found, days = unwrap_clock(DAY_S, np.array(stamps))
    if stamps[0] > 86400.0 or stamps[0] < 86340.0:
        np.testing.assert_array_equal(found, stamps)
        assert days == 0
    else:
        np.testing.assert_array_equal(found, [86350.0, 86405.0, 90000.0])


def wave(time):
    return 60.0 + 20.0 * np.sin(time / 7.0) + 0.01 * time


def test_whole_seconds_give_the_rows_their_own_rate(tmp_path):
    time = 3.7 + np.arange(1000) / 10.0
    rows = [f"00:{t // 60:02.0f}:{np.floor(t % 60):02.0f},{wave(t):.6f}" for t in time]
    path = tmp_path / "log.csv"
    path.write_text("\n".join(["time_s,N1_pct", *rows]) + "\n", encoding="utf-8")
    (log,) = read_logs(path)
    assert log.dt_s == pytest.approx(0.1)
    assert len(log) == 1000
    np.testing.assert_allclose(log.time_s - log.time_s[0], time - time[0], atol=1e-9)
    np.testing.assert_allclose(log["N1_pct"], wave(time), atol=1e-6)
    assert not any(entry.reason == "duplicate time stamp" for entry in log.audit.entries)
    (repaired,) = [e.samples for e in log.audit.entries if e.reason == "rounded time stamp"]
    assert repaired > 800


@given(
    rate_hz=st.floats(2.1, 60.0),
    start_s=st.floats(0.0, 0.99),
    lost=st.integers(0, 5),
)
def test_any_rate_is_found_and_no_row_is_off_by_more_than_the_clock(rate_hz, start_s, lost):
    """Of stamps cut to whole seconds; some seconds in the middle are missing."""
    time = start_s + np.arange(round(40.0 * rate_hz)) / rate_hz
    time = time[(time < 20.0) | (time >= 20.0 + lost)]
    stamps = np.floor(time)
    interval = shared_interval(stamps, {"N1_pct": wave(time)})
    assert interval == pytest.approx(1.0 / rate_hz, rel=0.03)
    exact = undo_rounding(stamps, interval)
    assert (np.diff(exact) > 0.0).all()
    away = exact - time
    assert np.ptp(away) <= 1.0 + 2.0 * interval


def test_rows_of_other_channels_or_of_the_same_values_are_no_samples_between():
    stamps = np.repeat(np.arange(100.0), 2)
    whole = np.repeat(wave(np.arange(100.0)), 2)
    turns = np.where(np.arange(200) % 2 == 0, whole, np.nan)
    other = np.where(np.arange(200) % 2 == 1, whole, np.nan)
    assert shared_interval(stamps, {"N1_pct": turns, "N2_pct": other}) == 0.0
    assert shared_interval(stamps, {"N1_pct": whole}) == 0.0
    own = wave(np.arange(200) / 2.0)
    assert shared_interval(stamps, {"N1_pct": own}) == pytest.approx(0.5)
    assert shared_interval(np.arange(200) / 2.0, {"N1_pct": own}) == 0.0


@pytest.mark.parametrize("step_s", [1.0, 0.1])
def test_rows_of_two_engines_in_turn_do_not_follow_each_other(step_s):
    stamps = np.repeat(np.arange(300) * step_s, 2)
    random = np.random.default_rng(2)
    speed = wave(stamps) + 0.05 * random.standard_normal(600)
    engines = speed + np.tile([0.0, 0.8], 300)
    assert shared_interval(stamps, {"N1_pct": engines}) == 0.0
    assert shared_interval(stamps, {"N1_pct": engines, "TRA_deg": np.full(600, 30.0)}) == 0.0


@pytest.mark.parametrize("last_digit", [0.1, 1.0])
def test_readings_of_few_digits_follow_each_other_all_the_same(last_digit):
    random = np.random.default_rng(3)
    time = np.arange(3000) / 8.0
    speed = 80.0 + np.cumsum(0.02 * random.standard_normal(3000))
    shown = np.round(speed / last_digit) * last_digit
    exact = {"N1_pct": shown, "ALT_ft": 9000.0 + 0.0 * time}
    changes = float(np.mean(np.diff(shown) != 0.0))
    expected = 0.125 if changes > 0.03 else 0.0
    assert shared_interval(np.floor(time), exact) == pytest.approx(expected)


def test_rows_that_share_stamps_irregularly_are_left_where_they_are():
    stamps = np.sort(np.random.default_rng(0).integers(0, 60, 400)).astype(float)
    assert shared_interval(stamps, {"N1_pct": wave(np.arange(400.0))}) == 0.0


@pytest.mark.parametrize("size", [35, 400])
def test_a_stream_has_the_same_rate_after_the_first_seconds(size):
    """Where in a second the first row lies, no clock of whole seconds says."""
    time = np.arange(2000) / 10.0
    rows = {"time_s": np.floor(time), "N1_pct": wave(time)}
    stream = GridStream(LogsConfig(), 0.1, 5.0)
    pieces = []
    for at in range(0, 2000, size):
        block = {name: values[at : at + size] for name, values in rows.items()}
        pieces += stream.push(block)
    pieces += stream.push({}, last=True)
    found = np.concatenate([piece.channels["N1_pct"] for piece in pieces])
    grid = np.concatenate([piece.time_s for piece in pieces])
    late = grid > 10.0
    away = min(
        float(np.abs(found[late] - wave(grid[late] + shift_s)).max())
        for shift_s in np.arange(-1.0, 1.01, 0.1)
    )
    assert away < 0.05


def test_rows_of_a_single_second_follow_each_other():
    np.testing.assert_allclose(undo_rounding(np.full(5, 12.0), 0.1), 12.0 + np.arange(5) / 10.0)


@pytest.mark.parametrize("start", ["10:46:39", "10:12:39", "1:02:03"])
@pytest.mark.parametrize("rate", [24, 25, 30])
def test_frames_of_a_second_are_not_read_as_seconds(tmp_path, start, rate):
    hours, minutes, seconds = map(int, start.split(":"))
    stamps = [f"{hours}:{minutes:02d}:{seconds + k // rate:02d}:{k % rate:02d}" for k in range(100)]
    with pytest.raises(DataError) as caught:
        read_logs(write(tmp_path, stamps), LogsConfig.parse(COLUMNS))
    assert str(caught.value).endswith(
        f"log.csv: stamps like '{stamps[0]}' count frames of a second. "
        "Set [logs] frames_hz to the number of frames that a second has"
    )


@pytest.mark.parametrize("every", [1, 5, 20])
def test_days_with_clock_times_are_no_frames(tmp_path, every):
    stamps = [f"123:10:{46 + k * every // 60}:{k * every % 60:02d}" for k in range(20)]
    config = {**COLUMNS, "max_gap_s": 60.0}
    (log,) = read_logs(write(tmp_path, stamps), LogsConfig.parse(config))
    assert log.dt_s == pytest.approx(every)


@pytest.mark.parametrize("blank", [150, 250, 1500])
def test_a_clock_that_is_blank_before_its_fix_is_a_clock(tmp_path, blank):
    stamps = [""] * blank + CLOCK
    (log,) = read_logs(write(tmp_path, stamps), LogsConfig.parse(COLUMNS))
    np.testing.assert_allclose(log.time_s, 86390.0 + np.arange(40) / 10)
    dropped = [one.samples for one in log.audit.entries if one.reason == "no time stamp"]
    assert dropped == [blank]


def test_stamps_of_another_unit_since_1970_ask_for_it(tmp_path):
    path = write(tmp_path, [1723286799000 + 100 * k for k in range(40)])
    with pytest.raises(DataError) as caught:
        read_logs(path, LogsConfig.parse(COLUMNS))
    assert str(caught.value) == (
        f"{path}, channel time_s: stamps like 1723286799000 are later than any clock that counts "
        "seconds. Set the unit of time_s: 'ms', 'us' or 'ns'"
    )


def motion(rng, samples, dt_s, tau_s=1.2):
    """A lag behind a lever that is moved every 10 s, with some noise."""
    lever = np.repeat(rng.uniform(20.0, 90.0, -(-samples // 100)), 100)[:samples]
    values = np.empty(samples)
    values[0] = lever[0]
    for k in range(1, samples):
        values[k] = values[k - 1] + (lever[k - 1] - values[k - 1]) * dt_s / tau_s
    return values + rng.normal(0.0, 0.05, samples)


@given(seed=st.integers(0, 10_000), engines=st.integers(2, 4))
def test_engines_that_share_stamps_are_not_one_fast_recording(seed, engines):
    rng = np.random.default_rng(seed)
    first = motion(rng, 1000, 0.1)
    # Their differences last for seconds and are zero in the mean; equal engines cannot be told.
    phases = rng.uniform(0.0, 6.0) + 2.0 * np.pi * np.arange(engines) / engines
    apart = [np.sin(np.arange(1000) * 0.01 + phase) for phase in phases]
    rows = np.column_stack([first + 0.3 * each for each in apart]).ravel()
    assert shared_interval(np.repeat(np.arange(1000) * 0.1, engines), {"N1_pct": rows}) == 0.0


@given(seed=st.integers(0, 10_000), rows=st.integers(2, 10))
def test_one_fast_recording_by_a_coarse_clock_stays_one(seed, rows):
    values = motion(np.random.default_rng(seed), 100 * rows, 0.1 / rows)
    time = np.repeat(np.arange(100) * 0.1, rows)
    assert shared_interval(time, {"N1_pct": values}) == pytest.approx(0.1 / rows, rel=0.01)


@pytest.mark.parametrize("rate", [24, 25, 30])
def test_frames_of_a_second_are_read_by_their_rate(tmp_path, rate):
    stamps = [f"10:46:{39 + k // rate:02d}:{k % rate:02d}" for k in range(100)]
    (log,) = read_logs(write(tmp_path, stamps), LogsConfig.parse({**COLUMNS, "frames_hz": rate}))
    np.testing.assert_allclose(log.time_s, 38799.0 + np.arange(100) / rate, atol=1e-6)


def dates(form, days=("2026-03-31", "2026-04-01")):
    first, *later = (pd.Timestamp(day) for day in days)
    start = first + pd.Timedelta(hours=23, minutes=59, seconds=58) if later else first
    stamps = [start + pd.Timedelta(milliseconds=100 * k) for k in range(40)]
    return [f"{stamp.strftime(form)}.{stamp.microsecond // 100_000}" for stamp in stamps]


@pytest.mark.parametrize(
    "form",
    ["%d/%m/%Y %H:%M:%S", "%m/%d/%Y %H:%M:%S", "%d.%m.%Y %H:%M:%S", "%d-%b-%Y %H:%M:%S",
     "%Y/%m/%d %H:%M:%S", "%d-%m-%y %H:%M:%S", "%b %d, %Y %H:%M:%S", "%d %B %Y, %H:%M:%S"],
)  # fmt: skip
@pytest.mark.parametrize("days", [("2026-03-31", "2026-04-01"), ("2026-03-04", "2026-03-05")])
def test_dates_are_read_in_the_order_that_the_file_settles(tmp_path, form, days):
    (log,) = read_logs(write(tmp_path, dates(form, days), ";"), LogsConfig.parse(COLUMNS))
    start_s = (pd.Timestamp(days[0]) - pd.Timestamp(0)).total_seconds() + 86398.0
    np.testing.assert_allclose(log.time_s, start_s + np.arange(40) / 10, rtol=0, atol=1e-6)


def test_dates_that_may_begin_with_day_or_month_ask(tmp_path):
    stamps = dates("%d/%m/%Y %H:%M:%S", ["2026-04-03"])
    path = write(tmp_path, stamps)
    with pytest.raises(DataError) as caught:
        read_logs(path, LogsConfig.parse(COLUMNS))
    assert str(caught.value) == (
        f"{path}: dates like '{stamps[0]}' may begin with the day or with the month. "
        'Set [logs] dates = "DMY" or "MDY"'
    )
    for order, day in (("DMY", "2026-04-03"), ("MDY", "2026-03-04")):
        (log,) = read_logs(path, LogsConfig.parse({**COLUMNS, "dates": order}))
        assert pd.Timestamp(log.time_s[0], unit="s") == pd.Timestamp(day)
