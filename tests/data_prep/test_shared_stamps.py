"""Rows between two seconds of a clock: spaced as they were recorded, or left where they are."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from data_prep.config import LogsConfig
from data_prep.reading import read_logs
from data_prep.stamps import shared_interval, undo_rounding
from data_prep.stream import GridStream


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
