"""Tables and labelled rows are taken by name; a name that is missing or unknown is an error."""

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from narxcal.support.errors import DataError
from narxcal.support.tables import by_name, labels

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
