"""The scikit-learn-like door: fit, simulate, predict, score, clone."""

import doctest

import numpy as np
import pytest
from sklearn.base import clone, is_regressor

import training.estimator
from narxcal import Narx, NarxConfig
from narxcal.errors import ModelError
from narxcal.records import Record
from training.config import TrainConfig

QUICK = TrainConfig(horizons_s=(20.0, 0.0), iterations=(5, 10), score_every_s=1.0, threads=1)
STRUCTURE = NarxConfig(lags=1, taps=(0,), hidden=3)


def test_the_example_of_its_documentation_runs():
    result = doctest.testmod(training.estimator)
    assert result.attempted > 4
    assert result.failed == 0


def test_it_learns_simulates_predicts_and_scores(lag_record):
    model = Narx(STRUCTURE, QUICK).fit([lag_record(0), lag_record(1)])
    unseen = lag_record(5)
    assert model.score([unseen]) > 0.99
    free_run = model.simulate(unseen.u[:, 0], unseen.y[0])
    assert free_run.shape == unseen.y.shape
    error = free_run[1:] - unseen.y[1:]
    spread = unseen.y[1:] - unseen.y.mean()
    by_hand = 1.0 - (error**2).sum() / (spread**2).sum()
    assert model.score([unseen]) == pytest.approx(by_hand)
    steps = model.predict(unseen.u[:, 0], unseen.y[:, 0])
    assert np.isnan(steps[0]).all()
    np.testing.assert_allclose(steps[1:], unseen.y[1:], atol=0.05)


def test_scores_leave_masked_samples_out(lag_record):
    record = lag_record(0)
    model = Narx(STRUCTURE, QUICK).fit([record])
    masked = record.y.copy()
    masked[100:150] = np.nan
    assert model.score([Record(record.u, masked)]) > 0.99


def test_before_fit_it_says_so():
    with pytest.raises(ModelError) as error:
        Narx().simulate(np.zeros(5), [0.0])
    assert str(error.value) == "the NARX network is not trained yet. Call fit first"


def test_scikit_learn_can_clone_it_and_knows_what_it_is():
    model = Narx(STRUCTURE, QUICK, dt_s=0.5)
    copy = clone(model)
    assert copy is not model
    assert copy.get_params() == model.get_params()
    assert is_regressor(model)
    assert repr(model).startswith("Narx(")
