"""Held-out flights are put in the terms of the diagnosed ones, or refused by name."""

import numpy as np
import pytest

from eval.diagnosis.flights import in_terms_of, together
from eval.diagnosis.pairs import pair_logs
from narxcal.support.errors import DataError
from tests.eval.diagnosis.conftest import batch


@pytest.fixture
def without(fly, record, log_of):
    """One flight that lacks some channels."""

    def build(*names):
        sim = {name: values for name, values in fly(7).items() if name not in names}
        return batch([pair_logs("late", log_of(record(sim)), log_of(sim))])

    return build


def test_the_order_of_the_diagnosis_counts(make_data):
    data, other = make_data(flights=3), make_data(flights=1)
    found = in_terms_of(data, other)
    assert found.flights.signals is data.flights.signals
    np.testing.assert_array_equal(found.flights.u, other.flights.u)


def test_an_input_that_never_changed_need_not_be_there(make_data, without):
    found = in_terms_of(make_data(flights=3), without("dT_C", "Mach"))
    signals = found.flights.signals
    assert {"dT_C", "Mach"} <= set(signals.inputs)
    np.testing.assert_allclose(found.flights.u[..., signals.u("dT_C")], 3.0)
    np.testing.assert_allclose(found.flights.u[..., signals.u("Mach")], 0.4)


@pytest.mark.parametrize("name", ["NAI", "EGT_C"])
def test_what_changes_and_every_output_has_to_be_there(make_data, without, name):
    with pytest.raises(
        DataError, match=rf"late, channel {name}: the held-out flights lack it\. Record and sim"
    ):
        in_terms_of(make_data(flights=3), without(name))


def test_another_rate_is_refused(make_data):
    with pytest.raises(
        DataError, match="flights are processed at 4 Hz, those of the diagnosis at 8 Hz"
    ):
        in_terms_of(make_data(flights=3), make_data(flights=1, rate_hz=4.0))


def test_all_flights_as_the_simulator_flew_them_are_one_batch(make_data):
    """In the ranges of all of them, the shorter ones filled up with their last row."""
    first = make_data(flights=3).flights
    other = make_data(flights=2, duration_s=160.0).flights
    still = first.signals.u("dT_C")
    other.u[..., first.signals.u("TRA_deg")] += 10.0
    other.u[1, :, still] += 5.0
    found = together(first, other)
    steps = other.u.shape[1]
    assert found.lengths.tolist() == [*first.lengths, *other.lengths]
    np.testing.assert_array_equal(found.u[:3], first.u)
    np.testing.assert_array_equal(found.y[3:, :steps], other.y)
    np.testing.assert_array_equal(
        found.y[3:, steps:], np.broadcast_to(other.y[:, -1:], found.y[3:, steps:].shape)
    )
    lever = np.concatenate([f.u[..., first.signals.u("TRA_deg")].ravel() for f in (first, other)])
    assert found.signals.lever == (lever.min(), lever.max())
    np.testing.assert_array_equal(found.signals.high, found.y.max(axis=(0, 1)))
    assert "dT_C" not in first.signals.active
    assert set(found.signals.active) == {*first.signals.active, "dT_C"}
