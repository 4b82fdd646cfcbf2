"""The calibration of the logits: known weights are recovered, and right answers are labelled so."""

import json

import numpy as np
import pytest

from eval.diagnosis.blind.calibrate import Choice, fit, fitted, left_out, read_case, written
from training.diagnosis.layers import FEATURES, OF_CASE, stored_odds

EFFECTS = ("a", "b", "c")


def drawn(weights, count=4000, seed=0):
    """Choices between three effects and none, as often right as known weights say."""
    random = np.random.default_rng(seed)
    found = []
    for _ in range(count):
        features, case = random.normal(size=(3, 2)), np.array([1.0, random.normal()])
        one = Choice(EFFECTS, features, case, 1, np.zeros(4, dtype=bool))
        scores = one.design() @ weights
        right = random.choice(4, p=np.exp(scores) / np.exp(scores).sum())
        found.append(Choice(EFFECTS, features, case, 1, np.arange(4) == right))
    return found


def test_weights_of_a_conditional_logit_are_recovered():
    weights = np.array([1.5, -0.7, 0.4, 0.9])
    assert fitted(drawn(weights)) == pytest.approx(weights, abs=0.12)


def test_weights_that_no_choice_tells_of_stay_at_the_given_ones():
    silent = Choice(EFFECTS, np.zeros((3, 2)), np.zeros(2), 1, np.arange(4) == 0)
    assert fitted([silent], np.array([3.0, -2.0])).tolist() == [3.0, -2.0, 0.0, 0.0]


def stored(folder, name, kind, effects, share, *, engine="lumped_n1"):
    """What `weigh` leaves of a case: features that point at `a`, and at `b` beside it."""
    truth = {
        "kind": kind,
        "engine": engine,
        "gap_share": share,
        "effects": [{"id": each, "channel": None} for each in effects],
        "budget": {each: {"share": share / max(1, len(effects))} for each in effects},
        "outside": {"id": "something"} if kind == "outside" else None,
    }
    size = len(FEATURES)
    row = {"effects": np.eye(3, size).tolist(), "case": [1.0] * len(OF_CASE)}
    beside = {"leader": "a", "names": ["b", "c"], "effects": np.eye(2, size).tolist()}
    beside["case"] = row["case"]
    document = {"truth": truth, "names": list(EFFECTS), **row, "further": [beside]}
    (folder / f"{name}.json").write_text(json.dumps(document), encoding="utf-8")
    return read_case(folder / f"{name}.json")


@pytest.mark.parametrize(
    ("content", "right", "beside"),
    [
        (("single", ["a"], 0.5), ["a"], ["none"]),
        (("single", ["a"], 0.01), ["a", "none", "unknown"], ["none"]),
        (("pair", ["a", "b"], 0.5), ["a", "b"], ["b"]),
        (("pair", ["a", "b"], 0.06), ["a", "b"], ["b", "none"]),  # the other is 3 % of the gap
        (("null", [], 0.0), ["none"], ["none"]),
        (("outside", [], 0.5), ["unknown"], ["none"]),
        (("single", ["not_tried"], 0.5), ["none", "unknown"], ["none"]),
    ],
)
def test_answers_that_are_right(tmp_path, content, right, beside):
    case = stored(tmp_path, "case", *content)
    answers = np.array([*EFFECTS, "none", "unknown"])
    assert answers[case.first.right].tolist() == right
    assert np.array(["b", "c", "none"])[case.further["a"].right].tolist() == beside


def test_an_effect_that_is_right_more_often_than_its_share_says_is_surer(tmp_path):
    # Two effects that act share the softmax, and either is right.
    cases = [
        stored(tmp_path, f"{engine}{k}", *content, engine=engine)
        for engine in ("maker", "lumped", "foreign")
        for k, content in enumerate([("pair", ["a", "b"], 0.5)] * 8 + [("null", [], 0.0)] * 2)
    ]
    named = [each.sureness for each in left_out(cases) if each.kind == "pair"]
    assert np.mean(named) == pytest.approx(0.8, abs=0.1)
    assert fit(cases).acts != (0.0, 1.0)


def test_what_is_written_can_be_loaded_and_says_what_it_rests_on(tmp_path):
    cases = [
        stored(tmp_path, "one", "single", ["a"], 0.5),
        stored(tmp_path, "two", "pair", ["a", "b"], 0.5, engine="maker"),
        stored(tmp_path, "three", "null", [], 0.0, engine="business_jet"),
    ]
    text = written(cases, tmp_path / "odds.json")
    assert text["families"] == {"lumped": 1, "maker": 1, "virtual": 1}
    assert text["family_left_out"]["cases"] == 3
    assert stored_odds(tmp_path / "odds.json") == fit(cases)
