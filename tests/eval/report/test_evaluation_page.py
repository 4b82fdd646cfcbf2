"""The page of an evaluation shows the very figures of its JSON document."""

from __future__ import annotations

import numpy as np
import pytest

from eval.evaluate import EvaluateConfig, evaluate
from eval.report.evaluation import page_of, verdict_of
from eval.report.page import count, evaluate_page
from eval.report.tables import number
from narxcal.support.errors import DataError

INPUTS = ("TRA_deg", "Mach")


@pytest.fixture
def slow(make_bundle, make_log):
    """An engine 40 % slower and 0.5 % off what the model was told, judged with trim."""
    log = make_log(tau_s=(2.1, 0.8), offset=(0.5, 0.0))
    return evaluate(make_bundle(), [log], trim=0.2)


def test_page_and_document_agree(slow, header):
    document = slow.document()
    page = page_of(slow.logs[0], "TRA_deg", INPUTS)
    (row,) = document["logs"]
    for score in page.scores:
        figures = row["channels"][score.channel]
        assert score.rmse == figures["rmse"]
        assert score.baselines["ARX"] == figures["arx_rmse"]
        assert score.untrimmed_rmse == figures["untrimmed_rmse"]
    found = count([page])
    assert (found.assessed, found.passed) == (row["ti_tt"]["assessed"], row["ti_tt"]["passed"])
    assert page.scored_from_s == row["trim"]["scored_from_s"]
    html = evaluate_page(header, [page], verdict_of(header, slow, [page]))
    assert number(row["channels"]["N1_pct"]["rmse"]) in html
    assert "before trim" in html
    assert "flight.csv:left (new)" in html


def test_residuals_are_those_of_the_scored_rows_and_of_moving_inputs(slow):
    page = page_of(slow.logs[0], "TRA_deg", INPUTS)
    first = page.residuals[0]
    assert set(first.cross) == {"TRA_deg"}
    assert first.auto.values[0] == pytest.approx(1.0)
    scored = np.count_nonzero(slow.logs[0].runs.scored)
    assert first.auto.deviation[0] == pytest.approx(1.0 / np.sqrt(scored))


def test_a_missed_tolerance_leads_the_verdict(slow, header):
    page = page_of(slow.logs[0], "TRA_deg", INPUTS)
    verdict = verdict_of(header, slow, [page])
    assert verdict.passed is False
    assert verdict.lines[0] == f"{slow.missed()[0]}."


def test_nothing_to_assess_and_nothing_missed_is_no_verdict(make_bundle, make_log, header):
    still = make_log(duration_s=15.0)
    result = evaluate(make_bundle(), [still], settings=EvaluateConfig())
    page = page_of(result.logs[0], "TRA_deg", INPUTS)
    assert verdict_of(header, result, [page]).passed is None


def test_a_log_without_the_driver_is_refused(slow):
    with pytest.raises(DataError) as caught:
        page_of(slow.logs[0], "FF_kgph", INPUTS)
    assert str(caught.value) == "flight.csv:left, channel FF_kgph: the log has no such channel"
