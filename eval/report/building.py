"""Fills page records from logs, events and assessments, so that callers need not slice arrays."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd

from data_prep.events import Event
from data_prep.log import Log
from eval.report.content import (
    ChannelTrace,
    EventTrace,
    LogPage,
    NoiseSweep,
    ResidualTests,
    Response,
)
from eval.residuals import autocorrelation, cross_correlation
from eval.transients import Assessment
from narxcal.channels import CHANNELS
from narxcal.support.arrays import FloatArray

# Seconds shown before the lever moves, so that a reader sees the level it moves from.
LEAD_S = 3.0


def log_page(
    log: Log,
    driver: str,
    traces: Sequence[ChannelTrace],
    events: Sequence[Event] = (),
    assessments: Sequence[Assessment] = (),
) -> LogPage:
    """Page record of one log; complete it with `dataclasses.replace` (scores, residuals, ...).

    `traces` hold whole-log arrays `(time,)`; `assessments` may cover more than these events.
    """
    return LogPage(
        name=log.name,
        time_s=log.time_s,
        driver_name=driver,
        driver=log[driver],
        channels=tuple(traces),
        events=tuple(_cut(log, driver, traces, event, assessments) for event in events),
        audit=log.audit,
    )


def traces_of(
    log: Log,
    names: Sequence[str],
    model: FloatArray | None = None,
    steady: FloatArray | None = None,
) -> list[ChannelTrace]:
    """Whole-log traces of the outputs `names`; `model` and `steady` are `(time, n_out)`."""
    return [
        ChannelTrace(
            name=name,
            measured=log[name],
            model=None if model is None else model[:, column],
            steady=None if steady is None else steady[:, column],
        )
        for column, name in enumerate(names)
    ]


def _cut(
    log: Log,
    driver: str,
    traces: Sequence[ChannelTrace],
    event: Event,
    assessments: Sequence[Assessment],
) -> EventTrace:
    lead = round(LEAD_S / log.dt_s)
    rows = slice(max(0, event.start - lead), event.stop)
    own = [one for one in assessments if abs(one.start_s - event.start_s) < 0.5 * log.dt_s]
    return EventTrace(
        event=event,
        time_s=log.time_s[rows],
        driver=log[driver][rows],
        channels=tuple(_part(trace, rows) for trace in traces),
        responses={
            one.channel: Response(flight=one.flight, model=one.model, verdict=one.verdict)
            for one in own
        },
        conditions=_conditions(log, event.start),
    )


def _part(trace: ChannelTrace, rows: slice) -> ChannelTrace:
    return ChannelTrace(
        name=trace.name,
        measured=trace.measured[rows],
        model=None if trace.model is None else trace.model[rows],
        steady=None if trace.steady is None else trace.steady[rows],
    )


def _conditions(log: Log, row: int) -> Mapping[str, float]:
    return {
        name: float(log[name][row])
        for name in log.channels
        if name in CHANNELS and CHANNELS[name].role in ("ambient", "switch")
    }


def residual_tests(
    log: Log, traces: Sequence[ChannelTrace], inputs: Sequence[str], lag_s: float = 10.0
) -> list[ResidualTests]:
    """Correlate every free-run residual (model minus measured) with itself and the inputs.

    Inputs that never change are left out: they correlate with nothing.
    """
    lags = max(1, round(lag_s / log.dt_s))
    moving = [name for name in inputs if _moves(log[name])]
    tests = []
    for trace in traces:
        if trace.model is None:
            continue
        residual = [trace.model - trace.measured]
        cross = {
            name: cross_correlation([log[name]], residual, lags, coloured=True) for name in moving
        }
        auto = autocorrelation(residual, lags)
        tests.append(ResidualTests(channel=trace.name, dt_s=log.dt_s, auto=auto, cross=cross))
    return tests


def _moves(values: FloatArray) -> bool:
    known = values[np.isfinite(values)]
    return bool(len(known) and known.max() > known.min())


def noise_curves(
    log: str, channel: str, found: pd.DataFrame, labels: Mapping[str, str]
) -> NoiseSweep:
    """Page record of one log's noise experiment; `labels` name the columns of RMSE to draw."""
    return NoiseSweep(
        log=log,
        channel=channel,
        snr_db=found["snr_db"].to_numpy(dtype=np.float64),
        curves={
            label: found[name].to_numpy(dtype=np.float64)
            for name, label in labels.items()
            if found[name].notna().any()
        },
        nis=found["mean_nis"].to_numpy(dtype=np.float64),
        nis_band=(float(found["nis_low"].mean()), float(found["nis_high"].mean())),
    )
