"""The table over outcomes whose every number a person can count."""

import math

import pytest

from eval.gap.blind.page import render, shown, tables
from eval.gap.blind.score import by_gap_share, confusion, scored, table

FAILED = {"schema": "narxcal.blind_failed/1", "kind": "timeout", "reason": "was stopped"}


@pytest.fixture
def outcomes(outcome, answer):
    """Eight cases: what is true, what is said, in turn."""
    null, strange = {"kind": "null", "effects": (), "gap_share": 0.0}, {"kind": "outside"}
    strange = {"kind": "outside", "effects": (), "gap_share": 0.3, "like": ("deterioration",)}
    pair = {"kind": "pair", "effects": ("spool_lag", "sensor_lag:EGT_C"), "gap_share": 0.5}
    lag = {"effects": ("sensor_lag:EGT_C",), "gap_share": 0.07}
    return [
        outcome(name="right"),
        outcome(lag, answer("ambiguous", ("spool_lag",), ("sensor_lag:EGT_C",)), "rival"),
        outcome({"gap_share": 0.03}, answer("none", ()), "small and missed"),
        outcome(null, answer("none", ()), "null"),
        outcome(null, answer("effects"), "null claimed"),
        outcome(strange, answer("unknown", ()), "strange"),
        outcome(pair, answer("effects", ("spool_lag", "sensor_lag:EGT_C")), "pair"),
        outcome(answer=FAILED, name="failed"),
    ]


def value(outcomes, name):
    return {each.name: each.value for each in table(outcomes)}[name]


@pytest.mark.parametrize(
    ("name", "hits", "of"),
    [
        ("false claims on nulls", 1, 2),
        ("firm false claims on nulls", 1, 2),
        ("gap seen, g >= 5 %", 3, 4),
        ("effect claimed, g >= 5 %", 3, 4),
        ("firm claims out of library", 0, 1),
        ("firm claims on mimics", 0, 1),
        ("top-1, ranked first", 2, 4),  # right, pair; the rival came second, one failed
        ("top-1, as answered", 2, 4),
        ("top-2", 3, 4),
        ("family of the first", 2, 4),
        ("right where it claims", 2, 4),
        ("true effect in the named set", 3, 3),
        ("precision of none and unknown", 3, 3),
        ("unknown out of library, g >= 5 %", 1, 1),
        ("channel of most energy", 3, 3),
        ("realised within the interval", 4, 4),
        ("exact pair", 1, 1),
        ("at least one of two", 1, 1),
        ("second effect claimed on one", 0, 2),
        ("cases without an answer", 1, 8),
    ],
)
def test_shares_are_counted_over_the_right_cases(outcomes, name, hits, of):
    found = value(outcomes, name)
    assert (found.hits, found.of) == (hits, of)


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("mean probability of the true effect", (0.9 + 0.1 + 0.9 + 0.0) / 4),
        ("mean size", (1 + 2 + 2) / 3),
        ("overlap (IoU) of 70 % bins", 0.5),
        ("mean absolute error", 0.05),
        ("bias (predicted - realised)", 0.05),
        # Claims are at 0.9 and half of them right.
        ("calibration error (ECE) of claims", 0.4),
        ("median time per case", 12.0),
    ],
)
def test_means_are_taken_over_the_right_cases(outcomes, name, expected):
    assert value(outcomes, name) == pytest.approx(expected)


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("AUC of the best gain, g >= 5 % against nulls", 0.5),
        ("log score (-ln p of the true effect)", -(2 * math.log(0.9) + 2 * math.log(0.1)) / 4),
        ("right among the surest 80 %", 2 / 4),
        ("recovered (realised over g), median", 0.75 / 0.2),
        ("relative error of the size, median", 0.1),
    ],
)
def test_what_is_only_defined_for_some(outcome, answer, name, expected):
    sized = {"value": 1.8, "low": 1.5, "high": 1.9}
    told = answer(effects=("sensor_lag:EGT_C",))
    row = {"id": "sensor_lag", "channel": "EGT_C", "probability": 0.9}
    told["effects"] = [row | {"parameters": {"tau_s": sized}, "gain": {"value": 0.5}}]
    right = outcome({"effects": ("sensor_lag:EGT_C",)}, told, "right")
    right.truth["effects"][0]["parameters"] = {"tau_s": 2.0}
    wrong = outcome({"effects": ("sensor_lag:EGT_C",), "gap_share": 0.2}, answer(), "wrong")
    null = outcome({"kind": "null", "effects": (), "gap_share": 0.0}, told, "null")
    cases = [right, wrong, right._replace(name="again"), wrong._replace(name="again wrong"), null]
    found = value(cases, name)
    if name.startswith("AUC"):  # gains of 0.5, 0, 0.5, 0 against one of 0.5
        expected = (0.5 + 0.0 + 0.5 + 0.0) / 4
    assert found == pytest.approx(expected)


def test_sizes_within_their_intervals_and_slopes(outcome, answer):
    low = answer(shrink={"predicted": {"value": 0.2, "low": 0.1, "high": 0.3}, "realised": 0.1})
    high = answer(shrink={"predicted": {"value": 0.8, "low": 0.7, "high": 0.9}, "realised": 0.7})
    cases = [outcome(answer=low, name="low"), outcome(answer=high, name="high")]
    assert value(cases, "slope of realised over predicted") == pytest.approx(1.0)
    assert math.isnan(value(cases[:1], "slope of realised over predicted"))
    assert value(cases, "true size within its interval").of == 0


def test_where_by_direction_and_band(outcome, answer):
    bands = {"N1_pct": [{"share": 0.7}, {"share": 0.3}]}
    told = answer(quality={"bands": bands})
    known = outcome(answer=told)
    for shares, right in (([0.6, 0.4], 1), ([0.2, 0.8], 0)):
        truth = {**known.truth, "bands": {"N1_pct": shares}}
        assert value([known._replace(truth=truth)], "band of most energy").hits == right
    assert value([known], "band of most energy").of == 0
    assert value([known], "direction of most energy").hits == 1
    rest = {**known.truth, "where": {"N1_pct|steady|steady": 1.0}}
    assert value([known._replace(truth=rest)], "direction of most energy").hits == 0


def test_answers_that_change_are_counted(outcome, answer):
    same, other = answer(), answer("ambiguous", ("spool_lag",), ("sensor_lag:EGT_C",))
    cases = [
        outcome(name="steady")._replace(reruns=(same, same)),
        outcome(name="flips")._replace(reruns=(same, other)),
        outcome(name="once"),
    ]
    assert (value(cases, "cases whose answer changes").hits) == 1
    assert (value(cases, "cases whose answer changes").of) == 2
    assert (value(cases, "reruns with another answer").hits) == 1
    assert (value(cases, "reruns with another answer").of) == 4


def test_several_engines_stand_side_by_side(outcomes, outcome):
    other = outcome(name="lumped")
    other = other._replace(truth={**other.truth, "engine": "lumped_n1"})
    found = tables(scored([*outcomes, other], {}))
    assert [each[0] for each in found] == [
        "Blind test", "By share of the gap", "By engine", "What was said of what"
    ]  # fmt: skip
    assert found[2][1] == ("", "business_jet", "lumped_n1")


def test_folders_stand_side_by_side_four_to_a_table(outcome):
    engines = [f"lumped_n{k}" for k in range(5)]
    rows = [outcome(name=f"{folder}/case_001") for folder in "ABCDE"]
    rows = [o._replace(truth=o.truth | {"engine": e}) for o, e in zip(rows, engines, strict=True)]
    document = scored(rows, {})
    heads = [each[1] for each in tables(document) if each[0].startswith("By f")]
    assert heads == [("", "A", "B", "C", "D"), ("", "E")]
    # By engine as well on the page, where there is room.
    assert not any("By engine" in each[0] for each in tables(document))
    assert "lumped_n4" in render(document)


def test_every_size_stands_beside_the_one_that_was_put_in(outcome, answer):
    told = answer(effects=("sensor_lag:EGT_C",))
    row = {"id": "sensor_lag", "channel": "EGT_C", "probability": 0.9}
    row["parameters"] = {"tau_s": {"value": 1.8, "low": 1.5, "high": 1.9}}
    told["effects"] = [row]
    case = outcome({"effects": ("sensor_lag:EGT_C",)}, told)
    cases = []
    for true in (1.6, 2.0):
        effects = [case.truth["effects"][0] | {"parameters": {"tau_s": true}}]
        cases.append(case._replace(truth=case.truth | {"effects": effects}))
    document = scored(cases, {})
    assert [each["sizes"][0]["inside"] for each in document["outcomes"]] == [True, False]
    assert document["outcomes"][0]["sizes"][0] == {
        "effect": "sensor_lag:EGT_C", "name": "tau_s", "true": 1.6,
        "value": 1.8, "low": 1.5, "high": 1.9, "inside": True,
    }  # fmt: skip
    main = {row[0]: row[2] for row in tables(document)[0][2]}
    assert main["true size within its interval"] == "1 of 2"
    assert '<td class=" num">1.8 [1.5, 1.9]</td><td class="">no</td>' in render(document)


def test_groups_by_share_of_the_gap(outcomes):
    groups = by_gap_share(outcomes)
    assert [row["gap_share"] for row in groups] == [
        "below 2 %", "2-5 %", "5-10 %", "10-25 %", "above 25 %"
    ]  # fmt: skip
    assert [row["cases"] for row in groups] == [0, 1, 1, 2, 1]
    assert [row["top_1"]["hits"] for row in groups] == [0, 1, 0, 1, 1]
    assert [row["claimed"]["hits"] for row in groups] == [0, 0, 1, 1, 1]


def test_the_confusion_matrix_counts_every_case_once(outcomes):
    found = confusion(outcomes)
    assert found == {
        "none": {"none": 1, "spool_lag": 1},
        "sensor_lag:EGT_C": {"spool_lag": 1},
        "spool_lag": {"spool_lag": 2, "none": 1, "failed": 1},
        "unknown": {"unknown": 1},
    }


def test_nothing_at_all_has_no_numbers():
    for each in table([]):
        number = each.value if isinstance(each.value, float) else each.value.value
        assert math.isnan(number)


def test_document_and_page_show_it_all(outcomes, sound_page):
    document = scored(outcomes, {"cases": {"seed": 1}})
    assert document["schema"] == "narxcal.blind_score/1"
    assert document["cases"] == {"null": 2, "outside": 1, "pair": 1, "single": 4}
    assert document["wrong_base"] == 8
    assert list(document["by_style"]) == ["line"]
    assert document["outcomes"][-1]["reason"] == "was stopped"
    assert document["outcomes"][5]["true"] == ["map_kink"]
    assert document["outcomes"][1]["ambiguous_with"] == ["sensor_lag:EGT_C"]
    page = render(document)
    for words in ("Blind test", "top-1, ranked first", "map_kink", "spool_lag", "10-25 %"):
        assert words in page
    sound_page(page)
    assert document["plans"] == {"cases": {"seed": 1}}
    main, shares, confused = tables(document)
    assert ["top-2", "0.75 [0.30, 0.95]", "3 of 4"] in main[2]
    assert len(shares[2]) == 5
    assert ["spool_lag", "4", "2", "failed 1, none 1"] in confused[2]


def test_both_styles_stand_side_by_side(outcomes, outcome):
    other = outcome(name="rich")
    other = other._replace(truth={**other.truth, "style": "enriched"})
    main = tables(scored([*outcomes, other], {}))[0]
    assert main[1] == ("", "all [95 %]", "n", "enriched", "line")


def test_how_numbers_are_shown():
    assert shown({"value": None}) == "-"
    assert shown({"value": float("nan")}) == "-"
    assert shown({"value": 0.12345, "unit": ""}) == "0.123"
    assert shown({"value": 12.0, "unit": "s"}) == "12 s"
    assert shown({"value": 0.5, "of": 2, "low": 0.1, "high": 0.9}) == "0.50 [0.10, 0.90]"


@pytest.mark.slow
def test_a_browser_shows_the_page_without_complaint(outcomes, sound_in_a_browser):
    sound_in_a_browser({"score": render(scored(outcomes, {}))})
