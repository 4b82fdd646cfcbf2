"""Errors of Ti and Tt are those of the closed form, event by event."""

import numpy as np
import pytest

from eval.diagnosis.expected import time_errors
from eval.diagnosis.flights import events_of


def test_a_delay_moves_ti_and_leaves_tt(make_data):
    data = make_data()
    data.real[:] = np.roll(data.flights.y, 4, axis=1)
    data.real[:, :4] = data.flights.y[:, :1]
    found = time_errors(data, data.flights.y, events_of(data))["N1_pct"]
    found = found.groupby("direction")
    assert (found.size()[["push", "pull"]] > 10).all()
    np.testing.assert_allclose(found["Ti_s"].median(), 0.5, atol=0.02)
    np.testing.assert_allclose(found["Tt_s"].median(), 0.0, atol=0.02)


def test_a_longer_lag_moves_tt_by_its_closed_form(make_data, fly):
    data = make_data()
    slow = np.empty_like(data.flights.y[..., 0])
    lever = data.flights.u[..., 0] / 70.0
    kept = np.exp(-data.flights.signals.dt_s / 2.0)
    slow[:, 0] = lever[:, 0]
    for k in range(1, slow.shape[1]):
        slow[:, k] = lever[:, k] + kept * (slow[:, k - 1] - lever[:, k])
    data.real[..., 0] = 25.0 + 75.0 * slow
    found = time_errors(data, data.flights.y, events_of(data))["N1_pct"]
    # t90 - t10 of a first-order lag is ln 9 time constants.
    assert found.groupby("direction")["Tt_s"].median()["push"] == pytest.approx(
        0.5 * np.log(9.0), abs=0.06
    )


def test_events_that_cannot_be_read_are_left_out(make_data):
    data = make_data()
    data.real[..., 0] = data.flights.y[..., 0].mean()
    found = time_errors(data, data.flights.y, events_of(data))
    assert found["N1_pct"].empty
    data.real[..., 1] = -data.flights.y[..., 1]
    assert time_errors(data, data.flights.y, events_of(data))["N2_pct"].empty
