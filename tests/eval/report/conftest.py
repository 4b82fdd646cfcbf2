"""A hand-made evaluation: one log, a push that passes, a pull that fails, one not assessable."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from data_prep.events import Event
from data_prep.log import Audit, AuditEntry, Log, Source
from eval.judging.evaluate import Evaluation
from eval.judging.free_run import FreeRun
from eval.judging.log_evaluation import LogEvaluation
from eval.judging.residuals import residual_tests
from eval.judging.scores import ChannelScores
from eval.judging.trim import Trim
from eval.report.page import RunHeader
from eval.report.view import LogView
from eval.run_logs import EvaluateConfig
from training.responses.transients import Overlay, TransientsConfig, assessed

HOSTILE = '<script>alert("x")</script> & co.csv:left'
DT_S = 0.1


def lagged(command: np.ndarray, tau_s: float) -> np.ndarray:
    """First-order response, exact on the raster."""
    share = 1.0 - np.exp(-DT_S / tau_s)
    state = np.empty_like(command)
    state[0] = command[0]
    for k in range(1, len(command)):
        state[k] = state[k - 1] + share * (command[k - 1] - state[k - 1])
    return state


def make_header() -> RunHeader:
    return RunHeader(
        title="Free-run validation",
        created="2026-11-21 02:05 UTC",
        run="runs/a",
        model="NARX, 8 tanh units",
        rules="paper",
        tolerances="10 % or 0.25 s",
        sources=(Source(file="/flights/" + HOSTILE, sha256="ab" * 32, engine="left"),),
        versions={"narxcal": "0.1.0"},
        facts={"Seeds": "0"},
        config="[narx]\nhidden = 8\n",
    )


def log_and_events(name: str = HOSTILE, began_s: float = 0.0) -> tuple[Log, list[Event]]:
    """60 s push, 60 s pull, and a nudge too small to assess, 20 s each way settled."""
    time = np.arange(900) * DT_S
    lever = np.where(time < 10, 30.0, np.where(time < 40, 70.0, np.where(time < 65, 30.0, 32.0)))
    flight = lagged(lever, 1.0)
    flight = np.where((time > 55) & (time < 57), np.nan, flight)
    masked = ((began_s + 55.1, began_s + 56.9),)
    audit = Audit().add(AuditEntry("N1_pct", "masked", "frozen", 19, masked))
    channels = {"TRA_deg": lever, "N1_pct": flight, "ALT_ft": np.full(900, 5000.0)}
    log = Log(name, began_s + time, channels, audit, Source(file=name))
    events = [
        Event(name, 99, 300, 0, "fast", 9.9, 30.0, 70.0, settled=True, interrupted=False),
        Event(name, 399, 540, 1, "fast", 39.9, 70.0, 30.0, settled=True, interrupted=False),
        Event(name, 649, 850, 0, "small", 64.9, 30.0, 32.0, settled=True, interrupted=False),
    ]
    return log, [replace(each, start_s=began_s + each.start_s) for each in events]


def model_of(log: Log) -> np.ndarray:
    """Right in the push; twice as slow in the pull."""
    lever = log["TRA_deg"]
    model = np.where(log.time_s - log.time_s[0] < 39.0, lagged(lever, 1.0), lagged(lever, 2.0))
    return model[:, None]


def make_score(**changed: float) -> ChannelScores:
    figures = dict.fromkeys(ChannelScores.__dataclass_fields__, float("nan"))
    figures |= {"samples": 881, "rmse": 0.8123, "nrmse": 0.05, "max_rel_pct": 4.2}
    figures |= {"one_step_rmse": 0.1, "steady_state_rmse": 1.5, "arx_rmse": 0.9}
    return ChannelScores(**figures | changed)


def make_evaluation(
    name: str = HOSTILE, trim: Trim | None = None, began_s: float = 0.0
) -> LogEvaluation:
    log, events = log_and_events(name, began_s)
    model, rows = model_of(log), np.ones(len(log), dtype=bool)
    measured = log.matrix(["N1_pct"])
    run = FreeRun(
        log=log,
        channels=("N1_pct",),
        measured=measured,
        outputs={"model": model, "steady_state": log["TRA_deg"][:, None]},
        inputs_known=rows,
        quasi_steady=~rows,
        in_envelope=rows,
        level=np.zeros(len(log)),
        scored_from=0 if trim is None else trim.until,
        trims={} if trim is None else {"model": trim},
    )
    overlay = Overlay(log.time_s, measured, model, ("N1_pct",))
    found = assessed(events, overlay, TransientsConfig())
    return LogEvaluation(run, "new", {"N1_pct": make_score()}, found, {})


def make_view(name: str = HOSTILE, one: LogEvaluation | None = None) -> LogView:
    one = one or make_evaluation(name)
    log, residual = one.log, (one.run.model - one.run.measured)[:, 0]
    inputs = {name: log[name] for name in ("TRA_deg", "ALT_ft")}
    return LogView(
        log=log,
        driver="TRA_deg",
        outputs=("N1_pct",),
        events=one.events,
        pearson=pd.DataFrame({"N1_pct": [0.93, np.nan]}, index=["TRA_deg", "ALT_ft"]),
        evaluation=one,
        residuals=[residual_tests("N1_pct", residual, inputs, log.dt_s)],
    )


@pytest.fixture(scope="session")
def header() -> RunHeader:
    return make_header()


@pytest.fixture(scope="session")
def evaluated() -> Callable[..., LogEvaluation]:
    """Makes the evaluation of one log."""
    return make_evaluation


@pytest.fixture(scope="session")
def view() -> Callable[..., LogView]:
    """Makes the view of one log."""
    return make_view


@pytest.fixture(scope="session")
def outcome_of():
    """The verdict on evaluated logs."""
    return lambda *logs: Evaluation(logs, EvaluateConfig()).outcome


@pytest.fixture(scope="session")
def score() -> Callable[..., ChannelScores]:
    """Makes the scores of a channel."""
    return make_score
