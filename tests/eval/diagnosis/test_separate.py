"""Distances between hypotheses: against the whole covariance, and against likelihood ratios."""

import numpy as np
import pytest

from eval.diagnosis.separate import Columns, Hypothesis, _hypotheses
from narxcal.effects.library import effect
from narxcal.effects.running import Flights

MOVES, STEPS, OUTPUTS = 3, 20, 2
VARIANCE = np.array([0.5, 2.0])
SIGNALS = {
    "inputs": ["TRA_deg"],
    "outputs": ["N1_pct", "EGT_C"],
    "dt_s": 0.2,
    "driver": "TRA_deg",
    "low": [20.0, 300.0],
    "high": [100.0, 800.0],
    "lever": [0.0, 85.0],
    "active": ["TRA_deg"],
}


@pytest.fixture
def drawn():
    """Columns of three hypotheses behind four shared ones, and moves of several lengths."""
    random = np.random.default_rng(5)
    names = ("sensor_bias:EGT_C", "sensor_gain:EGT_C", "sensor_bias:N1_pct")
    none = np.zeros(1)
    hypotheses = [
        Hypothesis(effect(name), none, none, chance)
        for name, chance in zip(names, (0.6, 0.3, 0.1), strict=True)
    ]
    values = 0.4 * random.normal(size=(4 + 3 + 3, MOVES, STEPS, OUTPUTS))
    columns = Columns(values, 4, [range(4, 5), range(5, 6), range(6, 7)], hypotheses)
    lengths = np.array([20, 12, 7])
    empty = np.zeros((MOVES, STEPS, OUTPUTS))
    return columns, Flights(None, empty, empty, lengths)


def dense(columns, flights):
    """Rows (k, samples * outputs) of all moves, and the variance of each sample."""
    parts = [columns.values[:, m, :n].reshape(len(columns.values), -1)
             for m, n in enumerate(flights.lengths)]  # fmt: skip
    rows = np.concatenate(parts, axis=1)
    return rows, np.tile(VARIANCE, rows.shape[1] // OUTPUTS)


def test_the_distance_is_that_of_the_whole_covariance(drawn):
    columns, flights = drawn
    gram = columns.grams(flights, VARIANCE).sum(axis=0)
    rows, variance = dense(columns, flights)
    for i, j in ((0, 1), (0, 2), (1, 2)):
        n = rows[[0, 1, 2, 3, 4 + i, 4 + j]]
        change = rows[7 + i] - rows[7 + j]
        expected = change @ np.linalg.solve(np.diag(variance) + n.T @ n, change)
        assert columns.squared_distance(gram, i, j) == pytest.approx(expected)


def test_the_mean_divergence_weighs_pairs_by_their_probabilities(drawn):
    columns, flights = drawn
    grams = columns.grams(flights, VARIANCE)
    weights = {(0, 1): 0.18, (0, 2): 0.06, (1, 2): 0.03}
    expected = sum(w * columns.squared_distance(grams, *pair) for pair, w in weights.items())
    np.testing.assert_allclose(columns.divergence(grams), 0.5 * expected / 0.27)


def test_another_move_never_brings_hypotheses_nearer(drawn):
    columns, flights = drawn
    grams = columns.grams(flights, VARIANCE)
    assert columns.divergence(grams[:2].sum(axis=0)) >= columns.divergence(grams[0]) - 1e-12


def test_likelihoods_are_right_as_often_as_the_chance_says(drawn):
    columns, flights = drawn
    gram = 0.1 * columns.grams(flights, VARIANCE).sum(axis=0)
    (_, _, chance), *_ = columns.chances(gram)
    rows, variance = dense(columns, flights)
    rows = np.sqrt(0.1) * rows
    n, change = rows[[0, 1, 2, 3, 4, 5]], rows[7] - rows[8]
    covariance = np.diag(variance) + n.T @ n
    random = np.random.default_rng(8)
    drawn_ = random.multivariate_normal(rows[7], covariance, size=20_000)
    ratio = (drawn_ - 0.5 * (rows[7] + rows[8])) @ np.linalg.solve(covariance, change)
    assert np.mean(ratio > 0.0) == pytest.approx(chance, abs=0.012)


def gap(kind, effects=(), also=(), none=0.0, **chances):
    rows = [
        {"id": name, "channel": "EGT_C", "probability": chance, "parameters": {}}
        for name, chance in chances.items()
    ]
    verdict = {"kind": kind, "effects": list(effects), "ambiguous_with": list(also), "none": none}
    return {"verdict": verdict, "effects": rows, "quality": {"signals": SIGNALS}}


@pytest.mark.parametrize(
    ("document", "names"),
    [
        (
            gap("ambiguous", ["sensor_bias:EGT_C"], ["sensor_gain:EGT_C"], sensor_lag=0.3,
                sensor_bias=0.4, sensor_gain=0.3),
            ["sensor_bias:EGT_C", "sensor_gain:EGT_C"],
        ),
        (
            gap("unknown", sensor_lag=0.3, sensor_bias=0.02, sensor_gain=0.1),
            ["sensor_lag:EGT_C", "sensor_gain:EGT_C", "no effect"],
        ),
        (gap("unknown", none=0.2, sensor_lag=0.7), ["sensor_lag:EGT_C", "no effect"]),
        (gap("effects", ["sensor_lag:EGT_C"], sensor_lag=0.9), []),
        (gap("none", sensor_lag=0.1), []),
    ],
)  # fmt: skip
def test_hypotheses_are_what_the_diagnosis_leaves_open(document, names):
    assert [one.name for one in _hypotheses(document)] == names
