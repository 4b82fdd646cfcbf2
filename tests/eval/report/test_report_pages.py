"""What stands on the pages, that it is safe, and that it needs nothing but the file."""

from __future__ import annotations

import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from markupsafe import escape

from data_prep.log import Audit, AuditEntry, Log
from eval.judging.crossval import CrossValidation, FoldResult
from eval.judging.outcome import Outcome
from eval.judging.trim import Trim
from eval.preparation import most_to_show
from eval.report import tables
from eval.report.event_figures import summary_figure
from eval.report.figures import residual_tests
from eval.report.page import (
    PreparedLog,
    RunHeader,
    crossval_page,
    evaluate_page,
    prepare_page,
    worst_events,
)
from eval.report.tables import WindowTrial
from eval.report.view import LogView
from eval.run_logs import EvaluateConfig
from training.responses.transients import AssessedEvent

HOSTILE = '<script>alert("x")</script> & co.csv:left'


def trial() -> WindowTrial:
    frequency = np.linspace(0.0, 5.0, 50)
    return WindowTrial(
        log=HOSTILE,
        chosen=11,
        rms={"N1_pct": {3: 0.01, 11: 0.0525}},
        frequency_hz=frequency,
        gain={3: np.cos(frequency / 4), 11: np.cos(frequency)},
        excerpt_channel="N1_pct",
        excerpt_time_s=np.arange(10.0),
        excerpt={0: np.ones(10), 3: np.ones(10), 11: np.ones(10)},
    )


def folds(figures: list[float | None], test: tuple[str, ...] = (HOSTILE,)) -> CrossValidation:
    found = [
        FoldResult(HOSTILE, f"fold {k}", None, ("the rest",), test, {"rmse.N1_pct": value})
        for k, value in enumerate(figures)
    ]
    return CrossValidation(tuple(found), EvaluateConfig(largest_rmse={"N1_pct": 5.0}))


def without_model(one: LogView) -> LogView:
    """As `prepare` has it."""
    events = [AssessedEvent(each.event) for each in one.events]
    return replace(one, events=events, evaluation=None, residuals=())


def prepared_page(header: RunHeader, one: LogView) -> str:
    return "".join(prepare_page(header, [PreparedLog.of(one, trial(), "1-1").with_pictures(one)]))


@pytest.fixture(scope="module")
def evaluation(header, view, evaluated, outcome_of) -> str:
    trim = Trim(np.array([0.0, 1.0]), np.zeros(1), np.array([[[-0.4], [0.2]]]), (9,), 50)
    one = evaluated(trim=trim)
    return evaluate_page(header, [view(one=one)], outcome_of(one))


def test_every_page_is_sound_escaped_self_contained_and_the_same_bytes(
    evaluation, header, view, sound_page
):
    prepared = prepared_page(header, without_model(view()))
    for html in (evaluation, prepared, crossval_page(header, folds([1.0, 6.0]))):
        assert HOSTILE in "".join(sound_page(html).text)
    assert prepared == prepared_page(header, without_model(view()))  # the same bytes each time


def test_drawings_do_not_take_the_colours_of_the_page(evaluation):
    """In the dark they are inverted as a whole; a colour that is dark already would vanish."""
    style = evaluation[evaluation.index("<style>") : evaluation.index("</style>")]
    drawn = re.compile(r"svg|\.panel|\.plot")
    rules = [rule for rule in re.findall(r"([^{}]*)\{([^}]*)\}", style) if drawn.search(rule[0])]
    assert len(rules) > 10
    assert [rule for rule, body in rules if re.search(r"(fill|stroke): var", body)] == []


def test_on_paper_two_drawings_fit_under_each_other(evaluation):
    """A drawing of more than half of A4 leaves what is before it half empty."""
    printed = evaluation[evaluation.index("@media print") :]
    height = re.search(r"svg\.plot { max-height: (\d+)mm", printed)
    margin = re.search(r"@page { size: A4; margin: (\d+)mm", printed)
    assert height is not None
    assert margin is not None
    assert int(height[1]) < (297 - 2 * int(margin[1])) / 2
    assert "figure, .verdict, .tile, tr { break-inside: avoid; }" in printed


def test_cautions_stand_at_the_head_of_a_page(header):
    cautioned = replace(header, cautions=[HOSTILE])
    html = crossval_page(cautioned, folds([1.0]))
    assert '<ul class="warnings"><li>&lt;script&gt;' in html[: html.index("</header>")]
    assert '<ul class="warnings">' not in crossval_page(header, folds([1.0]))


def test_the_page_says_in_words_how_many_transients_pass(evaluation):
    assert "✗ FAIL" in evaluation
    assert "1 of 2 assessable transients (50 %) meet the &#39;paper&#39; rules" in evaluation
    assert "1 of 2 events pass in every channel." in evaluation
    assert "1 transient could not be assessed and count neither way" in evaluation


def test_what_could_not_be_assessed_is_folded_away_and_counted_by_reason(evaluation):
    times = evaluation[evaluation.index('<section id="times">') :]
    times = times[: times.index("</section>")]
    first, reasons, folded = re.split(r"<h3>Not assessable</h3>|<details>", times)
    assert "not assessable" not in first
    assert first.count("✓ pass") + first.count("✗ fail") == 2
    assert "response 2 % is below 5 %" in reasons
    assert "1 transient that could not be assessed" in folded
    assert "response 2 % is below 5 %" in folded
    cards = evaluation[evaluation.index('<div class="card none">') - 200 :]
    assert "<details><summary>1 event not assessable</summary>" in cards


def test_equal_repairs_of_a_channel_stand_in_one_row():
    entry = AuditEntry("N1_pct", "repaired", "spiking", 2, ((1.0, 2.0),))
    other = replace(entry, channel="N2_pct", samples=5, spans_s=())
    log = Log("a.csv", np.arange(2.0), {}, Audit((entry, other, entry)))
    rows = tables.audit(log, "").rows
    shown = [[cell.text for cell in row] for row in rows]
    assert shown == [
        ["N1_pct", "repaired", "spiking", "4", "; ".join(["t+0:01.0 to t+0:02.0"] * 2)],
        ["N2_pct", "repaired", "spiking", "5", "–"],  # noqa: RUF001 - the dash of the page
    ]


def test_events_that_are_not_assessable_count_on_neither_side(header, view, evaluated, outcome_of):
    one = evaluated()
    found = outcome_of(one)
    assert (found.passed, found.exit_code) == (False, 1)
    assert found.headline.startswith("1 of 2 assessable transients (50 %) meet")
    few = outcome_of(replace(one, events=tuple(event for event in one.events if event.ok)))
    assert (few.passed, few.exit_code) == (None, 1)
    assert few.lines[0].startswith("Ti/Tt: ")
    assert few.lines[0].endswith("a verdict takes 3 of each that can be assessed.")
    empty = replace(one, events=())
    assert outcome_of(empty).passed is None
    html = evaluate_page(header, [view(one=empty)], outcome_of(empty))
    assert "NOT ASSESSED" in html
    assert "Ti/Tt: no transient could be assessed (no event was found)." in html


def test_each_event_card_shows_its_outcome_and_reason(evaluation):
    assert evaluation.count('<div class="card pass">') == 1
    assert evaluation.count('<div class="card fail">') == 1
    assert evaluation.count('<div class="card none">') == 1
    assert "N1: response 2 % is below 5 %" in evaluation
    assert "ALT 5000 ft" in evaluation


def test_the_lowest_rmse_of_a_row_is_marked_and_a_better_baseline_is_named(
    view, evaluated, outcome_of, score
):
    for found, best, words in (
        (score(), "0.812", "lowest free-run RMSE of all models in N1."),
        (score(arx_rmse=0.5), "0.500", "in no channel; a baseline does better in N1."),
    ):
        one = replace(evaluated(), scores={"N1_pct": found})
        (row,) = tables.scores([view(one=one)]).rows[1:]
        assert [cell.text for cell in row if cell.mark == "best"] == [best]
        assert words in " ".join(outcome_of(one).lines)


def test_failed_events_are_shown_large_before_passed_ones(view):
    assert [event.ok for event in worst_events(view())] == [False, True]


def test_trim_audit_hashes_and_configuration_are_on_the_page(evaluation):
    for text in ("-0.4", "scored from t+0:05.0 on", "frozen", "t+0:55.1 to t+0:56.9", "ab" * 32,
                 "hidden = 8"):  # fmt: skip
        assert text in evaluation


def test_times_of_a_log_with_dates_are_elapsed_with_date_and_clock(header, view, evaluated):
    made = view(one=evaluated(began_s=1741907464.7))
    page = evaluate_page(header, [made], Outcome(passed=None, headline="h"))
    assert "Fast pull at t+0:39.9 (2025-03-13 23:11:44 UTC)" in page
    assert "fast pull, t+0:39.9" in page  # of the list that leads to events
    assert "t+0:55.1 to t+0:56.9 (2025-03-13 23:11:59 to 23:12:01 UTC)" in page
    assert "time after 2025-03-13 23:11:04.7 UTC [min:s]" in page
    assert '<a class="at" href="#overlay-1" data-show="6.9' in page
    seconds = re.findall(r"\b17419\d{5}", page)
    assert seconds == ["1741907464"]  # for the script, once


def test_a_log_without_events_or_residuals_or_audit_or_a_channel_still_makes_a_page(
    view, sound_page
):
    made = view()
    log = made.log.with_channels({"N1_pct": np.full(900, np.nan)})  # masked throughout
    bare = replace(made, log=replace(log, audit=Audit()), events=[], residuals=[], pearson=None)
    header = RunHeader(title="t", created="now")
    html = evaluate_page(header, [bare], Outcome(passed=None, headline="h"))
    assert "No event was found in this log." in html
    assert "Not computed." in html
    sound_page(html)


def test_the_prepare_page_shows_no_model_and_no_verdict(header, view):
    html = prepared_page(header, without_model(view()))
    assert "PASS" not in html
    assert "not assessable" not in html
    assert html.count('<div class="card ">') == 3
    assert "model minus measured." not in html.replace("deviation strips are model minus", "")
    assert '<td class="best num">0.0525</td>' in html


def test_a_log_without_pictures_is_named_and_keeps_its_tables(header, view):
    one = without_model(view())
    bare, drawn = (PreparedLog.of(one, trial(), number) for number in ("1-1", "2-1"))
    html = "".join(prepare_page(header, [bare, drawn.with_pictures(one)]))
    assert "Pictures of 1 of 2 logs: those with the most warnings, then the most events." in html
    assert f"Not drawn: {escape(one.name)}." in html
    assert not bare.drawn
    alone = "".join(prepare_page(header, [bare]))
    assert "counts as strong" in alone
    assert "samples masked of" in alone
    assert 'class="card ' not in alone
    assert "Not drawn" not in prepared_page(header, one)


def test_pictures_are_of_the_logs_with_most_to_show():
    logs = [
        SimpleNamespace(warnings=(None,) * warnings, events=(None,) * events)
        for warnings, events in ((0, 9), (1, 0), (0, 3), (0, 9), (2, 1))
    ]
    assert most_to_show(logs, 3) == [0, 1, 4]
    assert most_to_show(logs, 9) == [0, 1, 2, 3, 4]


def test_the_legend_of_the_residuals_is_within_the_drawing_for_no_input_and_for_nine(view):
    made = view()
    names = ("TRA_deg", "ALT_ft", "Mach", "dT_C", "WOW", "Approach", "ECS", "NAI", "WAI")
    cross = made.residuals[0].cross["TRA_deg"]
    none, many = (replace(made.residuals[0], cross=dict.fromkeys(some, cross))
                  for some in ((), names))  # fmt: skip
    alone, drawn = residual_tests(replace(made, residuals=[none, many]))
    assert "autocorrelation" in alone.svg
    box = re.search(r'viewBox="0 0 ([\d.]+) ([\d.]+)"', drawn.svg)
    assert box is not None
    assert all(f">{name.partition('_')[0]}</text>" in drawn.svg for name in names)
    heights = [float(y) for y in re.findall(r'<text[^>]* y="([-\d.]+)"', drawn.svg)]
    assert 0.0 < min(heights) < max(heights) < float(box[2])
    assert re.findall(r"stroke-dasharray: [^;\"]+", drawn.svg)  # the seventh has a used colour


@pytest.mark.parametrize(
    ("test", "shown", "named"),
    [
        (("a.csv",), "a.csv", "a.csv"),
        (("a.csv[0:9]", "b.csv"), "a.csv (1 part), b.csv (1 part)", None),
        (
            ("a.csv[0:9]", "a.csv[9:12]", "b.csv[0:3]", "c.csv[3:5]"),
            "3 logs (4 parts)",
            "a.csv (2 parts), b.csv (1 part), c.csv (1 part)",
        ),
        (("a.csv", "b.csv", "c.csv"), "3 logs", "a.csv, b.csv, c.csv"),
    ],
)
def test_many_logs_of_a_fold_are_counted_in_the_table_and_named_below(header, test, shown, named):
    made = folds([1.0], test)
    assert tables.folds(made, HOSTILE).rows[0][1].text == shown
    assert f"tested on {named or shown}" in crossval_page(header, made)


def test_crossval_shows_the_spread_marks_what_is_over_the_limit_and_leaves_out_what_is_unknown():
    *_, last, mean, deviation, least, _ = tables.folds(folds([1.0, 2.0, 6.0]), HOSTILE).rows
    assert (last[-1].text, last[-1].mark) == ("6.00", "bad")
    assert [row[-1].text for row in (mean, deviation, least)] == ["3.00", "2.65", "1.00"]
    _, unknown, _, mean, *_ = tables.folds(folds([1.0, None, 3.0]), HOSTILE).rows
    assert [unknown[-1].text, mean[-1].text] == ["\N{EN DASH}", "2.00"]


def test_the_page_of_an_80_minute_log_at_32_hz_with_40_events_stays_small(header, view):
    samples = 80 * 60 * 32
    noise = np.random.default_rng(0).normal(size=samples)
    made, names = view(), ("N1_pct", "N2_pct", "EGT_C")
    log = Log("long.csv", np.arange(samples) / 32.0, dict.fromkeys(("TRA_deg", *names), noise))
    three = np.column_stack([noise] * 3)
    run = replace(
        made.evaluation.run, outputs={"model": three, "steady_state": three},
        inputs_known=np.ones(samples, dtype=bool),
    )  # fmt: skip
    long = replace(
        made, log=log, outputs=names, evaluation=replace(made.evaluation, run=run), residuals=[],
        events=list(made.events) * 14,
    )  # fmt: skip
    html = evaluate_page(header, [long], Outcome(passed=False, headline="h"))
    assert len(html.encode()) < 5e6 / 4


def test_the_summary_picture_is_a_png(view):
    assert summary_figure(view(), view().events[1]).startswith(b"\x89PNG\r\n")


@pytest.mark.slow
def test_a_browser_shows_the_pages_from_files_without_complaint(
    evaluation, header, view, sound_in_a_browser
):
    sound_in_a_browser(
        {
            "evaluate": evaluation,
            "prepare": prepared_page(header, without_model(view())),
            "crossval": crossval_page(header, folds([1.0, 6.0])),
        }
    )


@pytest.mark.slow
def test_the_browser_sees_what_is_wrong_with_a_page(browse):
    html = """<!DOCTYPE html><html><body><a href="#gone">to nothing</a>
    <svg width="0" height="9" aria-label="flat"></svg><div style="width: 2000px">broad</div>
    <script>throw new Error("bad")</script></body></html>"""
    (one,) = browse({"wrong": html})
    assert [said.partition(":")[0] for said in one["said"]] == ["ErrorMessageLevel"]
    assert one["phone"]["empty"] == ["svg. flat"]
    assert one["phone"]["wide"] == ["DIV. broad"]
    assert one["phone"]["width"] > one["phone"]["window"]
    assert one["desk"]["broken"] == ["#gone"]


def test_coefficients_are_shaded_by_sign_and_size():
    rho = pd.DataFrame({"N1_pct": [0.9, -0.5, 0.25, np.nan]}, ["TRA_deg", "Mach", "dT_C", "WOW"])
    strong, negative, weak, missing = (cells[1] for cells in tables.pearson(rho, "").rows)
    hue, share = zip(
        *(cell.background.split(" / ") for cell in (strong, negative, weak)), strict=True
    )
    assert hue[0] == hue[2] != hue[1]
    assert share == ("0.45)", "0.25)", "0.12)")
    assert (strong.mark, negative.mark, missing.level) == ("strong", "", 0.0)
