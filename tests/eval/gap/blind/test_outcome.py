"""One case with its answer: every word on it follows from the two."""

import pytest

from eval.gap.blind.oracle import channel_of_most, core


def test_a_right_answer(outcome):
    found = outcome()
    assert (found.said, found.true_label, found.verdict) == ("spool_lag",) * 2 + ("effects",)
    assert found.first(1)
    assert found.family_first
    assert found.claims
    assert found.named_set == ("spool_lag",)
    assert found.channel_right
    assert found.shrinkage == ({"value": 0.8, "low": 0.7, "high": 0.9}, 0.75)
    # Said: push 0.6 and pull 0.4 hold 70 % together; truly the push alone does.
    said, true = found.overlap_of
    assert said == {"N1_pct|push|transit", "N1_pct|pull|transit"}
    assert true == {"N1_pct|push|transit"}


def test_a_rival_and_a_channel(outcome, answer):
    found = outcome(
        {"effects": ("sensor_lag:EGT_C",)},
        answer("ambiguous", ("spool_lag",), ("sensor_lag:EGT_C",)),
    )
    assert found.named_set == ("spool_lag", "sensor_lag:EGT_C")
    assert found.true_effects == ("sensor_lag:EGT_C",)
    assert (found.first(1), found.first(2), found.family_first) == (False, True, False)
    assert found.true_label == "sensor_lag:EGT_C"


def test_of_a_pair_either_may_be_named(outcome):
    found = outcome({"kind": "pair", "effects": ("sensor_lag:EGT_C", "spool_lag")})
    assert found.true_label == "spool_lag"


@pytest.mark.parametrize(
    ("kind", "verdict", "label"),
    [("null", "none", "none"), ("outside", "unknown", "unknown"), ("single", "none", "spool_lag")],
)
def test_labels_of_what_has_no_effect(outcome, answer, kind, verdict, label):
    effects = ("spool_lag",) if kind == "single" else ()
    found = outcome({"kind": kind, "effects": effects}, answer(verdict, ()))
    assert (found.true_label, found.said) == (label, verdict)
    assert not found.claims
    assert found.shrinkage is None


def test_a_failure_claims_nothing_and_is_right_in_nothing(outcome):
    found = outcome(answer={"schema": "narxcal.blind_failed/1", "kind": "timeout", "reason": "x"})
    assert found.failed
    assert (found.said, found.verdict, found.named_set) == ("failed", "failed", ())
    said = (found.first(1), found.family_first, found.claims, found.channel_right)
    assert not any(said)
    assert found.probabilities == {}
    assert found.seconds is None


def test_the_core_is_the_smallest_set_that_holds_enough():
    assert core({"a": 0.5, "b": 0.3, "c": 0.2}) == {"a", "b"}
    assert core({"a": 0.7, "b": 0.3}) == {"a"}
    assert core({"a": 2.0, "b": 2.0, "c": 2.0, "d": 2.0}) == {"a", "b", "c"}
    assert core({}) == set()


def test_the_channel_is_that_of_all_its_bins():
    shares = {"N1_pct|push|transit": 0.4, "EGT_C|push|transit": 0.3, "EGT_C|steady|steady": 0.3}
    assert channel_of_most(shares) == "EGT_C"
    assert channel_of_most({}) is None
