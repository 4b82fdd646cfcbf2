"""Fits of step responses: recovered parameters, the paper's delay search, the criterion."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from narxcal.support.errors import DataError, ModelError
from training.papers.transfer_fit import (
    KINDS,
    LN_EARLY,
    LN_LATE,
    FirstOrder,
    SecondOrder,
    fit_response,
    rise_times_agree,
    search_delay,
    system_of,
)

T = 0.02 * np.arange(1000)


@given(st.floats(0.05, 4.0))
def test_time_constant_by_least_squares_and_from_t90(tau):
    y = FirstOrder(tau).step(T)
    assert fit_response(T, y, "first").values[0] == pytest.approx(tau, rel=1e-6)
    # Between samples t90 is read on a straight line.
    assert fit_response(T, y, "first t90").values[0] == pytest.approx(tau, rel=0.02)


@given(st.floats(0.3, 4.0), st.floats(0.1, 50.0))
def test_second_order_is_recovered_over_and_under_damped(xi, omega):
    xi = min(xi, 2.5)
    y = SecondOrder(xi, omega).step(T)
    if (y >= 0.9).any() and omega < 20.0:
        found = fit_response(T, y, "second")
        assert found.rmse < 1e-4


@pytest.mark.parametrize(("xi", "omega"), [(0.3, 3.0), (0.99, 2.0), (1.0, 2.0), (1.8, 4.0)])
def test_second_order_parameters(xi, omega):
    found = fit_response(T, SecondOrder(xi, omega).step(T), "second")
    np.testing.assert_allclose(found.values, [xi, omega], rtol=1e-3)
    assert [name for name, _, _ in found.parameters] == ["xi", "w"]


def test_a_single_pole_cannot_show_a_second_one():
    status = fit_response(T, FirstOrder(0.8).step(T), "second").status
    assert status.endswith("xi > 3: the second time constant is not identifiable")


@given(st.floats(0.1, 3.0), st.floats(0.0, 1.0))
def test_the_papers_search_ends_within_a_sample_of_the_closed_form(tau, delay):
    t10, t90 = delay + tau * LN_EARLY, delay + tau * LN_LATE
    found_tau, found_delay = search_delay(t10, t90, 0.01)
    assert abs(found_delay - delay) <= 0.01
    assert abs(found_tau - tau) <= 0.01 / LN_LATE + 1e-9


def test_the_delay_repairs_t10_which_one_parameter_cannot():
    y = FirstOrder(0.6, 0.4).step(T)
    plain, delayed = (fit_response(T, y, kind).system.step(T) for kind in ("first t90", "delayed"))
    assert not rise_times_agree(T, plain, y)
    assert rise_times_agree(T, delayed, y)


@pytest.mark.parametrize("kind", KINDS)
def test_a_system_is_made_again_from_its_values(kind):
    found = fit_response(T, SecondOrder(1.4, 3.0).step(T), kind)
    assert system_of(kind, found.values) == found.system


def test_the_criterion_is_ten_percent_of_both_times():
    y = FirstOrder(1.0).step(T)
    assert rise_times_agree(T, FirstOrder(1.09).step(T), y)
    assert not rise_times_agree(T, FirstOrder(1.12).step(T), y)
    assert not rise_times_agree(T, FirstOrder(50.0).step(T), y)  # never reaches 90 %
    assert not rise_times_agree(T, np.full_like(T, np.nan), y)


def test_bad_responses_are_refused():
    with pytest.raises(DataError, match=r"^expected a finite response of more than two samples, "):
        fit_response(T, np.where(T > 1.0, np.nan, 1.0), "first")
    with pytest.raises(ModelError, match=r"^the response does not reach 10 % within "):
        fit_response(T, np.zeros_like(T), "first")
