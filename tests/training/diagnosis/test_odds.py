"""Probabilities of the conditional logit."""

from dataclasses import replace

import numpy as np
import pytest

from narxcal.effects import effect
from tests.training.diagnosis.conftest import recorded
from training.diagnosis.dictionary import Dictionary
from training.diagnosis.fit import Frame
from training.diagnosis.layers import FEATURES, OF_CASE, Odds, features, prior, stored_odds
from training.diagnosis.metric import Metric, assumed_variance
from training.diagnosis.nuisances import nuisances


def test_probabilities_are_one_softmax_over_effects_none_and_unknown():
    odds = Odds((1.0,), (np.log(2.0),), (np.log(3.0),), (2.0,), (0.0,))
    names, effects, case = ["a", "sensor_gain:b"], np.array([[0.0], [1.6]]), np.array([1.0])
    assert np.exp(odds.first(names, effects, case)) == pytest.approx(np.array([1, 1, 2, 3]) / 7.0)
    further = np.exp([0.0, 1.6, 0.0])
    assert np.exp(odds.more(names, effects, case)) == pytest.approx(further / further.sum())


def test_a_scale_is_rarer_than_an_offset():
    assert prior("sensor_gain:N1_pct") == prior("driver_gain") < prior("sensor_bias:N1_pct") == 0.0


def test_the_weights_that_are_shipped_fit_the_features():
    odds = stored_odds()
    assert {len(odds.effect), len(odds.further)} == {len(FEATURES)}
    assert {len(odds.none), len(odds.unknown), len(odds.enough)} == {len(OF_CASE)}


def test_how_sure_the_likeliest_effect_is_follows_a_logistic_curve():
    odds = Odds((), (), (), (), (), (np.log(3.0), 1.0))
    assert odds.sure(0.5) == pytest.approx(0.75)  # even odds, three times as often right
    assert odds.sure(0.0) < odds.sure(0.4) < odds.sure(1.0) < 1.0
    assert Odds((), (), (), (), ()).sure(0.3) == pytest.approx(0.3)


def test_features_do_not_depend_on_how_often_the_same_flights_are_there(flights):
    fault = np.array([0.0, 0.0, 3.0]) * np.sin(np.arange(flights.y.shape[1]) / 90.0)[:, None]
    record = recorded(flights, flights.y + fault)
    twice = replace(
        flights,
        u=np.concatenate([flights.u, flights.u]),
        y=np.concatenate([flights.y, flights.y]),
        lengths=np.concatenate([flights.lengths, flights.lengths]),
    )
    double = replace(
        record,
        flights=twice,
        real=np.concatenate([record.real, record.real]),
        unit=np.concatenate([record.unit, record.unit + len(record.unit)]),
        group=tuple(range(2 * len(record.unit))),
    )
    own, other = (_of_drift(each) for each in (record, double))
    size = FEATURES.index("size")
    assert other[size] == pytest.approx(0.5 * own[size])  # a parameter of twice the samples
    rest = np.arange(len(own)) != size
    assert other[rest] == pytest.approx(own[rest], abs=0.05)


def _of_drift(record):
    metric = Metric(record, assumed_variance(record))
    frame = Frame(record, metric, record.gap, nuisances(record))
    dictionary = Dictionary([effect("sensor_drift:EGT_C")], record.flights, None)
    (nodes,) = dictionary.nodes.values()
    effects, _ = features(frame, [frame.fit(nodes)])
    return effects[0]
