"""How the numbers of a diagnosis are printed in its tables."""

import math

import pytest

from eval.gap.page_cells import percent, printed, seconds, span


@pytest.mark.parametrize(
    ("share", "text"),
    [(0.9, "90"), (0.042, "4.2"), (-1e-9, "0"), (None, "–"), (math.nan, "–"), (-0.27, "-27")],  # noqa: RUF001
)
def test_shares_in_percent(share, text):
    assert percent(share).text == text


@pytest.mark.parametrize(
    ("low", "high", "text"),
    [
        (0.1, 0.25, "10 to 25"),
        (-0.001, 0.001, "-0.1 to 0.1"),
        (0.0, 0.0002, "0 to 0"),
        (-math.inf, 1.0, "–"),  # noqa: RUF001
        (None, 0.1, "–"),  # noqa: RUF001
    ],
)
def test_intervals_in_percent(low, high, text):
    assert span({"low": low, "high": high}) == text


@pytest.mark.parametrize(
    ("value", "text"),
    [(0.2449, "0.245"), (-0.00021, "0.000"), (math.nan, "–"), (None, "–")],  # noqa: RUF001
)
def test_times_to_the_millisecond(value, text):
    assert seconds(value).text == text


@pytest.mark.parametrize(
    ("unit", "text"), [("degC", "°C"), ("-", ""), ("deg/s", "°/s"), ("degC/h", "°C/h")]
)
def test_units_are_printed_as_an_engineer_writes_them(unit, text):
    assert printed(unit) == text
