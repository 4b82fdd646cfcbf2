"""The page of an `eval.evaluate.Evaluation`: every figure from the object that writes the JSON."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from data_prep.ranking import pearson
from eval.evaluate import Evaluation, LogEvaluation
from eval.free_run import ARX, FIRST_ORDER, MODEL, STEADY_STATE
from eval.report.building import log_page, residual_tests, traces_of
from eval.report.content import LogPage, Offsets, RunHeader, Score
from eval.report.page import Outcome, outcome
from eval.scores import ChannelScores
from eval.tally import Tally, tally
from narxcal.support.errors import DataError

_NAMES = {STEADY_STATE: "steady state", FIRST_ORDER: "first order", ARX: "ARX"}


def verdict_of(header: RunHeader, evaluation: Evaluation, pages: Sequence[LogPage]) -> Outcome:
    """Return the evaluation's own verdict, with the tolerances that it missed first."""
    words = outcome(header, pages)
    missed = tuple(f"{line.rstrip('.')}." for line in evaluation.missed())
    passed = None if words.passed is None and not missed else not missed
    return Outcome(
        passed,
        words.headline,
        (*missed, *words.lines),
    )


def page_of(one: LogEvaluation, driver: str, inputs: Sequence[str]) -> LogPage:
    """Turn one evaluated log into its page record.

    Raises `DataError` if the log lacks the driver or an input.
    """
    runs, log = one.runs, one.log
    if driver not in log.channels:
        raise DataError("the log has no such channel", file=log.name, channel=driver)
    steady = runs.outputs.get(STEADY_STATE)
    traces = traces_of(log, runs.channels, runs.outputs[MODEL], steady)
    names = list(dict.fromkeys((driver, *inputs)))
    scored = log.part(runs.scored_from, len(log))
    counted = np.where(runs.scored[:, None], runs.outputs[MODEL], np.nan)
    tested = traces_of(scored, runs.channels, counted[runs.scored_from :])
    offsets = _offsets(one)
    return replace(
        log_page(log, driver, traces, one.events, one.assessments),
        scores=tuple(_score(one, name) for name in runs.channels),
        residuals=tuple(residual_tests(scored, tested, names)),
        pearson=pearson(log, names, runs.channels),
        role=one.role,
        tallies={"model": tally(one.assessments), **_rivals(one)},
        offsets=offsets,
        scored_from_s=float(scored.time_s[0]) if offsets is not None else None,
    )


def _score(one: LogEvaluation, name: str) -> Score:
    figures = one.scores[name]
    before = one.untrimmed.get(name)
    return Score(
        channel=name,
        samples=int(figures.samples),
        rmse=figures.rmse,
        nrmse=figures.nrmse,
        max_rel_pct=figures.max_rel_pct,
        one_step_rmse=figures.one_step_rmse,
        static_rmse=figures.static_rmse,
        dynamic_rmse=figures.dynamic_rmse,
        bias=figures.bias,
        untrimmed_rmse=float("nan") if before is None else before.rmse,
        baselines=_baselines(figures),
    )


def _baselines(figures: ChannelScores) -> dict[str, float]:
    return {
        _NAMES[STEADY_STATE]: figures.steady_state_rmse,
        _NAMES[FIRST_ORDER]: figures.first_order_rmse,
        _NAMES[ARX]: figures.arx_rmse,
    }


def _rivals(one: LogEvaluation) -> dict[str, Tally]:
    return {_NAMES.get(name, name): found for name, found in one.rivals.items()}


def _offsets(one: LogEvaluation) -> Offsets | None:
    trim = (one.runs.trims or {}).get(MODEL)
    if trim is None:
        return None
    added = dict(zip(one.runs.channels, trim.offsets.T.tolist(), strict=True))
    return Offsets(levels=trim.nodes.tolist(), added=added)
