"""Claims are held to their bounds, counted, and shown as they are."""

from dataclasses import replace

import numpy as np
import pytest

from eval.report.figures import free_runs, fused
from eval.reproduce.study import (
    Claim,
    Study,
    claim_table,
    counts,
    or_nan,
    outcome_of,
    reproduction_page,
)


def claim(value, **more):
    return Claim("w", "< 5 %", value, **more)


def study(*claims, key="a"):
    return Study(key=key, title="Title <b>", source="section 1", text="text", claims=claims)


@pytest.mark.parametrize(
    ("value", "limit", "met"),
    [
        (4.9, "< 5", True), (5.0, "< 5", False), (5.1, "< 5", False),
        (5.0, ">= 5 %", True), (4.9, ">= 5 %", False), (5.0, "<= 5 kg", True),
        (5.1, "<= 5 kg", False), (float("nan"), "< 5", None), (float("inf"), "< 5", None),
    ],
)  # fmt: skip
def test_a_claim_is_met_on_its_side_of_the_bound(value, limit, met):
    assert claim(value, limit=limit).met is met


def test_a_row_holds_what_json_can_and_no_more():
    row = claim(float("nan")).row()
    assert (row["ours"], row["met"], row["unit"], row["bound"]) == (None, None, "%", 5.0)
    assert claim(1.25).ours == "1.25 %"
    assert claim(float("nan")).ours == "\N{EN DASH}"
    assert claim(10.0, limit="< 5").ours == "10"
    assert claim(9.96, limit="< 5").ours == "9.96"
    assert or_nan(None) != or_nan(None)
    assert or_nan(2) == 2.0


def test_the_table_says_what_was_reached():
    table = claim_table([claim(1.0), claim(9.0, remark="why"), claim(float("nan"))])
    assert [row[4].text for row in table.rows] == ["✓ reached", "✗ not reached", "not measured"]
    assert [row[4].mark for row in table.rows] == ["good", "bad", "none"]
    assert table.rows[1][5].text == "why"
    assert claim_table([claim(1.0)]).head[-1] == "outcome"


def test_the_outcome_counts_paper_and_goals_apart_and_names_what_is_missed():
    found = outcome_of(
        [study(claim(1.0), claim(9.0)), study(claim(1.0, origin="our goal"), claim(float("nan")))]
    )
    assert found.passed is False
    assert found.headline == "2 of 3 claims are reached"
    assert found.lines == (
        "1 of 2 of the paper's claims are reached.",
        "1 of 1 of our own goals are reached.",
        "w: 9 %, not < 5 %.",
    )
    assert outcome_of([study(claim(1.0))]).passed is True
    assert outcome_of([study(claim(float("nan")))]).passed is None
    assert counts([]) == []


def test_the_page_escapes_what_it_is_given(header):
    html = reproduction_page(header, [study(claim(1.0), key="a"), study(key="b")])
    assert "Title <b>" not in html
    assert "Title &lt;b&gt;" in html
    assert "✓ REACHED" in html
    assert html == reproduction_page(header, [study(claim(1.0), key="a"), study(key="b")])


def test_figures_name_what_they_show():
    time_s = np.arange(50.0)
    runs = {"one": np.ones(50), "two": np.zeros(50)}
    drawn = free_runs(time_s, "N1_pct", np.full(50, 0.5), runs)
    assert "one, two" in drawn.alt
    assert all(name in drawn.svg for name in (">one<", ">two<", "N1 [%]"))
    shown = fused(time_s, "N2_pct", {"noisy": np.ones(50), "truth": np.zeros(50)}, "caption")
    assert shown.caption == "caption"
    assert ">truth<" in shown.svg


@pytest.mark.slow
def test_a_browser_shows_the_page_without_complaint(header, view, sound_in_a_browser):
    drawn = free_runs(np.arange(9.0), "N1_pct", np.zeros(9), {"one": np.ones(9)})
    whole = replace(study(claim(1.0), claim(9.0)), pictures=(drawn,), sheets=(view(),))
    sound_in_a_browser({"reproduce": reproduction_page(header, [whole])})
