"""The page of a diagnosis says what its document says, safely, for every verdict and any gap."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from eval.gap import charts, heat_maps, page_tables
from eval.gap.document import document
from eval.gap.evidence import Evidence
from eval.gap.expected import expected, seen
from eval.gap.overlays import event_picture, views, worst_event, worst_flight
from eval.gap.page import drawn_effects, gap_page
from eval.gap.realised import channel_shrink, held_out, time_shrink
from eval.gap.verdict_box import next_flights, tiles, verdict_box
from eval.gap.where import locate
from training.budget.result import Interval

NAME = "sensor_lag:EGT_C"
VALUES = {NAME: {"tau_s": 1.0}}
HOSTILE = '<script>alert("x")</script> & co'
SKEW = {"time_skew:EGT_C": {"skew_s": Interval(0.7, 0.65, 0.75)}}
KINDS = ("none", "effects", "ambiguous", "unknown")


@pytest.fixture
def evidence(make_data, probe, make_finding, make_model):
    """A probe lag of 1 s: three flights diagnosed, two held out."""
    data = make_data(probe, flights=3, duration_s=80.0)
    tried = (
        make_model(NAME, probability=0.7),
        make_model("time_skew:EGT_C", probability=0.1, gain=0.7, parameters=SKEW),
        make_model(NAME, "spool_lag", probability=0.2, gain=0.91),
    )
    held = held_out(VALUES, make_data(probe, flights=2, duration_s=80.0), None)
    after = held_out(VALUES, data, None).after
    where = locate(data, after - data.flights.y)
    rmse = {"EGT_C": 80.0, "N1_pct": 0.001}
    return Evidence(
        data=data,
        finding=make_finding("effects", (NAME,), tried, emulator_rmse=rmse),
        where=where,
        after=after,
        times=time_shrink(data, after, where.events),
        predicted=expected(seen(data, after, None)),
        channels=channel_shrink(data, after),
        held_out=held,
        facts={"warnings": [f"few flights {HOSTILE}"], "flights": list(data.names)},
    )


def with_verdict(evidence, kind):
    """The same flights with another answer."""
    claims = kind in ("effects", "ambiguous")
    rivals = ("time_skew:EGT_C",) if kind == "ambiguous" else ()
    finding = replace(
        evidence.finding,
        kind=kind,
        effects=(NAME,) if claims else (),
        ambiguous_with=rivals,
        reason=f"because {HOSTILE}",
        separating_manoeuvre="fast steps" if claims else "",
    )
    after = evidence.after if claims else evidence.data.flights.y
    return replace(evidence, finding=finding, after=after)


def bare(evidence):
    """Nothing was tried, nothing stands out, nothing was held out, nothing could be read."""
    finding = replace(with_verdict(evidence, "none").finding, tried=(), emulator_rmse={})
    where = replace(
        evidence.where, rows=(), theil={}, bands={}, times={}, events=((), (), ()), channels={}
    )
    return replace(
        evidence, finding=finding, where=where, times={}, channels={}, held_out=None, facts={}
    )


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_every_verdict_makes_a_sound_page_that_needs_nothing_else(evidence, kind, sound_page):
    evidence = with_verdict(evidence, kind)
    html = gap_page(document(evidence), evidence, "2026-11-21 17:00 UTC")
    found = sound_page(html)
    assert HOSTILE in "".join(found.text)
    assert found.unnamed == 0
    assert "prefers-color-scheme: dark" in html
    assert "2026-11-21 17:00 UTC" in html


def test_a_page_is_the_same_bytes_each_time(evidence):
    evidence = replace(bare(evidence), where=evidence.where)
    found = document(evidence)
    assert gap_page(found, evidence, "now") == gap_page(found, evidence, "now")


def test_a_diagnosis_with_nothing_in_it_still_makes_a_page(evidence, sound_page):
    empty = bare(evidence)
    html = gap_page(document(empty), empty)
    sound_page(html)
    for text in (
        "NO GAP",
        "No part of the flights stands out of the noise",
        "No effect is claimed, so nothing is added",
        "No emulator was used",
        "No effect was fitted",
        "No model was fitted",
    ):
        assert text in html


@pytest.mark.parametrize(
    ("kind", "state", "word"),
    [
        ("none", "pass", "✓ NO GAP"),
        ("effects", "found", "● FOUND"),
        ("ambiguous", "found", "≈ NOT TOLD APART"),
        ("unknown", "none", "? I DON'T KNOW"),
    ],
)
def test_the_verdict_leads_and_says_why(evidence, kind, state, word):
    box = verdict_box(document(with_verdict(evidence, kind)))
    assert (box.state, box.word) == (state, word)
    said = " ".join(box.lines)
    assert "50 % of the squared difference of recorded and simulated is gap" in said
    sure = 96 if kind == "effects" else 90  # where rivals are named none is nearly certain
    assert (f"probability {sure} %; tau_s 1.00 s (0.90 to 1.10)." in said) == (state == "found")
    left = "10 % of the gap stays unexplained, each flight's own small offsets taken out."
    assert (left in said) == (state == "found")
    assert ("of the gap and is not claimed" in said) == (kind == "unknown")
    assert "because" in box.headline.lower() or kind in ("effects", "ambiguous")


def test_small_shares_are_not_said_to_be_nothing(evidence):
    found = document(evidence)
    found["quality"]["gap_share"] = 0.999
    assert "Nearly all of the squared difference" in " ".join(verdict_box(found).lines)
    found |= {"tried": [], "verdict": found["verdict"] | {"kind": "none", "effects": []}}
    found["quality"]["gap_share"] = 0.0
    assert verdict_box(found).lines == ()


def test_the_figures_shown_large_are_those_of_the_document(evidence):
    found = document(evidence)
    shown = {what: figure for figure, what in tiles(found)}
    assert shown["realised on held-out flights"] == f"{100 * found['shrink']['realised']:.0f} %"
    assert shown["models tried"] == "3"
    silent = tiles(document(with_verdict(evidence, "none")))
    assert "realised on held-out flights" not in {what for _, what in silent}


def test_what_to_fly_next_follows_from_the_verdict(evidence):
    told = next_flights(document(with_verdict(evidence, "ambiguous")))
    assert told[0] == ("fast steps", f"separates {NAME} from time_skew:EGT_C")
    assert told[1][1] == "shows time_skew:EGT_C, or rules it out"
    unknown = [reason for _, reason in next_flights(document(with_verdict(evidence, "unknown")))]
    assert f"shows {NAME}, or rules it out" in unknown
    known = document(evidence)
    known["quality"] |= {"pushes": 3, "pulls": 40, "held_out": ["a"]}
    assert next_flights(known)[1][1] == "there were only 3 pushes: every interval gets narrower"
    known["quality"] |= {"pushes": 30}
    assert len(next_flights(known)) == 1
    known["quality"] |= {"held_out": []}
    assert "--heldout-real" in next_flights(known)[1][1]


def test_the_effects_are_drawn_that_the_verdict_speaks_of(evidence):
    def drawn(kind):
        changed = with_verdict(evidence, kind)
        return [(one.name, one.standing) for one in drawn_effects(document(changed), changed)]

    rival = ("time_skew:EGT_C", "cannot be told from it")
    assert drawn("effects") == [(NAME, "claimed")]
    assert drawn("ambiguous") == [(NAME, "claimed"), rival]
    assert drawn("unknown") == [(NAME, "best candidate, not claimed")]
    assert drawn("none") == []


def test_the_heat_map_names_its_largest_cell_and_frames_the_core(evidence):
    found = document(evidence)
    drawn = heat_maps.phase_map(found)
    first = found["where"][0]
    assert first["channel"] == "EGT_C"
    cell = f"EGT {first['direction']} {first['phase']} {100 * first['share']:.0f} %"
    assert f"largest: {cell}" in drawn.alt
    core = [row for row in found["where"] if row["core"]]
    assert all(f">{100 * row['share']:.0f}<" in drawn.svg for row in core)
    assert f">{100 * first['low']:.0f} to {100 * first['high']:.0f}<" in drawn.svg


def test_regimes_add_up_to_the_whole(evidence):
    bins = document(evidence)["where"]
    shares = heat_maps._regime_shares(bins)
    assert set(shares) >= {"power", "altitude", "Mach"}
    for levels in shares.values():
        whole = sum(sum(channels.values()) for channels in levels.values())
        assert whole == pytest.approx(sum(row["share"] for row in bins))


def test_the_worst_event_is_the_one_with_the_most_gap(evidence):
    own, held = views(evidence)
    assert held.data is evidence.held_out.data
    gap = np.zeros_like(evidence.data.gap)
    event = evidence.where.events[1][2]
    gap[1, event.start + 1 : event.stop - 1, 2] = 50.0
    data = replace(evidence.data, real=evidence.data.flights.y + gap)
    view = own._replace(data=data)
    assert worst_event(view) == (1, event)
    assert worst_flight(view) == 1
    assert "flight_1" in event_picture(view).alt
    assert event_picture(view._replace(events=((), (), ()))) is None


def test_before_and_after_are_drawn_only_where_something_is_added(evidence):
    changed, _ = views(evidence)
    assert ">simulated + effect<" in event_picture(changed).svg
    same, _ = views(with_verdict(evidence, "unknown"))
    drawn = event_picture(same)
    assert ">simulated + effect<" not in drawn.svg
    assert drawn.alt.endswith("recorded, simulated")


def test_predicted_and_realised_stand_side_by_side(evidence):
    found = document(evidence)
    found["shrink"] |= {
        "realised": 0.87,
        "predicted": {"value": 0.9, "low": -math.inf, "high": 1.0},
    }
    drawn = charts.prediction(found)
    assert drawn.alt.endswith("predicted 90 %, realised 87 %")
    found["shrink"]["realised"] = None
    assert "--heldout-real" in charts.prediction(found).caption
    assert charts.prediction(document(with_verdict(evidence, "none"))) is None


def test_a_gap_that_does_not_stand_out_has_no_map(evidence):
    found = document(with_verdict(evidence, "none"))
    for row in found["where"]:
        row["share"] = 0.0
    for draw in (heat_maps.phase_map, heat_maps.regime_map, heat_maps.band_map):
        assert draw(found) is None
    assert next_flights(found) == []


def test_charts_without_anything_to_show_are_left_out(evidence):
    found = document(bare(evidence))
    found["side"] = {"input": 0.0, "process": 0.0, "sensor": 0.0}
    drawn = (
        heat_maps.phase_map, heat_maps.regime_map, heat_maps.band_map, charts.effect_ranking,
        charts.model_chart, charts.channel_bars, charts.sides, charts.theil,
    )  # fmt: skip
    assert [draw(found) for draw in drawn] == [None] * len(drawn)


def test_ranking_and_models_name_what_leads(evidence):
    found = document(evidence)
    assert f"{NAME} 96 %" in charts.effect_ranking(found).alt
    assert charts.model_chart(found).alt.endswith(f"best: {NAME} + spool_lag 91 %")


def texts(table):
    return [[cell.text for cell in row] for row in table.rows]


def test_tables_hold_every_bin_effect_and_model(evidence):
    found = document(evidence)
    assert len(page_tables.bins(found).rows) == len(found["where"])
    effects = texts(page_tables.effects(found))
    assert effects[0][:3] == [NAME, "channel lag", "sensor"]
    assert effects[0][6:] == ["tau_s 1.00 s (0.90 to 1.10)", "claimed"]
    assert any(row[7] == f"fitted with {NAME}" for row in effects)
    models = texts(page_tables.models(found))
    assert [row[0] for row in models] == [f"{NAME} + spool_lag", NAME, "time_skew:EGT_C"]
    assert models[0][3] == "81 to 91"


def test_an_emulator_with_more_error_than_gap_is_marked(evidence):
    rows = page_tables.emulator(document(evidence)).rows
    assert {row[0].text: row[1].mark for row in rows} == {"EGT [°C]": "bad", "N1 [%]": "good"}


def test_what_was_changed_is_counted_flight_by_flight(evidence):
    found = document(evidence)
    found["quality"]["changed"] = {"a": {"N1_pct unknown": 1300}}
    found["quality"]["compared"] = {"FN_kN": 0.25}
    assert texts(page_tables.changed(found)) == [["a", "N1_pct unknown", "1\N{NO-BREAK SPACE}300"]]
    assert texts(page_tables.compared(found)) == [["FN", "0.250", "kN"]]


def test_bands_and_regimes_stand_there_in_numbers(evidence):
    found = document(evidence)
    html = gap_page(found, bare(evidence))
    assert "Each channel adds up to its own gap" in html
    assert "Each regime adds up to the whole" in html
    assert len(page_tables.bands(found).rows) == sum(map(len, found["quality"]["bands"].values()))
    assert {row[0].text for row in page_tables.regimes(found).rows} >= {"power", "altitude"}


@pytest.mark.parametrize(("kind", "said"), [("logs", False), ("FMU", True)])
def test_a_simulator_that_is_run_again_is_said_to_be(evidence, kind, said):
    facts = {**evidence.facts, "simulator": kind}
    evidence = replace(bare(evidence), finding=evidence.finding, facts=facts)
    html = gap_page(document(evidence), evidence)
    assert ("This simulator can be run again" in html) == said


@pytest.mark.slow
def test_a_browser_shows_the_page_without_complaint(evidence, sound_in_a_browser):
    told = {kind: with_verdict(evidence, kind) for kind in ("ambiguous", "unknown")}
    told["bare"] = bare(evidence)
    pages = {kind: gap_page(document(each), each, "now") for kind, each in told.items()}
    sound_in_a_browser(pages)
