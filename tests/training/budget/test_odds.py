"""Probabilities of the conditional logit."""

import numpy as np
import pytest

from training.budget.odds import FEATURES, OF_CASE, Odds, load, prior


def test_probabilities_are_one_softmax_over_effects_none_and_unknown():
    odds = Odds((1.0,), (np.log(2.0),), (np.log(3.0),), (2.0,), (0.0,))
    names, effects, case = ["a", "sensor_gain:b"], np.array([[0.0], [1.6]]), np.array([1.0])
    assert np.exp(odds.first(names, effects, case)) == pytest.approx(np.array([1, 1, 2, 3]) / 7.0)
    further = np.exp([0.0, 1.6, 0.0])
    assert np.exp(odds.more(names, effects, case)) == pytest.approx(further / further.sum())


def test_a_scale_is_rarer_than_an_offset():
    assert prior("sensor_gain:N1_pct") == prior("driver_gain") < prior("sensor_bias:N1_pct") == 0.0


def test_the_weights_that_are_shipped_fit_the_features():
    odds = load()
    assert {len(odds.effect), len(odds.further)} == {len(FEATURES)}
    assert {len(odds.none), len(odds.unknown), len(odds.enough)} == {len(OF_CASE)}


def test_how_sure_the_likeliest_effect_is_follows_a_logistic_curve():
    odds = Odds((), (), (), (), (), (np.log(3.0), 1.0))
    assert odds.sure(0.5) == pytest.approx(0.75)  # even odds, three times as often right
    assert odds.sure(0.0) < odds.sure(0.4) < odds.sure(1.0) < 1.0
    assert Odds((), (), (), (), ()).sure(0.3) == pytest.approx(0.3)
