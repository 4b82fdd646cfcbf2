"""The table over outcomes whose every number a person can count, and two products compared."""

import math

import numpy as np
import pytest

from eval.diagnosis.blind.score import (
    calibration_error,
    confusion,
    mean,
    rate,
    render,
    scored,
    shown,
    table,
    tables,
)

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
        ("nulls claimed", 1, 2),
        ("firm claims out of library", 0, 1),
        ("top-1, ranked first", 2, 4),  # right, pair; the rival came second, one failed
        ("top-1, as answered", 2, 4),
        ("exact verdict of singles", 1, 3),
        ("claims right", 2, 4),
        ("true effects in the named set", 3, 3),
        ("channel of most energy", 3, 3),
        ("exact pair", 1, 1),
        ("both found", 1, 1),
        ("cases without an answer", 1, 8),
    ],
)
def test_shares_are_counted_over_the_right_cases(outcomes, name, hits, of):
    found = value(outcomes, name)
    assert (found.hits, found.of) == (hits, of)


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("size of the set, mean", (1 + 2 + 1 + 2) / 4),
        ("predicted less realised shrinkage, mean", 0.05),
        # Four claims at 0.9, each a bin of its own: two right, two wrong.
        ("calibration error (ECE)", (2 * 0.1 + 2 * 0.9) / 4),
        ("median time per case", 12.0),
    ],
)
def test_means_are_taken_over_the_right_cases(outcomes, name, expected):
    assert value(outcomes, name) == pytest.approx(expected)


def test_errors_of_shares_are_in_points(outcome, answer):
    true = {"spool_lag": {"share": 0.5, "channels": {}}, "build": {"share": 0.5, "channels": {}}}
    said = [
        {"cause": n, "share": s, "channels": {}} for n, s in (("spool_lag", 0.4), ("build", 0.3))
    ]
    found = [outcome({"budget": true}, answer(budget=said))]
    assert value(found, "error of shares of true effects, mean") == pytest.approx(10.0)
    assert value(found, "error of all shares, mean") == pytest.approx(15.0)


def altered(build, effects, claimed, times, interval=(0.9, 1.1)):
    """A recorded flight with `effects` of `times` the nameable size, 1 s each."""
    rows = {"effects": [], "times_nameable": times, "engine": "real"}
    outcome, answer = build
    told = answer(effects=claimed, listed=dict.fromkeys(claimed or ("spool_lag",), 0.9))
    for name in effects:
        effect, _, channel = name.partition(":")
        parameters = {"skew_s": 1.0}
        rows["effects"].append({"id": effect, "channel": channel, "parameters": parameters})
    for row in told["effects"]:
        low, high = interval
        row["parameters"] = {"skew_s": {"value": 1.0, "low": low, "high": high}}
    found = outcome({"kind": ("null", "single", "pair")[len(effects)]}, told)
    return found._replace(truth={**found.truth, **rows})


def test_altered_flights_count_by_themselves(outcome, answer):
    n1, n2 = "time_skew:N1_pct", "time_skew:N2_pct"
    cases = [
        altered((outcome, answer), (n1,), (n1,), 2.0),
        altered((outcome, answer), (n1,), ("heat_soak", n1), 2.0, (1.2, 1.4)),
        altered((outcome, answer), (n1, n2), (n1,), 2.0),
        altered((outcome, answer), (n1,), (), 0.5),
        altered((outcome, answer), (), (), 0.0),
    ]
    found = {each.name: each.value for each in table(cases)}
    assert found["named, 2 x nameable"][:2] == (3, 4)
    assert found["named with its size, 2 x nameable"][:2] == (2, 4)
    assert found["named, 0.5 x nameable"][:2] == (0, 1)
    assert found["other claims per altered flight"] == pytest.approx(1 / 4)
    assert found["unaltered claimed"][:2] == (0, 1)
    assert found["nulls claimed"].of == 0


def test_several_engines_stand_side_by_side(outcomes, outcome):
    other = outcome(name="lumped")
    other = other._replace(truth={**other.truth, "engine": "lumped_n1"})
    found = tables(scored([*outcomes, other], {}))
    assert [each[0] for each in found] == ["Blind test", "By family", "What was said of what"]
    assert found[1][1] == ("", "virtual", "lumped")


def test_folders_stand_side_by_side_four_to_a_table(outcome):
    engines = [f"engine_{k}" for k in range(5)]
    rows = [outcome(name=f"{folder}/case_001") for folder in "ABCDE"]
    rows = [o._replace(truth=o.truth | {"engine": e}) for o, e in zip(rows, engines, strict=True)]
    document = scored(rows, {})
    heads = [each[1] for each in tables(document) if each[0].startswith("By f")]
    assert heads == [("", "A", "B", "C", "D"), ("", "E")]
    # By family as well on the page, where there is room.
    assert not any("By family" in each[0] for each in tables(document))
    assert "engine_4" in render(document)


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


def test_the_confusion_matrix_counts_every_case_once(outcomes):
    found = confusion(outcomes)
    assert found == {
        "none": {"none": 1, "spool_lag": 1},
        "sensor_lag:EGT_C": {"spool_lag": 1},
        "spool_lag": {"spool_lag": 2, "none": 1, "failed": 1},
        "unknown": {"unknown": 1},
    }


def test_wilson_as_tabulated():
    # 81 of 263, z = 1.96: [0.2553, 0.3662] (R. G. Newcombe, Stat. Med. 17, 1998, 857, table I).
    found = rate([True] * 81 + [False] * 182)
    assert (found.hits, found.of) == (81, 263)
    assert (found.low, found.high) == pytest.approx((0.2553, 0.3662), abs=5e-5)
    # 0 of 20 and 15 of 148, from the same table.
    assert rate([False] * 20)[2:] == pytest.approx((0.0, 0.0, 0.1611), abs=5e-5)
    assert rate([True] * 15 + [False] * 133)[3:] == pytest.approx((0.0624, 0.1605), abs=5e-5)


def test_calibration_error_over_bins_of_equal_mass():
    # Two cases a bin: |1 - 0.1| + |0 - 0.3| ... by hand.
    p = [0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0]
    hit = [1, 0, 0, 0, 1, 0, 1, 1, 1, 1]
    bins = [abs(1 - 0.3), abs(0 - 0.7), abs(1 - 1.1), abs(2 - 1.5), abs(2 - 1.9)]
    assert calibration_error(p, hit) == pytest.approx(sum(bins) / 10)
    order = np.random.default_rng(0).permutation(10)
    assert calibration_error(np.take(p, order), np.take(hit, order)) == pytest.approx(
        sum(bins) / 10
    )
    assert calibration_error([1.0], [True]) == 0.0
    assert math.isnan(calibration_error([], []))
    assert math.isnan(mean([]))


def test_nothing_at_all_has_no_numbers():
    for each in table([]):
        number = each.value if isinstance(each.value, float) else each.value.value
        assert math.isnan(number)


def test_document_and_page_show_it_all(outcomes, sound_page):
    document = scored(outcomes, {"cases": {"seed": 1}})
    assert document["schema"] == "narxcal.blind_score/2"
    assert document["cases"] == {"single": 4, "null": 2, "outside": 1, "pair": 1}
    assert document["outcomes"][-1]["reason"] == "was stopped"
    assert document["outcomes"][5]["true"] == ["map_kink"]
    assert document["outcomes"][1]["ambiguous_with"] == ["sensor_lag:EGT_C"]
    page = render(document)
    for words in ("Blind test", "top-1, ranked first", "map_kink", "spool_lag"):
        assert words in page
    sound_page(page)
    assert document["plans"] == {"cases": {"seed": 1}}
    main, confused = tables(document)
    assert ["claims right", "0.50 [0.15, 0.85]", "2 of 4"] in main[2]
    assert ["spool_lag", "4", "2", "failed 1, none 1"] in confused[2]


def test_how_numbers_are_shown():
    assert shown({"value": None}) == "-"
    assert shown({"value": float("nan")}) == "-"
    assert shown({"value": 0.12345}) == "0.123"
    assert shown({"value": 0.5, "of": 2, "low": 0.1, "high": 0.9}) == "0.50 [0.10, 0.90]"


@pytest.mark.slow
def test_a_browser_shows_the_page_without_complaint(outcomes, sound_in_a_browser):
    sound_in_a_browser({"score": render(scored(outcomes, {}))})
