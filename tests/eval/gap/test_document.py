"""The document has the fixed keys, ranks what was tried, and its summary says the verdict."""

import json
import math
from dataclasses import replace

import pytest

from eval.gap.document import document, effect_rows, probabilities
from eval.gap.effect_words import surest_words
from eval.gap.evidence import Evidence
from eval.gap.realised import channel_shrink, held_out, time_shrink
from eval.gap.rivals import contested, places
from eval.gap.summary import effect_table, sentence, shrink_table, where_table
from eval.gap.verdict_box import next_flights
from eval.gap.where import locate
from narxcal.effects.library import effect
from training.budget.result import Interval

NAME = "sensor_lag:EGT_C"
VALUES = {NAME: {"tau_s": 1.0}}


@pytest.fixture
def evidence(make_data, probe, make_finding, make_model):
    data = make_data(probe, flights=3)
    tried = (
        make_model(NAME, probability=0.6),
        make_model(NAME, "spool_lag", probability=0.3, gain=0.91),
        make_model("time_skew:EGT_C", probability=0.1, gain=0.7),
    )
    held = held_out(VALUES, make_data(probe, flights=2), None)
    after = held_out(VALUES, data, None).after
    where = locate(data, after - data.flights.y)
    times = time_shrink(held.data, held.after, ((), ()))
    finding = make_finding("effects", (NAME,), tried, emulator_rmse={"EGT_C": 0.4})
    predicted = Interval(0.9, 0.8, 1.0)
    shrink = channel_shrink(data, after)
    facts = {"warnings": ["few"]}
    return Evidence(data, finding, where, after, times, predicted, shrink, held, facts)


def test_the_keys_are_those_that_others_rely_on(evidence):
    found = json.loads(json.dumps(document(evidence)))
    assert found["schema"] == "narxcal.gap/1"
    assert found["verdict"] == {
        "kind": "effects",
        "effects": [NAME],
        "ambiguous_with": [],
        "reason": "because",
        "separating_manoeuvre": "fly",
    }
    first = found["effects"][0]
    assert (first["id"], first["channel"], first["family"]) == (
        "sensor_lag",
        "EGT_C",
        "channel lag",
    )
    assert first["parameters"]["tau_s"] == {"value": 1.0, "low": 0.9, "high": 1.1, "unit": "s"}
    assert first["gain"] == {"value": 0.9, "low": 0.8, "high": 0.9}
    assert found["where"][0].items() >= {"channel": "EGT_C", "phase": "transit"}.items()
    assert {"share", "low", "high", "regime", "direction"} <= set(found["where"][0])
    assert found["where"][0]["explained"] > 0.2
    assert sum(row["explained"] for row in found["where"]) == pytest.approx(1.0, abs=0.01)
    assert set(found["side"]) == {"input", "process", "sensor"}
    assert found["shrink"]["predicted"] == {"value": 0.9, "low": 0.8, "high": 1.0}
    assert found["shrink"]["realised"] > 0.98
    assert set(found["shrink"]["channels"]["EGT_C"]) == {"before", "after", "floor"}
    row = found["shrink"]["channels"]["EGT_C"]
    share = 1.0 - (row["after"] / row["before"]) ** 2
    assert found["shrink"]["shares"]["EGT_C"] == pytest.approx(share)
    bands = found["quality"]["bands"]["EGT_C"]
    assert all(band["low"] <= band["share"] <= band["high"] for band in bands)
    power = found["quality"]["regimes"]["power"]
    assert sum(level["share"] for level in power.values()) == pytest.approx(1.0)
    assert found["emulator"] == {"used": True, "rmse": {"EGT_C": 0.4}, "rmse_heldout": {}}
    assert found["quality"]["warnings"] == ["few"]
    assert found["quality"]["pushes"] > 10


def test_an_effect_without_a_channel_has_none(make_finding, make_model):
    rows = effect_rows(make_finding("effects", ("spool_lag",), (make_model("spool_lag"),)))
    assert "channel" not in rows[0]


def test_further_effects_that_did_not_earn_their_place_have_no_probability(evidence):
    chances = probabilities(evidence.finding)
    assert chances[NAME] == pytest.approx(0.80 + 0.18 * 0.6 / 0.7)
    assert chances["spool_lag"] == 0.0
    assert chances["time_skew:EGT_C"] == pytest.approx(1.0 - chances[NAME])
    assert document(evidence)["side"] == {
        "input": 0.0,
        "process": 0.0,
        "sensor": pytest.approx(1.0),
    }


def test_offsets_are_judged_beside_what_moves(make_finding, make_model):
    tried = (make_model(NAME), make_model("sensor_bias:N1_pct"), make_model("spool_lag"))
    finding = make_finding("effects", (NAME, "sensor_bias:N1_pct"), tried)
    assert probabilities(finding)["sensor_bias:N1_pct"] == pytest.approx(0.75 * 0.98)
    assert probabilities(finding)[NAME] == pytest.approx(0.80 + 0.18 * 0.5)
    assert [row["id"] for row in effect_rows(finding)][:2] == ["sensor_lag", "sensor_bias"]


def test_a_firm_claim_is_worth_what_firm_claims_have_been(make_finding, make_model):
    tried = (make_model(NAME, probability=0.5), make_model("spool_lag", probability=0.5))
    chances = probabilities(make_finding("effects", (NAME,), tried))
    assert chances[NAME] == pytest.approx(0.89)
    assert chances["spool_lag"] == pytest.approx(0.11)
    alone = probabilities(make_finding("effects", (NAME,), tried[:1]))
    assert alone[NAME] == pytest.approx(0.98)


def test_a_rival_takes_certainty_away(make_finding, make_model):
    tried = (make_model(NAME),)
    doubted = probabilities(make_finding("ambiguous", (NAME,), tried))
    assert doubted[NAME] == pytest.approx(0.96)
    rivals = (make_model(NAME, probability=0.5), make_model("spool_lag", probability=0.5))
    chances = probabilities(make_finding("ambiguous", (NAME,), rivals))
    assert chances[NAME] == pytest.approx(0.74)
    assert chances["spool_lag"] == pytest.approx(0.26)


def test_the_first_of_many_is_less_sure_than_one_with_a_single_rival(make_finding, make_model):
    tried = (make_model(NAME, probability=0.5), make_model("spool_lag", probability=0.5))
    many = make_finding("ambiguous", (NAME,), tried, ambiguous_with=("spool_lag", "heat_soak"))
    chances = probabilities(many)
    assert chances[NAME] == pytest.approx(0.7)
    assert chances["spool_lag"] == pytest.approx(0.3)


def test_where_nothing_is_claimed_little_probability_is_left(make_finding, make_model):
    tried = (make_model(NAME, gain=1e9),)
    none = make_finding("none", (), tried)
    assert probabilities(none)[NAME] < 0.05
    assert probabilities(make_finding("unknown", (), tried))[NAME] < 0.5
    assert effect_rows(none)[0]["gain"]["value"] == 1.0


@pytest.mark.parametrize(("gain", "leads"), [(0.95, True), (0.85, False)])
def test_an_offset_that_is_nearly_all_of_a_gap_is_ranked_first(
    gain, leads, make_finding, make_model
):
    """Within build scatter, so that nothing is claimed; but what there is."""
    tried = (make_model("heat_soak"), make_model("deterioration", gain=gain))
    rows = effect_rows(make_finding("none", (), tried))
    order = ["deterioration", "heat_soak"] if leads else ["heat_soak", "deterioration"]
    assert [row["id"] for row in rows] == order
    assert rows[0]["probability"] < 0.05


def test_gap_beyond_the_library_keeps_the_side_of_its_shape(evidence):
    unknown = replace(evidence.finding, kind="unknown", effects=())
    found = document(replace(evidence, finding=unknown, held_out=None))
    assert found["side"] == evidence.where.side._asdict()
    assert found["shrink"]["realised"] is None
    assert found["shrink"]["channels"]["EGT_C"]["before"] == evidence.channels["EGT_C"].before
    assert found["shrink"]["on"] == "the flights of the diagnosis"


@pytest.mark.parametrize(
    ("kind", "words"),
    [
        ("none", "No gap beyond noise and build scatter. Because."),
        ("unknown", "The gap is real, but no effect of the library accounts for it: because."),
        (
            "effects",
            (
                "What differs: lag of the EGT sensor (sensor_lag:EGT_C); adding it to the "
                "simulator takes away 90 % of the gap (90 % interval 80 to 100 %; 99 % on "
                "held-out flights)."
            ),
        ),
        (
            "ambiguous",
            (
                "What differs: lag of the EGT sensor (sensor_lag:EGT_C), or just as well time "
                "constants of both spools scaled (spool_lag); adding the first to the simulator "
                "takes away 90 % of the gap (90 % interval 80 to 100 %; 99 % on held-out flights)."
            ),
        ),
    ],
)
def test_the_verdict_in_one_sentence(evidence, kind, words):
    found = document(evidence)
    found["verdict"] |= {"kind": kind, "ambiguous_with": ["spool_lag"]}
    found["shrink"]["realised"] = 0.99
    assert sentence(found) == words


PAIR = ("bleed_extraction", "flowmeter_dynamics:FF_kgph")


def of_two(make_finding, make_model, rivals, *models):
    """A finding of two effects with rivals, that of best models first."""
    tried = tuple(make_model(*names) for names in (PAIR, *models))
    return make_finding("ambiguous", PAIR, tried, ambiguous_with=rivals)


def test_rivals_of_one_of_two_effects_are_told_as_such(evidence, make_finding, make_model):
    """They take the place of the flow meter, and its manoeuvre is the one that separates them."""
    rivals = ("sensor_lag:FF_kgph", "time_skew:FF_kgph")
    models = [("bleed_extraction", name) for name in rivals]
    finding = of_two(make_finding, make_model, rivals, *models)
    found = document(replace(evidence, finding=finding))
    assert sentence(found).startswith(
        "What differs: bleed that follows the logged switches (bleed_extraction) and lag of the "
        "fuel flowmeter (flowmeter_dynamics:FF_kgph); in the place of flowmeter_dynamics:FF_kgph "
        "just as well lag of the FF sensor (sensor_lag:FF_kgph) or FF recorded late "
        "(time_skew:FF_kgph); adding the first 2 to the simulator takes away "
    )
    assert found["verdict"]["separating_manoeuvre"] == effect(PAIR[1]).manoeuvre
    assert next_flights(found)[0] == (
        effect(PAIR[1]).manoeuvre,
        "separates flowmeter_dynamics:FF_kgph from sensor_lag:FF_kgph and time_skew:FF_kgph",
    )


@pytest.mark.parametrize(
    ("claimed", "rivals", "models", "expected"),
    [
        (("a",), ("b", "c"), [("a",), ("b",)], {"a": ["b", "c"]}),
        (("a", "b"), ("c", "d"), [("a", "c"), ("d", "b")], {"b": ["c"], "a": ["d"]}),
        (("a", "b"), ("c", "d"), [("c", "d")], {"a and b": ["c", "d"]}),
        (
            ("throttle_bias", "actuator_lag"),
            ("throttle_delay", "deterioration"),
            [("throttle_delay",), ("deterioration",)],
            {"actuator_lag": ["throttle_delay"], "throttle_bias": ["deterioration"]},
        ),
        (("a", "b"), (), [], {}),
    ],
)
def test_a_rival_takes_the_place_of_what_its_model_leaves_out(claimed, rivals, models, expected):
    assert places(claimed, rivals, models) == expected
    lost = {name for place in expected for name in place.split(" and ")}
    assert contested(claimed, rivals, models) == [name for name in claimed if name in lost]


def test_one_flight_is_one_flight(evidence):
    held = replace(evidence.held_out, data=replace(evidence.held_out.data, names=("f",)))
    shrink = document(replace(evidence, held_out=held))["shrink"]
    assert shrink["on"] == "1 flight that took no part"


def test_a_reason_is_not_said_twice(evidence):
    found = document(evidence)
    reason = "the gap is real, but the best effect takes only 0% of it"
    found["verdict"] |= {"kind": "unknown", "reason": reason}
    assert sentence(found) == (
        "The gap is real, but no effect of the library accounts for it: "
        "the best effect takes only 0 % of it."
    )


def test_tables_fit_on_one_screen(evidence):
    found = document(evidence)
    tables = [effect_table(found), where_table(found), shrink_table(found)]
    assert sum(len(rows) + 2 for _, _, rows in tables) < 24
    for _, head, rows in tables:
        assert rows
        assert all(len(row) == len(head) for row in rows)
    assert tables[0][2][0][0] == "sensor_lag:EGT_C *"
    assert tables[2][2][-1][-1] == "– -> –"  # noqa: RUF001 - the dash of the page


def test_without_a_claim_there_is_no_after(evidence):
    found = document(evidence)
    found["verdict"] |= {"kind": "unknown", "effects": []}
    title, head, rows = shrink_table(found)
    assert title == "How large the gap is, on 2 flights that took no part"
    assert head == ("channel", "RMSE", "floor", "Ti error [s]", "Tt error [s]")
    assert all(len(row) == len(head) for row in rows)
    assert not any("->" in cell for row in rows for cell in row)


def test_an_effect_that_is_not_claimed_shows_what_it_is_worth_alone(make_finding, make_model):
    pair = make_model(NAME, "spool_lag", gain=0.95)
    alone = make_model("spool_lag", gain=0.1)
    rows = effect_rows(make_finding("effects", (NAME,), (make_model(NAME), pair, alone)))
    assert rows[1]["gain"]["value"] == 0.1
    rows = effect_rows(
        make_finding("effects", (NAME, "spool_lag"), (pair, make_model(NAME), alone))
    )
    assert [row["gain"]["value"] for row in rows] == [0.95, 0.95]


def test_the_terminal_tells_sizes_as_the_page_does(evidence):
    found = document(evidence)
    _, _, rows = effect_table(found)
    (first,) = (row for row in found["effects"] if row["id"] == "sensor_lag")
    assert rows[0][3] == surest_words(first) == "tau_s 1.00 s (0.90 to 1.10)"


@pytest.mark.parametrize(
    ("predicted", "told"),
    [
        (Interval(0.9, 0.8, 1.0), (0.9, 0.8, 1.0)),
        (Interval(1.1, 0.8, 1.3), (1.0, 0.8, 1.0)),
        (Interval(0.4, -math.inf, math.inf), (0.4, -1.0, 1.0)),
        (Interval(0.4, math.nan, math.nan), (0.4, -1.0, 1.0)),
    ],
)
def test_a_prediction_is_a_share_with_ends_whatever_is_known(evidence, predicted, told):
    found = document(replace(evidence, predicted=predicted))["shrink"]["predicted"]
    assert tuple(found.values()) == told
