import pytest

from narxcal.support.moments import elapsed, moment, stamp

MARCH = 1741907464.7  # 2025-03-13 23:11:04.7 UTC


@pytest.mark.parametrize(
    ("seconds", "decimals", "text"),
    [
        (0.0, 1, "0:00.0"), (9.94, 1, "0:09.9"), (59.96, 1, "1:00.0"), (754.7, 1, "12:34.7"),
        (3723.456, 2, "1:02:03.46"), (754.7, 0, "12:35"), (-3.0, 1, "-0:03.0"),
        (-0.01, 1, "0:00.0"), (360000.0, 0, "100:00:00"),
    ],
)  # fmt: skip
def test_elapsed_time_is_rounded_before_it_is_divided(seconds, decimals, text):
    assert elapsed(seconds, decimals) == text


@pytest.mark.parametrize(
    ("given", "text"),
    [
        ((754.7, 0.0), "t+12:34.7"),
        ((5754.7, 5000.0), "t+12:34.7"),
        ((20.0, 0.0, 30.0), "t+0:20.0 to t+0:30.0"),
        ((-3.0, 0.0), "-0:03.0"),
        ((MARCH, MARCH - 754.7), "t+12:34.7 (2025-03-13 23:11:04 UTC)"),
        (
            (MARCH, MARCH, MARCH + 60.0),
            "t+0:00.0 to t+1:00.0 (2025-03-13 23:11:04 to 23:12:04 UTC)",
        ),
        (
            (MARCH, MARCH, MARCH + 3600.0),
            "t+0:00.0 to t+1:00:00.0 (2025-03-13 23:11:04 to 2025-03-14 00:11:04 UTC)",
        ),
    ],
)
def test_a_moment_is_elapsed_time_and_the_date_where_the_log_has_one(given, text):
    assert moment(*given) == text


@pytest.mark.parametrize(
    ("time_s", "text"),
    [
        (504.9, "504.9 s"),
        (1723859580.0, "2024-08-17 01:53:00 UTC"),
        (1723859580.25, "2024-08-17 01:53:00.25 UTC"),
        (1723859580.9996, "2024-08-17 01:53:01 UTC"),
    ],
)
def test_a_stamp_is_that_of_the_log(time_s, text):
    assert stamp(time_s) == text
