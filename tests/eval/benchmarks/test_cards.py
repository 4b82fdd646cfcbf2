"""Judgements of the benchmark of flight cards."""

import pytest

from eval.benchmarks.cards import cases, judged
from eval.diagnosis.blind.cases import BlindPlan


@pytest.mark.parametrize(
    ("kind", "effects", "also", "resolved", "right"),
    [
        ("effects", ["spool_lag"], [], True, True),
        ("effects", ["spool_lag", "sensor_lag:EGT_C"], [], True, True),
        ("effects", ["spool_lag", "heat_soak"], [], True, False),
        ("none", [], [], True, False),
        ("ambiguous", ["spool_lag"], ["sensor_lag:EGT_C"], False, False),
        ("unknown", [], [], False, False),
    ],
)
def test_right_is_a_verdict_of_nothing_but_what_acts(kind, effects, also, resolved, right):
    verdict = {"kind": kind, "effects": effects, "ambiguous_with": also}
    found = judged(["spool_lag", "sensor_lag:EGT_C"], {"verdict": verdict})
    assert (found["resolved"], found["right"]) == (resolved, right)


def test_cases_hold_what_is_to_be_named_and_have_a_lever():
    some = list(cases(BlindPlan(cases=80, seed=3)))
    assert some
    assert all(one.effects and one.share >= 0.05 for one in some)
    assert "lumped_fuel" not in {one.engine for one in some}
