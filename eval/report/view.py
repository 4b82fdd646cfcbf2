"""One log as pages show it: what `prepare` has of it, and its evaluation where there is a model."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from data_prep.events import Event
from data_prep.log import Log
from data_prep.ranking import pearson
from eval.residuals import ResidualTests, residual_tests
from eval.transients import AssessedEvent, Assessment
from narxcal.channels import described
from narxcal.support.arrays import FloatArray
from narxcal.support.errors import DataError

if TYPE_CHECKING:
    from eval.evaluate import LogEvaluation

# Seconds shown before the lever moves, so that a reader sees the level it moves from.
LEAD_S = 3.0


@dataclass(frozen=True, eq=False)
class Curves:
    """One output over time, arrays `(time,)` in the channel's unit; NaN where masked."""

    name: str
    measured: FloatArray
    model: FloatArray | None = None
    steady: FloatArray | None = None
    half_width: FloatArray | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class LogView:
    """One log, its outputs and events.

    The page of `prepare` has no evaluation and no residuals. `pearson` has inputs as rows and
    outputs as columns.
    """

    log: Log
    driver: str
    outputs: tuple[str, ...]
    events: Sequence[AssessedEvent] = ()
    pearson: pd.DataFrame | None = None
    evaluation: LogEvaluation | None = None
    residuals: Sequence[ResidualTests] = ()

    @property
    def name(self) -> str:
        """The log's name."""
        return self.log.name

    @property
    def assessments(self) -> list[Assessment]:
        """Those of all events."""
        return [each for event in self.events for each in event.assessments]

    @property
    def scored_from_s(self) -> float | None:
        """Where the part used for the trim ends; None without trim."""
        run = None if self.evaluation is None else self.evaluation.run
        if run is None or run.trim is None:
            return None
        return float(self.log.time_s[min(run.scored_from, len(self.log) - 1)])

    def curves(self, rows: slice = slice(None)) -> list[Curves]:
        """Every output over `rows`."""
        run = None if self.evaluation is None else self.evaluation.run
        none = (None, None, None)
        modelled = none if run is None else (run.model, run.steady, run.half_width)
        return [
            Curves(name, self.log[name][rows], *(x if x is None else x[rows, k] for x in modelled))
            for k, name in enumerate(self.outputs)
        ]

    def rows(self, event: Event) -> slice:
        """Rows of an event with some seconds before it."""
        return slice(max(0, event.start - round(LEAD_S / self.log.dt_s)), event.stop)

    def stretch_s(self, event: Event) -> tuple[float, float]:
        """(start, stop) of `rows` on the log's clock."""
        return stretch_s(self.log.time_s, event)

    def conditions(self, event: Event) -> Mapping[str, float]:
        """Known ambient conditions and switches where an event begins."""
        found = {
            name: float(self.log[name][event.start])
            for name in self.log.channels
            if described(name).role in ("ambient", "switch")
        }
        return {name: value for name, value in found.items() if math.isfinite(value)}


def stretch_s(time_s: FloatArray, event: Event) -> tuple[float, float]:
    """(start, stop) of an event with some seconds before it, within `time_s` (time,)."""
    start_s = max(float(time_s[0]), event.start_s - LEAD_S)
    return start_s, float(time_s[min(event.stop, len(time_s)) - 1])


def view_of(one: LogEvaluation, driver: str, inputs: Sequence[str]) -> LogView:
    """One evaluated log with its rank of inputs and its residual tests on the scored rows.

    Raises `DataError` if the log lacks the driver or an input.
    """
    run, log = one.run, one.log
    if driver not in log.channels:
        raise DataError("the log has no such channel", file=log.name, channel=driver)
    names = list(dict.fromkeys((driver, *inputs)))
    residual = np.where(run.scored[:, None], run.model - run.measured, np.nan)[run.scored_from :]
    moving = {name: log[name][run.scored_from :] for name in names}
    return LogView(
        log=log,
        driver=driver,
        outputs=run.channels,
        events=one.events,
        pearson=pearson(log, names, run.channels),
        evaluation=one,
        residuals=[
            residual_tests(name, residual[:, k], moving, log.dt_s)
            for k, name in enumerate(run.channels)
        ],
    )
