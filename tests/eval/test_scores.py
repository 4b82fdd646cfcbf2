"""Metrics against their definitions written out, on masked matrices."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.testing import assert_allclose

from eval.judging.scores import fit_percent, max_relative_percent, nrmse, rmse

ALL = (rmse, nrmse, fit_percent, max_relative_percent)
MEASURED = np.array([[1.0, 10.0], [2.0, 20.0], [3.0, 30.0], [4.0, 40.0]])
MODEL = np.array([[1.0, 11.0], [3.0, 20.0], [3.0, 29.0], [4.0, 44.0]])

values = st.floats(-1e3, 1e3).map(lambda x: round(x, 6))
pairs = st.integers(2, 30).flatmap(
    lambda n: st.tuples(
        arrays(float, (n, 2), elements=values), arrays(float, (n, 2), elements=values)
    )
)


def test_figures_of_a_small_example():
    assert_allclose(rmse(MEASURED, MODEL), [np.sqrt(1 / 4), np.sqrt(18 / 4)])
    assert_allclose(nrmse(MEASURED, MODEL), [0.5 / np.sqrt(1.25), np.sqrt(4.5 / 125)])
    assert_allclose(
        fit_percent(MEASURED, MODEL),
        [100 * (1 - 1 / np.sqrt(5.0)), 100 * (1 - np.sqrt(18 / 500))],
    )
    assert_allclose(max_relative_percent(MEASURED, MODEL), [50.0, 10.0])


def test_a_perfect_model_has_no_error():
    assert_allclose(rmse(MEASURED, MEASURED), 0.0)
    assert_allclose(nrmse(MEASURED, MEASURED), 0.0)
    assert_allclose(fit_percent(MEASURED, MEASURED), 100.0)
    assert_allclose(max_relative_percent(MEASURED, MEASURED), 0.0)


def test_the_mean_as_model_has_fit_zero():
    mean = np.broadcast_to(MEASURED.mean(axis=0), MEASURED.shape)
    assert_allclose(fit_percent(MEASURED, mean), 0.0, atol=1e-12)


@given(pairs, st.data())
def test_nan_and_mask_leave_out_samples_of_their_channel_only(pair, data):
    """As if the samples had never been there."""
    measured, model = pair
    keep = data.draw(arrays(bool, len(measured)))
    holes = data.draw(arrays(bool, measured.shape))
    gappy = np.where(holes, np.nan, measured)
    for metric in ALL:
        found = metric(gappy, model, keep)
        for column in range(2):
            rows = keep & ~holes[:, column]
            if not rows.any():
                assert np.isnan(found[column])
                continue
            alone = metric(measured[rows, column, None], model[rows, column, None])
            assert_allclose(found[column], alone[0], rtol=1e-6, atol=1e-9)


def test_a_stopped_engine_does_not_make_the_relative_error_infinite():
    measured = np.array([[100.0], [0.0]])
    model = np.array([[101.0], [0.5]])
    assert_allclose(max_relative_percent(measured, model), [10.0])


def test_constant_measurement_has_no_nrmse_and_no_fit():
    flat = np.full((5, 1), 3.0)
    assert np.isnan(nrmse(flat, flat + 1.0)).all()
    assert np.isnan(fit_percent(flat, flat + 1.0)).all()
