"""Inputs of a model are completed by holding the last value, and that is counted."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from data_prep.log import AuditEntry, Log
from data_prep.prepare import hold_inputs
from narxcal.support.errors import DataError

NAN = float("nan")


def log(**channels):
    values = {name: np.array(value, dtype=float) for name, value in channels.items()}
    count = len(next(iter(values.values())))
    return Log("flight.csv:left", 0.1 * np.arange(count), values)


def test_the_last_value_is_carried_on_and_the_first_back():
    given_ = log(Mach=[NAN, 0.3, NAN, NAN, 0.5, NAN], N1_pct=[NAN] * 6)
    held = hold_inputs(given_, ["Mach"])
    assert held["Mach"].tolist() == [0.3, 0.3, 0.3, 0.3, 0.5, 0.5]
    assert np.isnan(held["N1_pct"]).all()
    assert held.audit.entries == (AuditEntry("Mach", "filled", "held for the model", 4),)
    assert np.isnan(given_["Mach"]).sum() == 4


def test_a_complete_log_is_left_as_it_is():
    given_ = log(Mach=[0.1, 0.2], TRA_deg=[1.0, 2.0])
    assert hold_inputs(given_, ["Mach", "TRA_deg"]) is given_


@settings(max_examples=50, deadline=None)
@given(values=st.lists(st.one_of(st.just(NAN), st.floats(-1e3, 1e3)), min_size=2, max_size=30))
def test_known_samples_stay_and_none_is_unknown(values):
    known = np.isfinite(values)
    if not known.any():
        return
    held = hold_inputs(log(Mach=values), ["Mach"])["Mach"]
    assert np.array_equal(held[known], np.array(values)[known])
    assert np.isfinite(held).all()
    assert set(held) <= set(np.array(values)[known])


def test_a_channel_without_any_sample_is_refused():
    with pytest.raises(DataError) as error:
        hold_inputs(log(Mach=[NAN, NAN]), ["Mach"])
    assert str(error.value) == (
        "flight.csv:left, channel Mach: an input of the model has no valid sample. "
        "Map another column to it, or leave the log out"
    )


def test_a_channel_that_is_not_there_is_refused():
    with pytest.raises(DataError) as error:
        hold_inputs(log(Mach=[0.1, 0.2]), ["TRA_deg"])
    assert str(error.value) == (
        "flight.csv:left, channel TRA_deg: an input of the model is not in the log. Map it under "
        "[logs.columns], if need be as TRA_deg = { constant = ... }, or take it out of "
        "[steady_state] inputs. The log has Mach"
    )
