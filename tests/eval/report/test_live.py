"""Charts that zoom: what stands on the page is what was measured, and a browser shows it so."""

import base64
import hashlib
import html
import json
import math
import zlib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pypdf import PdfReader

from data_prep.log import Log
from eval.judging.compare import Comparison, Row
from eval.judging.outcome import Outcome
from eval.judging.significance import Recording
from eval.report import live
from eval.report.live import Chart, Line, Mark, Panel
from eval.report.page import compare_page, evaluate_page
from eval.report.style import missing_spans

# `dist/` of https://registry.npmjs.org/uplot/-/uplot-1.6.32.tgz
RELEASED = {
    "uPlot.iife.min.js": "19c8d4c6ad88929a79f4ae49d6f7161566dfd0ba3d15cc495e974f787eb78f1f",
    "uPlot.min.css": "df630c6a8d6f8eeaff264b50f73ce5b114f646ffd9a0bb74f049b0a00135fa04",
}
HOSTILE = "</div><script>alert(\"x\")</script> & 'co'"


def document(text):
    """What the script reads from the element of a chart."""
    head, tail = '<div class="live" data-chart="', '"></div>'
    assert text.startswith(head)
    assert text.endswith(tail)
    assert not set("<>\"'") & set(text[len(head) : -len(tail)])
    return json.loads(html.unescape(text[len(head) : -len(tail)]))


def read(found, piece):
    """Values of each line in a piece, bins as (least, largest): the slow twin of the script."""
    planes = np.frombuffer(zlib.decompress(base64.b64decode(piece["data"])), np.uint8)
    words = iter(sum(part.astype(int) << 8 * k for k, part in enumerate(planes.reshape(4, -1))))
    bins = -(-piece["rows"] // piece["size"])
    lines = []
    for line in found["lines"]:
        parts = []
        for _ in range(1 if piece["size"] == 1 else 2):
            whole, values = line["base"], []
            for _ in range(bins):
                word = int(next(words))
                if word == 0xFFFFFFFF:
                    values.append(math.nan)
                    continue
                whole += (word >> 1) ^ -(word & 1)
                values.append(whole / 10.0 ** line["digits"])
            parts.append(values)
        lines.append(np.array(parts))
    return lines


def chart(*curves, marks=()):
    lines = [Line(f"y{k}", np.array(part, dtype=float), "#000000") for k, part in enumerate(curves)]
    return Chart(np.arange(len(curves[0])) / 10.0, [Panel("y", lines, 100)], marks)


curves = st.lists(
    st.one_of(st.just(math.nan), st.just(math.inf), st.floats(-1e9, 1e9), st.floats(-1e300, 1e300)),
    min_size=2, max_size=40,
)  # fmt: skip


@given(curves)
def test_what_stands_on_the_page_is_the_curve_to_a_hundred_thousandth_of_its_range(values):
    found = document(live.html(chart(values)))
    ((shown,),) = read(found, found["pieces"][0])
    values = np.array(values)
    known = np.isfinite(values)
    assert np.array_equal(np.isfinite(shown), known)
    if known.any():
        largest = np.abs(values[known]).max()
        span = np.ptp(values[known]) or 1e-3 * largest
        half_step, rounding = max(0.5e-5 * span, 0.5e-15), 4e-15 * max(largest, 1.0)
        assert np.abs(shown - values)[known].max() <= half_step * (1.0 + 1e-6) + rounding


def test_a_recorder_of_twelve_bits_is_shown_without_error():
    values = np.random.default_rng(0).integers(0, 4096, 500) * 0.25
    found = document(live.html(chart(values)))
    ((shown,),) = read(found, found["pieces"][0])
    assert np.array_equal(shown, values)


def test_a_long_log_stands_in_bins_that_keep_every_extreme_and_its_events_by_sample(monkeypatch):
    monkeypatch.setattr(live, "_MOST", 1000)
    rng = np.random.default_rng(1)
    values = np.round(rng.normal(size=2001), 3)
    values[100:140] = np.nan
    found = document(live.html(chart(values, values[::-1], marks=[Mark(50.0, 60.0, "push")])))
    whole, event = found["pieces"]
    assert (whole["first"], whole["rows"], whole["size"]) == (0, 2001, 16)
    for line, expected in zip(read(found, whole), (values, values[::-1]), strict=True):
        for k, (low, high) in enumerate(line.T):
            part = expected[16 * k : 16 * k + 16]
            part = part[np.isfinite(part)]
            want = (part.min(), part.max()) if len(part) else (math.nan, math.nan)
            assert np.array_equal((low, high), want, equal_nan=True)
    assert (event["first"], event["rows"], event["size"]) == (500, 101, 1)
    assert np.array_equal(read(found, event)[0][0], values[500:601])


def test_ten_hours_at_ten_hertz_stay_small():
    rng, rows = np.random.default_rng(2), 360_000
    noise = [np.round(rng.normal(50.0, 0.2, rows), 2) for _ in range(19)]
    assert len(live.html(chart(*noise))) < 1_000_000


def test_names_are_text_wherever_they_stand():
    values = np.arange(5.0)
    panels = [Panel(HOSTILE, [Line(HOSTILE, values, "#000000")], 100)]
    found = document(live.html(Chart(values, panels, [Mark(0.0, 1.0, HOSTILE)], HOSTILE)))
    names = [part[0]["label"] for part in (found["lines"], found["panels"])]
    assert [found["clock"], *names, found["marks"][0][2]] == [HOSTILE] * 4


def test_less_than_two_samples_give_no_chart():
    assert live.html(chart([1.0])) == ""


def test_runs_of_missing_samples_are_found_at_the_resolution_asked_for():
    time_s, values = np.arange(1000) / 10.0, np.zeros(1000)
    values[[100, 102, 500]] = np.nan
    assert missing_spans(time_s, values, 10)[0] == (10.0, pytest.approx(19.99))
    assert [round(start, 3) for start, _ in missing_spans(time_s, values, 8000)] == [
        10.0,
        10.2,
        50.0,
    ]


@pytest.mark.parametrize("name", RELEASED)
def test_the_library_is_that_of_its_npm_package(name):
    shipped = Path(live.__file__).with_name("vendor") / name
    assert hashlib.sha256(shipped.read_bytes()).hexdigest() == RELEASED[name]


def comparison(view):
    """Two models on the log of a view."""
    log, events = view.log, tuple(each.event for each in view.events)
    model = view.evaluation.run.model
    outputs = {HOSTILE: model, "other": model + 1.0}
    one = Recording(
        log.name, log.time_s, ("N1_pct",), log.matrix(["N1_pct"]), outputs,
        np.ones(len(log), dtype=bool), events,
    )  # fmt: skip
    return Comparison(tuple(Row(name, "train") for name in outputs), (one,), ())


def test_the_page_of_a_comparison_overlays_all_runs(header, view, sound_page):
    text = compare_page(header, comparison(view()))
    sound_page(text)
    found = document(live.of_runs(comparison(view())))
    assert [line["label"] for line in found["lines"]] == [HOSTILE, "other", "measured"]
    assert [mark[2] for mark in found["marks"]] == [
        "fast push, t+0:09.9",
        "fast pull, t+0:39.9",
        "small push, t+1:04.9",
    ]


def test_a_page_with_charts_has_the_licence_of_what_draws_them_and_stays_small(header, view):
    text = evaluate_page(header, [view()], Outcome(passed=None, headline="h"))
    assert "Copyright (c) 2022 Leon Sorokin" in text
    assert sum(map(len, live.scripts())) < 100_000
    assert not any("</script" in script or "<!--" in script for script in live.scripts())


def test_windows_of_an_event_are_where_its_times_are_allowed(view):
    made = view()
    found = document(live.of_event(made, made.events[0]))
    output = found["panels"][1]
    (ti, tt), reached = output["shades"][:2], output["shades"][2:]
    assert ti[0] <= reached[0][0] <= ti[1]
    assert tt[0] <= reached[1][0] <= tt[1]
    assert found["start_s"] == pytest.approx(-3.0)


ACT = """(async () => {
  const pause = ms => new Promise(done => setTimeout(done, ms));
  document.documentElement.style.scrollBehavior = "auto";
  const root = document.querySelector(".live");
  root.parentElement.scrollIntoView();
  while (!root.view) await pause(20);
  const {view} = root, plot = view.plots[1];
  const box = () => plot.over.getBoundingClientRect();
  const mouse = (kind, time, to = plot.over) => to.dispatchEvent(new MouseEvent(kind, {
    clientX: box().left + plot.valToPos(time, "x"), clientY: box().top + 30, movementX: 9,
    bubbles: true, button: 0}));
  const shown = () => view.plots.map(one =>
    [...one.root.querySelectorAll(".u-value")].map(each => each.textContent));
  const range = () => view.plots.map(one => [one.scales.x.min, one.scales.x.max]);
  const found = {all: range(), size: view.size};
  found.ticks = view.plots.map(one => one.axes[1]._splits.length);
  mouse("mousemove", 12.3); await pause(50);
  found.hover = shown();
  found.cursors = view.plots.map(one => one.cursor.idx);
  mouse("mousedown", 20); mouse("mousemove", 25); mouse("mousemove", 30);
  mouse("mouseup", 30, document);
  await pause(50);
  found.zoomed = range();
  root.querySelector('[aria-label="later"]').click(); await pause(50);
  found.later = range();
  plot.over.dispatchEvent(new MouseEvent("dblclick", {bubbles: true})); await pause(50);
  found.back = range();
  root.querySelectorAll(".jumps button")[1].click(); await pause(50);
  found.jumped = range();
  found.fine = view.size;
  document.querySelectorAll("a[data-show]")[0].click(); await pause(50);
  found.linked = range();
  root.querySelectorAll(".jumps button")[1].click(); await pause(50);
  mouse("mousemove", 40.5); await pause(50);
  found.event = shown();
  return JSON.stringify(found);
})()"""


@pytest.fixture(scope="module")
def seen(browse, header, view, tmp_path_factory):
    """What a browser shows of a log and of one so long that it stands in bins, and their CSV."""
    made = view()
    values = made.log["N1_pct"].round(2)
    log = made.log.with_channels({"N1_pct": values})
    csv = tmp_path_factory.mktemp("csv") / "log.csv"
    log.to_frame().to_csv(csv)
    short = replace(
        made,
        log=log,
        evaluation=replace(made.evaluation, run=replace(made.evaluation.run, log=log)),
    )
    pages = {
        "short": evaluate_page(header, [short], Outcome(passed=None, headline="h")),
        "long": evaluate_page(header, [long_view(short)], Outcome(passed=None, headline="h")),
    }
    found = browse(pages, dict.fromkeys(pages, ACT))
    return pd.read_csv(csv, index_col="time_s"), dict(zip(pages, found, strict=True))


def long_view(view, times=400):
    """The log many times in a row: its events are in the first."""
    log = view.log
    channels = {name: np.tile(values, times) for name, values in log.channels.items()}
    run = view.evaluation.run
    outputs = {name: np.tile(values, (times, 1)) for name, values in run.outputs.items()}
    rows = np.arange(len(log) * times)
    long = Log("long.csv", rows * 0.1, channels)
    known = np.ones(len(rows), dtype=bool)
    run = replace(
        run, log=long, outputs=outputs, inputs_known=known, measured=long.matrix(["N1_pct"])
    )
    return replace(view, log=long, evaluation=replace(view.evaluation, run=run), residuals=[])


@pytest.mark.slow
def test_a_browser_draws_the_charts_without_complaint_or_request(seen):
    for one in seen[1].values():
        assert one["loaded"]
        assert one["said"] == []
        assert one["asked"] == []
        assert one["desk"]["wide"] == one["phone"]["wide"] == []


@pytest.mark.slow
def test_the_cursor_shows_the_values_of_the_csv_in_all_panels(seen):
    table, found = seen[0], seen[1]["short"]["did"]
    at = table.loc[12.3]
    (time, driver), (_, _, model, measured), (_, deviation) = found["hover"]
    assert time == "t+0:12.3"
    assert float(driver) == at["TRA_deg"]
    assert float(measured) == at["N1_pct"]
    assert float(deviation) == pytest.approx(float(model) - float(measured), abs=2e-3)
    assert found["cursors"] == [123, 123, 123]
    assert min(found["ticks"]) >= 3


@pytest.mark.slow
def test_all_panels_zoom_move_and_jump_together(seen):
    found = seen[1]["short"]["did"]
    for name, start, stop, within in (
        ("all", 0.0, 89.9, 1e-6), ("zoomed", 20.0, 30.0, 0.2), ("later", 25.0, 35.0, 0.2),
        ("back", 0.0, 89.9, 1e-6), ("jumped", 36.9, 53.9, 1e-6),
        ("linked", 6.9, 29.9, 1e-6),
    ):  # fmt: skip
        assert found[name] == [pytest.approx([start, stop], abs=within)] * 3, name


@pytest.mark.slow
def test_a_long_log_shows_extremes_of_bins_and_every_sample_of_an_event(seen):
    table, found = seen[0], seen[1]["long"]["did"]
    assert (found["size"] > 1, found["fine"]) == (True, 1)
    low, high = map(float, found["hover"][1][-1].split(" to "))
    part = table["N1_pct"].to_numpy()[: 2 * found["size"]]
    assert (low, high) == (part.min(), part.max())
    assert float(found["event"][1][-1]) == table.loc[40.5, "N1_pct"]


@pytest.mark.slow
def test_paper_shows_the_drawing_and_not_the_chart(seen):
    for one in seen[1].values():
        text = "".join(page.extract_text() for page in PdfReader(one["pdf"]).pages)
        assert "Drag to zoom" not in text
        assert "time after its start [min:s]" in text
        assert "Pearson ranking" not in text
        assert "Fast pull at" in text  # it failed
        assert "Fast push at" not in text
