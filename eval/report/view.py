"""What is drawn: one log with its evaluation, or what a user gives, in one form.

`LogView` is a log as pages show it: what `prepare` has of it, and its evaluation where there is a
model. `Traces` are the inputs and outputs of one record over time, whatever it was given as.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol, TypeAlias

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from data_prep.events import Event
from data_prep.log import Log
from data_prep.prepare import hold_inputs, with_outputs
from data_prep.ranking import pearson
from eval.judging.residuals import ResidualTests, residual_tests
from narxcal.channels import described
from narxcal.intervals import LEVEL
from narxcal.record import Record, RecordLike, as_records, columns, known_start
from narxcal.support.arrays import BoolArray, FloatArray
from narxcal.support.errors import DataError
from training.responses.transients import AssessedEvent, Assessment

if TYPE_CHECKING:
    from eval.judging.log_evaluation import LogEvaluation
    from narxcal.calibration.bundle import Bundle
    from narxcal.calibration.calibration import Calibration
    from training.estimator.narx import Narx

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
        return self.log.name

    @property
    def assessments(self) -> list[Assessment]:
        return [each for event in self.events for each in event.assessments]

    @property
    def scored_from_s(self) -> float | None:
        """Where the part used for the trim ends; None without trim."""
        run = None if self.evaluation is None else self.evaluation.run
        if run is None or run.trim is None:
            return None
        return float(self.log.time_s[min(run.scored_from, len(self.log) - 1)])

    def curves(self, rows: slice = slice(None)) -> list[Curves]:
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
        """(start, stop) of `rows` in seconds after the log began."""
        began_s = float(self.log.time_s[0])
        start_s, stop_s = stretch_s(self.log.time_s, event)
        return start_s - began_s, stop_s - began_s

    def when(self, event: Event) -> str:
        """When the lever moves, for people."""
        return self.log.moment(event.start_s)

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


# --- what a user gives ---


class Viewed(Protocol):
    """A result that shows logs."""

    @property
    def views(self) -> Sequence[LogView]: ...


class Run(Protocol):
    """A result that holds a model."""

    @property
    def bundle(self) -> Bundle: ...


Data: TypeAlias = Viewed | LogView | Log | RecordLike
Model: TypeAlias = "Run | Bundle | Calibration | Narx | NDArray[np.float64]"


@dataclass(frozen=True, eq=False)
class Traces:
    """One record: inputs (time,) and outputs by name; `scored` (time,) are the rows that count."""

    name: str
    time_s: FloatArray
    dt_s: float
    inputs: Mapping[str, FloatArray]
    outputs: Mapping[str, Curves]
    scored: BoolArray
    driver: str

    def output(self, name: str | None = None) -> Curves:
        """One output, the first by default; raises `DataError` where there is none such."""
        return self.outputs[_chosen(name, list(self.outputs), self.name, "output")]

    def input(self, name: str | None = None) -> str:
        """Name of an input, the driver by default; raises `DataError` where there is none such."""
        return _chosen(name or self.driver, list(self.inputs), self.name, "input")

    def error(self, channel: str | None = None) -> FloatArray:
        """Model less measured (time,), NaN where it is not scored; `DataError` without a model."""
        curves = self.output(channel)
        if curves.model is None:
            raise DataError(
                "there is no model to compare with", file=self.name, hint="Give one after the data"
            )
        return np.where(self.scored, curves.model - curves.measured, np.nan)


def _chosen(name: str | None, names: Sequence[str], record: str, what: str) -> str:
    if name is None or name in names:
        return names[0] if name is None else name
    hint = f"There {'is' if len(names) == 1 else 'are'} {', '.join(names)}"
    raise DataError(f"there is no such {what}", file=record, channel=name, hint=hint)


class _Runner(NamedTuple):
    """A model by its names, () where it has none, and its free run over inputs from a start."""

    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    dt_s: float
    simulate: Callable[[FloatArray, FloatArray], FloatArray]
    half_width: Callable[[FloatArray, FloatArray], FloatArray] | None = None


def traces(data: Data, model: Model | None = None) -> Traces:
    """Bring `data` into this form; with a model, with its free run from the first sample."""
    view = _view(data)
    if view is not None and model is None:
        return _of_view(view)
    if model is None:
        raise DataError(
            f"expected a model after {_kind(data)}", hint="Give one, or the result of an evaluation"
        )
    if isinstance(model, np.ndarray):
        return _with_run(_record(data), model)
    log = data if view is None else view.log
    run = _runner(model, log)
    found = _of_log(log, run) if isinstance(log, Log) else _of_record(_record(log), run)
    u = np.column_stack(list(found.inputs.values()))
    measured = np.column_stack([one.measured for one in found.outputs.values()])
    free = run.simulate(u, measured)
    half = None if run.half_width is None else run.half_width(u, free)
    outputs = {
        name: replace(one, model=free[:, k], half_width=None if half is None else half[:, k])
        for k, (name, one) in enumerate(found.outputs.items())
    }
    return replace(found, outputs=outputs)


def model_of(model: Model, data: Data) -> tuple[Traces, Callable[[FloatArray], FloatArray]]:
    """`data` over the inputs of `model`, and its free run over inputs (time, n_in) from typical."""
    if isinstance(model, np.ndarray):
        raise DataError("expected a model that can be run, found its outputs")
    view = _view(data)
    given = data if view is None else view.log
    run = _runner(model, given)
    found = _of_log(given, run) if isinstance(given, Log) else _of_record(_record(given), run)
    typical = np.array([[np.nanmedian(one.measured) for one in found.outputs.values()]])
    if view is not None and view.driver in found.inputs:
        found = replace(found, driver=view.driver)
    return found, lambda u: run.simulate(u, typical)


def view_of_data(data: Data) -> LogView:
    """The log that a result shows, of several the first; raises `DataError` for other data."""
    view = _view(data)
    if view is None:
        raise DataError(
            f"expected what prepare or evaluate give, found {_kind(data)}",
            hint="Events are found when logs are prepared",
        )
    return view


def _view(data: object) -> LogView | None:
    views = getattr(data, "views", None)
    if views is not None:
        if not len(views):
            raise DataError("the result holds no log")
        found: LogView = views[0]
        return found
    return data if isinstance(data, LogView) else None


def _of_view(view: LogView) -> Traces:
    log, run = view.log, None if view.evaluation is None else view.evaluation.run
    names = [view.driver, *([] if view.pearson is None else map(str, view.pearson.index))]
    return Traces(
        log.name,
        log.time_s,
        log.dt_s,
        {name: log[name] for name in dict.fromkeys(names) if name in log.channels},
        {one.name: one for one in view.curves()},
        np.ones(len(log), dtype=np.bool_) if run is None else run.scored,
        view.driver,
    )


def _of_log(log: Log, run: _Runner) -> Traces:
    log = with_outputs(log, run.outputs)
    held = hold_inputs(log, run.inputs)
    levers = [name for name in run.inputs if described(name).role == "lever"]
    return Traces(
        log.name,
        log.time_s,
        log.dt_s,
        {name: held[name] for name in run.inputs},
        {name: Curves(name, log[name]) for name in run.outputs},
        np.asarray(np.isfinite(log.matrix(run.inputs)).all(axis=1)),
        [*levers, *run.inputs][0],
    )


def _record(data: Any) -> Record:
    if isinstance(data, Log | LogView):
        raise DataError(
            "outputs of a model come with a record", hint="Pass (u, y) in the place of the log"
        )
    records = as_records(data)
    if len(records) != 1:
        raise DataError(f"expected one record, found {len(records)}", hint="Draw one at a time")
    return records[0]


def _of_record(record: Record, run: _Runner) -> Traces:
    record = record.ordered(run.inputs, run.outputs)
    scored = np.ones(len(record), dtype=np.bool_)
    scored[:1] = False  # where a free run starts
    return _named(record, run.dt_s, scored)


def _with_run(record: Record, values: NDArray[np.float64]) -> Traces:
    model = columns(values, "model")
    if model.shape != record.y.shape:
        raise DataError(
            f"expected outputs of the model of shape {record.y.shape}, found {model.shape}",
            file=record.name,
        )
    found = _named(record, 1.0, np.ones(len(record), dtype=np.bool_))
    outputs = {
        name: replace(one, model=model[:, k]) for k, (name, one) in enumerate(found.outputs.items())
    }
    return replace(found, outputs=outputs)


def _named(record: Record, dt_s: float, scored: BoolArray) -> Traces:
    inputs = record.inputs or [f"u{k}" for k in range(1, record.u.shape[1] + 1)]
    outputs = record.outputs or [f"y{k}" for k in range(1, record.y.shape[1] + 1)]
    return Traces(
        record.name,
        np.arange(len(record), dtype=np.float64) * dt_s,
        dt_s,
        dict(zip(inputs, record.u.T, strict=True)),
        {name: Curves(name, y) for name, y in zip(outputs, record.y.T, strict=True)},
        scored,
        inputs[0],
    )


def _runner(model: Any, data: object) -> _Runner:
    """The model within a result or bundle, for the engine of a log."""
    own = getattr(model, "bundle", model)
    own = getattr(own, "calibration", own)
    if hasattr(own, "output_names"):
        engine = data.source.engine if isinstance(data, Log) else ""
        own = own.for_engine(engine, or_mean=True)
        return _Runner(
            own.input_names,
            own.output_names,
            own.dt_s,
            lambda u, y: own.simulate(u, y[0]),
            None if own.interval is None else lambda u, y: own.half_width(u, y, LEVEL),
        )
    if hasattr(own, "output_names_"):
        return _Runner(
            own.input_names_,
            own.output_names_,
            float(own.dt_s),
            lambda u, y: own.simulate(u, known_start(y, 1)),
        )
    raise DataError(
        f"expected a model, found {type(model).__name__}",
        hint="Pass a run, a bundle, a Calibration, a Narx, or the outputs of any other as an array",
    )


def _kind(data: object) -> str:
    return "a log" if isinstance(data, Log) else f"data of type {type(data).__name__}"
