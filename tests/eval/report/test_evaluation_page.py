"""The page of an evaluation shows the very figures of its JSON document."""

from __future__ import annotations

import numpy as np
import pytest

from eval.judging.evaluate import evaluate
from eval.report.page import evaluate_page
from eval.report.style import number
from eval.report.view import view_of
from eval.run_logs import EvaluateConfig
from narxcal.support.errors import DataError
from tests.eval.conftest import lag_bundle, lag_log

INPUTS = ("TRA_deg", "Mach")


@pytest.fixture(scope="module")
def slow():
    """An engine 40 % slower and 0.5 % off its model, evaluated with trim."""
    return evaluate(lag_bundle(), [lag_log(tau_s=(2.1, 0.8), offset=(0.5, 0.0))], trim=0.2)


@pytest.mark.slow
def test_page_and_document_agree(slow, header):
    document = slow.document()
    view = view_of(slow.logs[0], "TRA_deg", INPUTS)
    (row,) = document["logs"]
    assert view.scored_from_s == row["trim"]["scored_from_s"]
    html = evaluate_page(header, [view], slow.outcome)
    n1 = row["channels"]["N1_pct"]
    for figure in ("rmse", "arx_rmse", "untrimmed_rmse", "bias", "one_step_rmse"):
        assert f">{number(n1[figure])}</td>" in html
    counts = row["ti_tt"]
    tile = '<div class="tile"><b>{}</b><span>{}</span></div>'
    assert tile.format(counts["assessed"], "assessable transients") in html
    assert tile.format(counts["passed"], "passed") in html
    assert "before trim" in html
    assert "flight.csv:left (new)" in html


def test_residuals_are_those_of_the_scored_rows_and_of_moving_inputs(slow):
    first = view_of(slow.logs[0], "TRA_deg", INPUTS).residuals[0]
    assert set(first.cross) == {"TRA_deg"}
    assert first.auto.values[0] == pytest.approx(1.0)
    scored = np.count_nonzero(slow.logs[0].run.scored)
    assert first.auto.deviation[0] == pytest.approx(1.0 / np.sqrt(scored))


def test_a_missed_tolerance_leads_the_verdict(slow):
    assert slow.outcome.passed is False
    assert slow.outcome.exit_code == 1
    assert slow.outcome.lines[0] == f"{slow.missed[0]}."


def test_nothing_to_assess_is_no_pass(make_bundle, make_log):
    short = make_log(duration_s=15.0)
    result = evaluate(make_bundle(), [short], settings=EvaluateConfig())
    assert result.outcome.passed is None
    assert result.outcome.exit_code == 1
    assert result.outcome.headline == "No event could be assessed for Ti and Tt"
    expected = "Ti/Tt of engine left: no transient could be assessed (no event was found)"
    assert result.missed == [expected]
    assert result.document()["ok"] is False


def test_a_model_without_a_channel_of_the_rules_says_so_and_not_that_nothing_moved(
    make_bundle, make_log
):
    settings = EvaluateConfig(transients={"channels": ["NP_rpm"], "least_response": {"NP_rpm": 50}})
    result = evaluate(make_bundle(), [make_log()], settings=settings)
    reason = (
        "the model has no output NP_rpm, and nothing says how its N1_pct, N2_pct are judged: "
        "before training, name channels and their least_response in [evaluate.transients]"
    )
    expected = f"Ti/Tt of engine left: no transient could be assessed ({reason})"
    assert expected in result.missed


def test_an_engine_of_which_nothing_could_be_assessed_is_no_pass(make_bundle, make_log, mask):
    lost = mask(make_log("flight.csv:right"), "Mach", slice(1, None))
    result = evaluate(make_bundle(), [make_log(), lost])
    assert result.outcome.passed is None
    reason = "inputs are missing at 101 to 107 samples"
    expected = f"Ti/Tt of engine right: no transient could be assessed ({reason})"
    none = "0 % of it is judged (inputs are missing), at least 90 % have to be"
    assert result.missed == [
        *(f"flight.csv:right: {name} is not assessable, {none}" for name in ("N1_pct", "N2_pct")),
        expected,
    ]


def test_bounds_on_errors_alone_are_evidence_where_no_transient_is_demanded(make_bundle, make_log):
    settings = EvaluateConfig(least_passed_pct=0.0, largest_rmse={"N1_pct": 1.0})
    result = evaluate(make_bundle(), [make_log()], settings=settings)
    assert result.outcome.passed is True
    assert result.outcome.exit_code == 0
    steady = evaluate(make_bundle(), [make_log(duration_s=15.0)], settings=settings)
    assert steady.outcome.passed is None  # the steady state alone meets the bound


def test_a_log_without_the_driver_is_refused(slow):
    with pytest.raises(DataError) as caught:
        view_of(slow.logs[0], "FF_kgph", INPUTS)
    assert str(caught.value) == "flight.csv:left, channel FF_kgph: the log has no such channel"
