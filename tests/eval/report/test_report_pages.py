"""What stands on the pages, that it is safe, and that it needs nothing but the file."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

from data_prep.log import Audit, AuditEntry
from eval.report import tables
from eval.report.content import (
    Fold,
    Measure,
    NoiseSweep,
    Offsets,
    RunHeader,
    Scheme,
    WindowTrial,
)
from eval.report.event_figures import summary_figure
from eval.report.page import (
    Count,
    Outcome,
    count,
    crossval_page,
    evaluate_page,
    noise_page,
    outcome,
    prepare_page,
    worst_events,
    write_page,
)

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


def scheme(results: list[float]) -> Scheme:
    measure = Measure(key="n1", label="max rel. error N1", unit="%", limit=5.0)
    folds = [
        Fold(name=f"fold {k}", train="the rest", test=HOSTILE, results={"n1": value})
        for k, value in enumerate(results)
    ]
    return Scheme(name=HOSTILE, folds=folds, measures=[measure])


@pytest.fixture(scope="module")
def evaluation(header, page) -> str:
    sweep = NoiseSweep(
        log=HOSTILE,
        channel="N2_pct",
        snr_db=np.array([20.0, 45.0]),
        curves={"raw": np.array([2.0, 0.1]), "fused": np.array([0.5, 0.05])},
        nis=np.array([1.0, 1.1]),
        nis_band=(0.9, 1.2),
    )
    offsets = Offsets(levels=[0.0, 1.0], added={"N1_pct": [-0.4, 0.2]})
    one = replace(page(), offsets=offsets, scored_from_s=5.0)
    return evaluate_page(header, [one], sweeps=[sweep])


def test_every_page_is_sound_escaped_and_self_contained(evaluation, header, page, sound_page):
    bare = replace(page(), scores=(), residuals=())
    pages = [
        evaluation,
        prepare_page(header, [bare], [trial()]),
        crossval_page(header, [scheme([1.0, 6.0])]),
    ]
    for html in pages:
        assert HOSTILE in "".join(sound_page(html).text)


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


def test_cautions_stand_at_the_head_of_a_page(header, page):
    cautioned = replace(header, cautions=[HOSTILE])
    html = prepare_page(cautioned, [page()])
    assert '<ul class="warnings"><li>&lt;script&gt;' in html[: html.index("</header>")]
    assert '<ul class="warnings">' not in prepare_page(header, [page()])


def test_a_page_is_the_same_bytes_each_time(evaluation, header, page):
    again = evaluate_page(header, [page()])
    assert again == evaluate_page(header, [page()])


def test_the_page_says_in_words_how_many_transients_pass(evaluation):
    assert "✗ FAIL" in evaluation
    assert "1 of 2 assessable transients (50 %) meet the &#39;paper&#39; rules" in evaluation
    assert "1 transient could not be assessed and count neither way" in evaluation


def test_equal_repairs_of_a_channel_stand_in_one_row():
    entry = AuditEntry("N1_pct", "repaired", "spiking", 2, ((1.0, 2.0),))
    other = replace(entry, channel="N2_pct", samples=5, spans_s=())
    rows = tables.audit(Audit((entry, other, entry)), "").rows
    shown = [[cell.text for cell in row] for row in rows]
    assert shown == [
        ["N1_pct", "repaired", "spiking", "4", "1.0 to 2.0; 1.0 to 2.0"],
        ["N2_pct", "repaired", "spiking", "5", "–"],  # noqa: RUF001 - the dash of the page
    ]


@pytest.mark.parametrize(
    ("value", "text"),
    [(0.9997, "1.00"), (1.0004, "1.00"), (0.09996, "0.100"), (99.96, "100"), (7.125, "7.12")],
)
def test_numbers_have_three_digits_after_rounding(value, text):
    assert tables.number(value) == text


def test_counts_keep_events_that_are_not_assessable_out_of_both_sides(page):
    assert count([page()]) == Count(
        events=3, events_assessed=2, events_passed=1, assessed=2, passed=1, not_assessable=1
    )


def test_the_page_passes_when_every_assessable_transient_does(header, page):
    whole = page()
    kept = replace(whole, events=[trace for trace in whole.events if trace.ok])
    assert outcome(header, [kept]).passed is True


def test_nothing_assessable_is_neither_pass_nor_fail(header, page):
    empty = replace(page(), events=[], scores=[])
    verdict = outcome(header, [empty])
    assert verdict == Outcome(None, "No event could be assessed for Ti and Tt")
    assert "NOT ASSESSED" in evaluate_page(header, [empty])


def test_the_verdict_of_the_caller_goes_before_our_own(header, page):
    html = evaluate_page(header, [page()], Outcome(passed=True, headline="95 % were asked for"))
    assert "✓ PASS" in html
    assert "95 % were asked for" in html


def test_each_event_card_shows_its_outcome_and_reason(evaluation):
    assert evaluation.count('<div class="card pass">') == 1
    assert evaluation.count('<div class="card fail">') == 1
    assert evaluation.count('<div class="card none">') == 1
    assert "N1: response 2 % is below 5 %" in evaluation
    assert "ALT 5000 ft" in evaluation


def test_the_lowest_rmse_of_a_row_is_marked_and_a_better_baseline_is_told(header, page, score):
    ahead = evaluate_page(header, [page()])
    assert '<td class="best num">0.812</td>' in ahead
    assert "lowest free-run RMSE of all models in N1." in ahead
    behind = replace(page(), scores=[score(baselines={"ARX": 0.5})])
    html = evaluate_page(header, [behind])
    assert '<td class="best num">0.500</td>' in html
    assert "in no channel; a baseline does better in N1." in html


def test_failed_events_are_shown_large_before_passed_ones(page):
    assert [trace.ok for trace in worst_events(page())] == [False, True]


def test_trim_audit_hashes_and_configuration_are_on_the_page(evaluation):
    for text in ("-0.4", "scored from 5 s on", "frozen", "55.1 to 56.9", "ab" * 32, "hidden = 8"):
        assert text in evaluation


def test_a_log_without_events_or_residuals_or_audit_still_makes_a_page(page, sound_page):
    bare = replace(page(), events=[], residuals=[], scores=[], pearson=None, audit=Audit())
    html = evaluate_page(RunHeader(title="t", created="now"), [bare])
    assert "No event was found in this log." in html
    assert "Not computed." in html
    sound_page(html)


def test_a_channel_that_is_masked_throughout_still_makes_a_page(header, page, sound_page):
    made = page()
    gone = [replace(part, measured=np.full(900, np.nan)) for part in made.channels]
    sound_page(evaluate_page(header, [replace(made, channels=gone, events=[])]))


def test_the_prepare_page_shows_no_model_and_no_verdict(header, page):
    made = page()
    events = [
        replace(
            trace,
            responses={},
            channels=[replace(part, model=None) for part in trace.channels],
        )
        for trace in made.events
    ]
    channels = [replace(part, model=None) for part in made.channels]
    html = prepare_page(header, [replace(made, events=events, channels=channels)], [trial()])
    assert "PASS" not in html
    assert "model minus measured." not in html.replace("deviation strips are model minus", "")
    assert '<td class="best num">0.0525</td>' in html


@pytest.mark.parametrize(
    ("data", "shown"),
    [
        ("a.csv", "a.csv"),
        ("a.csv (1 part), b.csv", "a.csv (1 part), b.csv"),
        ("a.csv (12 parts), b.csv (3 parts), c.csv (1 part)", "3 logs (16 parts)"),
        ("a.csv, b.csv, c.csv", "3 logs"),
    ],
)
def test_many_logs_of_a_fold_are_counted_in_the_table_and_named_below(header, data, shown):
    made = scheme([1.0])
    made = replace(made, folds=[replace(made.folds[0], test=data)])
    assert tables.folds(made).rows[0][1].text == shown
    assert f"tested on {data}" in crossval_page(header, [made])


def test_crossval_shows_the_spread_and_marks_what_is_over_the_limit(header):
    html = crossval_page(header, [scheme([1.0, 2.0, 6.0])])
    assert '<td class="bad num">6.00</td>' in html
    for figure in ("3.00", "2.65", "1.00"):  # mean, sample deviation, least
        assert f'<td class="strong num">{figure}</td>' in html


def test_a_fold_without_a_figure_shows_a_dash_and_is_left_out_of_the_spread(header):
    html = crossval_page(header, [scheme([1.0, float("nan"), 3.0])])
    assert '<td class=" num">–</td>' in html  # noqa: RUF001 - the dash of the page
    assert '<td class="strong num">2.00</td>' in html


def test_an_80_minute_log_at_32_hz_with_40_events_stays_small(header, page):
    samples = 80 * 60 * 32
    made = page()
    noise = np.random.default_rng(0).normal(size=samples)
    channels = [replace(made.channels[0], measured=noise, model=noise, steady=noise)] * 3
    long = replace(
        made,
        time_s=np.arange(samples) / 32.0,
        driver=noise,
        channels=channels,
        events=list(made.events) * 14,
        residuals=[],
    )
    assert len(evaluate_page(header, [long]).encode()) < 5e6 / 4


def test_a_page_is_written_whole_and_readable(tmp_path):
    target = tmp_path / "new" / "page.html"
    write_page(target, "<p>ρ</p>")  # noqa: RUF001 - not ASCII on purpose
    assert target.read_text(encoding="utf-8") == "<p>ρ</p>"  # noqa: RUF001
    assert [path.name for path in target.parent.iterdir()] == ["page.html"]


def test_the_summary_picture_is_a_png(page):
    assert summary_figure(page().events[1], "TRA_deg").startswith(b"\x89PNG\r\n")


def test_a_browser_shows_the_pages_from_files_without_complaint(
    evaluation, header, page, sound_in_a_browser
):
    bare = replace(page(), scores=(), residuals=())
    sweep = NoiseSweep(
        log=HOSTILE,
        channel="N2_pct",
        snr_db=np.array([20.0, 45.0]),
        curves={"raw": np.array([2.0, 0.1])},
    )
    sound_in_a_browser(
        {
            "evaluate": evaluation,
            "prepare": prepare_page(header, [bare], [trial()]),
            "crossval": crossval_page(header, [scheme([1.0, 6.0])]),
            "denoise": noise_page(header, Outcome(passed=None, headline="h"), [sweep]),
        }
    )


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
