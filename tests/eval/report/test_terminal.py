"""Tables that fit an 80-column terminal and say what the page says."""

from __future__ import annotations

import io
from dataclasses import replace

import pytest
from rich.console import Console

from eval import terminal
from eval.judging.crossval import CrossValidation, FoldResult
from eval.report.style import number
from eval.run_logs import EvaluateConfig

LONG = "citation_20180312_flight1_recorded_on_the_left_engine_with_a_very_long_name.csv.gz:left#2"


def printed(show, *content) -> str:
    stream = io.StringIO()
    show(Console(file=stream, width=80), *content)
    text = stream.getvalue()
    assert max(map(len, text.splitlines())) <= 80
    return text


def test_scores_stand_beside_every_baseline(evaluated, score):
    own = score(steady_state_rmse=1.23, first_order_rmse=0.98, arx_rmse=0.91)
    scores = dict.fromkeys(("N1_pct", "N2_pct", "EGT_C"), own)
    text = printed(terminal.print_scores, [replace(evaluated(LONG), scores=scores)])
    assert LONG in text.replace("\n", "").replace(" ", "")
    line = next(line for line in text.splitlines() if line.startswith("EGT [°C]"))
    for figure in ("0.812", "4.2 %", "0.100", "1.23", "0.980", "0.910"):
        assert figure in line


def test_square_brackets_in_a_log_name_are_text(evaluated):
    assert "[red]x[/red]" in printed(terminal.print_scores, [evaluated("[red]x[/red]")])


def test_transients_count_passed_of_assessed_and_those_not_assessable(evaluated):
    text = printed(terminal.print_transients, [evaluated(LONG)])
    line = next(line for line in text.splitlines() if line.startswith("N1"))
    assert line.split()[1] == "1/2"
    assert line.split()[-1] == "1"


def test_the_outcome_is_one_word_first(evaluated, outcome_of):
    text = printed(terminal.print_outcome, outcome_of(evaluated("a.csv")))
    assert text.startswith("FAIL  1 of 2 assessable transients (50 %)")


def test_crossval_prints_spread_and_limit():
    folds = [FoldResult(LONG, str(k), None, (), (), {"rmse.N1_pct": k}) for k in (1.0, 2.0, 6.0)]
    settings = EvaluateConfig(largest_rmse={"N1_pct": 5.0})
    text = printed(terminal.print_crossval, CrossValidation(tuple(folds), settings))
    line = next(line for line in text.splitlines() if "N1 RMSE" in line)
    assert line.split()[-5:] == ["3.00", "2.65", "1.00", "6.00", "5.00"]


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0.0, "0"), (0.012345, "0.0123"), (1.0, "1.00"), (-12.345, "-12.3"), (1234.6, "1235"),
        (0.9997, "1.00"), (1.0004, "1.00"), (0.09996, "0.100"), (99.96, "100"), (7.125, "7.12"),
        *((value, "\N{EN DASH}") for value in (float("nan"), float("inf"), None)),
    ],
)  # fmt: skip
def test_numbers_have_three_digits_after_rounding_and_no_exponent(value, text):
    assert number(value) == text
