"""Tables that fit an 80-column terminal and say what the page says."""

from __future__ import annotations

import io
from dataclasses import replace

import pytest
from rich.console import Console

from eval import terminal
from eval.report.content import Fold, Measure, Scheme
from eval.report.page import outcome
from eval.report.tables import number

LONG = "citation_20180312_flight1_recorded_on_the_left_engine_with_a_very_long_name.csv.gz:left#2"


def printed(show, *content) -> str:
    stream = io.StringIO()
    show(Console(file=stream, width=80), *content)
    text = stream.getvalue()
    assert max(map(len, text.splitlines())) <= 80
    return text


def test_scores_stand_beside_every_baseline(page, score):
    baselines = {"steady state": 1.23, "first order": 0.98, "ARX": 0.91}
    rows = [score(channel=name, baselines=baselines) for name in ("N1_pct", "N2_pct", "EGT_C")]
    text = printed(terminal.print_scores, [replace(page(), name=LONG, scores=rows)])
    assert LONG in text.replace("\n", "").replace(" ", "")
    line = next(line for line in text.splitlines() if line.startswith("EGT [°C]"))
    for figure in ("0.812", "4.2 %", "0.100", "1.23", "0.980", "0.910"):
        assert figure in line


def test_square_brackets_in_a_log_name_are_text(page):
    assert "[red]x[/red]" in printed(terminal.print_scores, [page("[red]x[/red]")])


def test_transients_count_passed_of_assessed_and_those_not_assessable(page):
    text = printed(terminal.print_transients, [page(LONG)])
    line = next(line for line in text.splitlines() if line.startswith("N1"))
    assert line.split()[1] == "1/2"
    assert line.split()[-1] == "1"


def test_the_outcome_is_one_word_first(page, header):
    text = printed(terminal.print_outcome, outcome(header, [page("a.csv")]))
    assert text.startswith("FAIL  1 of 2 assessable transients (50 %)")


def test_crossval_prints_spread_and_limit():
    measure = Measure(key="x", label="max rel. error N1", unit="%", limit=5.0)
    folds = [Fold(name=str(k), train="", test="", results={"x": k}) for k in (1.0, 2.0, 6.0)]
    text = printed(terminal.print_crossval, [Scheme(name=LONG, folds=folds, measures=[measure])])
    line = next(line for line in text.splitlines() if "max rel. error N1" in line)
    assert line.split()[-5:] == ["3.00", "2.65", "1.00", "6.00", "5.00"]


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0.0, "0"),
        (0.012345, "0.0123"),
        (1.0, "1.00"),
        (-12.345, "-12.3"),
        (1234.6, "1235"),
        (float("nan"), "\N{EN DASH}"),
        (float("inf"), "\N{EN DASH}"),
        (None, "\N{EN DASH}"),
    ],
)
def test_numbers_have_three_digits_and_no_exponent(value, text):
    assert number(value) == text
