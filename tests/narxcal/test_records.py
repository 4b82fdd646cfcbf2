"""A record is complete, agrees with its neighbours, or is refused in words."""

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from narxcal.record import Record, by_name, check_measured, check_records, labels
from narxcal.support.errors import DataError


def test_a_single_channel_becomes_a_column():
    record = Record(np.arange(5), [1, 2, 3, 4, np.nan])
    assert record.u.shape == record.y.shape == (5, 1)
    assert record.u.dtype == np.float64
    assert len(record) == 5


def test_records_agree_on_their_channels():
    records = [Record(np.zeros((n, 3)), np.zeros((n, 2))) for n in (5, 9)]
    assert check_records(records, 4) == (3, 2)


def test_a_weight_is_an_array_of_numbers():
    weight = Record(np.zeros(3), np.zeros(3), "flight", [1, 0, 2]).weight
    assert weight.dtype == np.float64
    assert weight.tolist() == [1.0, 0.0, 2.0]


def with_bad_input():
    u = np.zeros((6, 2))
    u[4, 1] = np.inf
    return Record(u, np.zeros(6), "flight")


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (
            lambda: Record(np.zeros(3), np.zeros(4), "flight"),
            "flight: inputs and outputs have to be of one length, found 3 and 4 samples",
        ),
        (
            with_bad_input,
            (
                "flight, row 4: an input is not a finite number. "
                "Fill or cut the record first; only outputs may be masked with NaN"
            ),
        ),
        (
            lambda: Record(np.zeros(3), np.zeros(3), "flight", np.ones(2)),
            "flight: the weight has to be of shape (3,), found (2,)",
        ),
        (
            lambda: Record(np.zeros(3), np.zeros(3), "flight", [1, -2, 0]),
            "flight, row 1: expected a weight of at least 0, found -2. 0 leaves a sample out",
        ),
        (
            lambda: Record(np.zeros(3), np.zeros(3), "flight", [1, 0, np.nan]),
            "flight, row 2: expected a weight of at least 0, found nan. 0 leaves a sample out",
        ),
        (
            lambda: Record(np.zeros(2), ["1", "idle"], "flight"),
            (
                "flight: expected an array of real numbers, found list "
                "(could not convert string to float: 'idle')"
            ),
        ),
        (
            lambda: Record(np.zeros(2) + 1j, np.zeros(2), "flight"),
            "flight: expected an array of real numbers, found complex ones",
        ),
        (
            lambda: Record(np.zeros(3), [0.0, 1.0, -np.inf], "flight"),
            "flight, row 2: an output is infinite. Mask unknown samples with NaN",
        ),
        (
            lambda: Record(np.zeros((2, 9, 1)), np.zeros((2, 9, 1)), "flight"),
            (
                "flight: expected (time, channels), found an array of shape (2, 9, 1). "
                "Pass a batch as a list of records"
            ),
        ),
        (lambda: check_records([], 1), "at least one record is needed, found none"),
        (
            lambda: check_records([Record(np.zeros(3), np.zeros(3), "flight")], 3),
            (
                "flight: a record needs more than 3 samples, found 3. Leave this record out, or "
                "join it to the one that it was cut from"
            ),
        ),
        (
            lambda: check_records([Record(np.zeros((9, 0)), np.zeros(9), "flight")], 3),
            (
                "flight: expected an input and an output at least, found 0 and 1. "
                "Give arrays of shape (time, channels)"
            ),
        ),
        (
            lambda: check_records(
                [
                    Record(np.zeros((9, 2)), np.zeros(9), "one"),
                    Record(np.zeros((9, 2)), np.zeros((9, 3)), "two"),
                ],
                3,
            ),
            "two: expected 2 inputs and 1 outputs as in one, found 2 and 3",
        ),
        (
            lambda: check_measured(
                [Record(np.zeros(2), np.column_stack([np.zeros(2), [np.nan] * 2]), "one")], "test"
            ),
            (
                "one: output 2 of 2 has no known sample in any test record. "
                "Leave the output out, or add records that hold it"
            ),
        ),
    ],
)
def test_what_is_wrong_is_said(make, message):
    with pytest.raises(DataError) as error:
        make()
    assert str(error.value) == message


def test_an_output_known_in_one_record_is_enough():
    dark = Record(np.zeros(2), np.full(2, np.nan))
    check_measured([dark, Record(np.zeros(2), [0.0, np.nan])], "training")


@pytest.mark.parametrize("place", ["input", "output"])
def test_values_whose_squares_overflow_are_refused(place):
    u, y = np.ones((5, 1)), np.ones((5, 1))
    (u if place == "input" else y)[3] = -1e300
    with pytest.raises(DataError) as error:
        Record(u, y)
    assert str(error.value) == (
        "record, row 3: a value is beyond 1e+100, so that its square is not a finite number. "
        "Scale the channel, or mask what is no measurement"
    )


NAMES = ("Mach", "TRA_deg", "N1_pct")


@given(st.permutations(NAMES))
def test_the_order_of_columns_and_entries_does_not_matter(order):
    values = np.arange(6.0).reshape(2, 3)
    table = pd.DataFrame(values, columns=NAMES)[order]
    assert np.array_equal(by_name(table, NAMES), values)
    assert np.array_equal(by_name(table.iloc[1], NAMES), values[1])


def test_numbers_name_nothing():
    for values in (
        [[1.0, 2.0]],
        np.zeros((2, 3)),
        pd.DataFrame(np.zeros((2, 3))),
        pd.Series([1.0]),
    ):
        assert labels(values) == ()
        assert by_name(values, NAMES) is values


@pytest.mark.parametrize(
    ("columns", "message"),
    [
        (
            ("Mach", "TRA_deg"),
            (
                "channel N1_pct: the column is missing; expected the columns "
                "Mach, TRA_deg, N1_pct, found Mach, TRA_deg"
            ),
        ),
        (
            ("Mach", "TRA_deg", "N2_pct"),
            "channel N2_pct: unknown column; expected the columns Mach, TRA_deg, N1_pct",
        ),
        (("Mach", "Mach", "TRA_deg", "N1_pct"), "channel Mach: the column is there 2 times"),
    ],
)
def test_a_wrong_name_is_named(columns, message):
    with pytest.raises(DataError) as error:
        by_name(pd.DataFrame(np.zeros((2, len(columns))), columns=columns), NAMES)
    assert str(error.value) == message
