"""One case with its answer: every word on it follows from the two."""

import pytest

FUEL_LATE = {"id": "throttle_delay", "channel": None, "parameters": {"delay_s": -0.14}}


def test_a_right_answer(outcome):
    found = outcome()
    assert (found.said, found.true_label, found.verdict) == ("spool_lag",) * 2 + ("effects",)
    assert found.found
    assert found.exact
    assert found.firm
    assert found.named_set == ("spool_lag",)
    assert found.sureness == 0.9
    assert found.channel_right
    assert found.shrinkage == (0.8, 0.75)
    assert found.others == 0


def test_a_rival_and_its_rank(outcome, answer):
    found = outcome(
        {"effects": ("sensor_lag:EGT_C",)},
        answer("ambiguous", ("spool_lag",), ("sensor_lag:EGT_C",)),
    )
    assert found.named_set == ("spool_lag", "sensor_lag:EGT_C")
    assert found.true_effects == ("sensor_lag:EGT_C",)
    assert (found.found, found.exact, found.firm, found.others) == (False, False, False, 1)
    assert found.true_label == "sensor_lag:EGT_C"
    # An answer of two names is not exact, even if the right one stands first.
    right = outcome(answer=answer("ambiguous", ("spool_lag",), ("sensor_lag:EGT_C",)))
    assert (right.found, right.exact) == (True, False)


def test_of_a_pair_either_may_be_named(outcome):
    found = outcome({"kind": "pair", "effects": ("sensor_lag:EGT_C", "spool_lag")})
    assert found.true_label == "spool_lag"
    assert not found.exact


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
    assert not any((found.found, found.exact, found.claims, found.channel_right))
    assert (found.sureness, found.seconds, found.share_errors) == (0.0, None, {})


def test_an_effect_has_to_be_named_from_five_percent_of_the_gap_on(outcome):
    assert outcome({"gap_share": 0.05}).nameable
    assert not outcome({"gap_share": 0.049}).nameable
    assert not outcome({"kind": "outside", "effects": ()}).nameable


@pytest.mark.parametrize(("times", "nameable"), [(2.0, True), (1.0, True), (0.5, False)])
def test_on_a_real_flight_it_is_the_size_that_counts_and_being_named(
    outcome, answer, times, nameable
):
    listed = {"heat_soak": 0.99, "throttle_delay": 0.95}
    told = answer(effects=tuple(listed), listed=listed)
    told["effects"][1]["parameters"] = {"delay_s": {"value": -0.15, "low": -0.18, "high": -0.13}}
    found = outcome(answer=told)
    truth = {**found.truth, "effects": [FUEL_LATE], "times_nameable": times, "engine": "real"}
    found = found._replace(truth=truth)
    assert (found.altered, found.family, found.nameable) == (True, "real", nameable)
    # Heat soak stands first; the late fuel meter is among those named.
    assert found.found
    assert not found.exact
    assert found.claimed == ("heat_soak", "throttle_delay")
    assert found.others == 1
    assert [(m.effect, m.true, m.inside) for m in found.magnitudes] == [
        ("throttle_delay", -0.14, True)
    ]


def test_the_channel_is_that_of_all_effects_of_the_budget(outcome, answer):
    rows = [
        {"cause": "spool_lag", "share": 0.4, "channels": {"N1_pct": 0.3, "EGT_C": 0.1}},
        {"cause": "build", "share": 0.6, "channels": {"N1_pct": 0.0, "EGT_C": 0.6}},
    ]
    assert outcome(answer=answer(budget=rows)).channel_right
    true = {"spool_lag": {"share": 0.5, "channels": {"N1_pct": 0.1, "EGT_C": 0.4}}}
    found = outcome({"budget": true}, answer(budget=rows))
    assert found.channel_right is False


def test_shares_are_compared_cause_by_cause(outcome, answer):
    true = {"spool_lag": 0.5, "build": 0.2, "noise": 0.2, "unexplained": 0.1, "offsets": 0.0}
    true = {name: {"share": share, "channels": {}} for name, share in true.items()}
    said = {"spool_lag": 0.4, "heat_soak": 0.3, "build": 0.2, "noise": 0.1}
    rows = [{"cause": n, "share": s, "channels": {}} for n, s in said.items()]
    found = outcome({"budget": true}, answer(budget=rows)).share_errors
    assert found == pytest.approx({
        "build": 0.0, "heat_soak": 0.3, "noise": -0.1, "offsets": 0.0, "spool_lag": -0.1,
        "unexplained": -0.1,
    })  # fmt: skip
    assert outcome({"budget": true}).share_errors == {}
