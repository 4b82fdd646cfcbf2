"""Hand-made page content: one log, a push that passes, a pull that fails, one not assessable."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pandas as pd
import pytest

from data_prep.events import Event
from data_prep.log import Audit, AuditEntry, Log, Source
from eval.report.building import log_page, residual_tests, traces_of
from eval.report.content import LogPage, RunHeader, Score
from eval.transients import Overlay, TransientsConfig, assess_events

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


def log_and_events(name: str = HOSTILE) -> tuple[Log, list[Event]]:
    """60 s push, 60 s pull, and a nudge too small to assess, 20 s each way settled."""
    time = np.arange(900) * DT_S
    lever = np.where(time < 10, 30.0, np.where(time < 40, 70.0, np.where(time < 65, 30.0, 32.0)))
    flight = lagged(lever, 1.0)
    flight = np.where((time > 55) & (time < 57), np.nan, flight)
    audit = Audit().add(AuditEntry("N1_pct", "masked", "frozen", 19, ((55.1, 56.9),)))
    channels = {"TRA_deg": lever, "N1_pct": flight, "ALT_ft": np.full(900, 5000.0)}
    log = Log(name, time, channels, audit, Source(file=name))
    events = [
        Event(name, 99, 300, 0, "fast", 9.9, 30.0, 70.0, settled=True, interrupted=False),
        Event(name, 399, 540, 1, "fast", 39.9, 70.0, 30.0, settled=True, interrupted=False),
        Event(name, 649, 850, 0, "small", 64.9, 30.0, 32.0, settled=True, interrupted=False),
    ]
    return log, events


def model_of(log: Log) -> np.ndarray:
    """Right in the push; twice as slow in the pull."""
    lever = log["TRA_deg"]
    model = np.where(log.time_s < 39.0, lagged(lever, 1.0), lagged(lever, 2.0))
    return model[:, None]


def make_page(name: str = HOSTILE) -> LogPage:
    log, events = log_and_events(name)
    model = model_of(log)
    traces = traces_of(log, ["N1_pct"], model, log["TRA_deg"][:, None])
    overlay = Overlay(log.time_s, log.matrix(["N1_pct"]), model, ("N1_pct",))
    made = log_page(
        log, "TRA_deg", traces, events, assess_events(events, overlay, TransientsConfig())
    )
    fields = {field: getattr(made, field) for field in made.__dataclass_fields__}
    return LogPage(
        **fields
        | {
            "scores": (make_score(),),
            "residuals": residual_tests(log, traces, ["TRA_deg", "ALT_ft"], lag_s=3.0),
            "pearson": pd.DataFrame({"N1_pct": [0.93, np.nan]}, index=["TRA_deg", "ALT_ft"]),
        }
    )


def make_score(**changed: object) -> Score:
    figures = {
        "channel": "N1_pct",
        "samples": 881,
        "rmse": 0.8123,
        "nrmse": 0.05,
        "max_rel_pct": 4.2,
        "one_step_rmse": 0.1,
        "baselines": {"steady state": 1.5, "ARX": 0.9},
    }
    return Score(**figures | changed)


@pytest.fixture(scope="session")
def header() -> RunHeader:
    return make_header()


@pytest.fixture(scope="session")
def page() -> Callable[..., LogPage]:
    """Makes a page record of one log."""
    return make_page


@pytest.fixture(scope="session")
def score() -> Callable[..., Score]:
    """Makes a score, changed as asked."""
    return make_score
