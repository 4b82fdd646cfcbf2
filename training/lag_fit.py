"""Fits the lags of `narxcal.lag` in free run to the deviations of training logs.

An output-error estimate of few physical parameters (Jategaonkar, Flight Vehicle System
Identification, chapter 4) by least squares with a robust loss (soft L1): what no lag explains,
an unrecorded bleed, must not bend it. The core spool is fitted first, for the others follow it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation, maximum_filter1d, minimum_filter1d
from scipy.optimize import least_squares

from narxcal.errors import DataError
from narxcal.lag import PARAMETERS, Drive, LagModel, core_first, core_of, speeds_of, thickness

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.int64]
_TAU, _LEAD, _CORE, _SLOW = 0, PARAMETERS.index("lead_s"), PARAMETERS.index("core"), -1
# A temperature has one time constant: that of its probe.
_PROBE = ("log_tau", "lead_s", "core", "slow_share", "log_slow_tau")
_START_TAU, _START_LEAD_S, _START_SLOW_TAU = -0.3, 0.3, 1.5
_ROBUST = 0.15  # of the deviations' spread: errors above this count less than squared
_PRIOR = 2.0  # one unit of a parameter costs as much as this many _ROBUST once per 1000 samples
_EVALUATIONS = 15
_MOVING = 0.03  # of the core's range within _SPAN_S: there the lags are scored
_SPAN_S, _AROUND_S = 10.0, 3.0
_RASTER_S = 0.1  # the lags are exact between samples, so that no finer raster is needed
_EVERY_S = 0.2  # one sample in this time is scored
_MARGIN = 1.5  # times the largest deviation of the logs is the limit


@dataclass(frozen=True, eq=False)
class LagSamples:
    """One log: inputs (time, n_in), trimmed steady state and measured outputs (time, n_out)."""

    inputs: FloatArray
    ss: FloatArray
    measured: FloatArray

    def thinned(self, every: int) -> LagSamples:
        """Every so many-th sample."""
        return LagSamples(self.inputs[::every], self.ss[::every], self.measured[::every])


class _Part(NamedTuple):
    """The moving stretches of one log, end to end."""

    drive: Drive
    deviation: FloatArray
    starts: tuple[IntArray, FloatArray]

    def of(self, columns: IntArray) -> _Part:
        """Some of the outputs."""
        ss, target, per_unit = (part[:, columns] for part in self.drive[:3])
        rows, parts = self.starts
        drive = Drive(ss, target, per_unit, self.drive.air)
        return _Part(drive, self.deviation[:, columns], (rows, parts[:, :, columns]))


class _Task(NamedTuple):
    parts: list[_Part]
    column: int
    scale: float
    dt_s: float


def fit_lags(
    samples: Sequence[LagSamples], names: tuple[Sequence[str], tuple[str, ...]], dt_s: float
) -> LagModel:
    """Fit the lags of all outputs; `names` are those of the inputs and of the outputs.

    Raises `DataError` where nothing ever moves.
    """
    input_names, output_names = names
    every = max(int(_RASTER_S / dt_s + 1e-6), 1)
    samples, dt_s = [one.thinned(every) for one in samples], every * dt_s
    model = _first_guess(samples, input_names, output_names)
    core = core_of(output_names)
    parts = [_part(model, one, input_names, (core, dt_s)) for one in samples]
    if not sum(len(part.deviation) for part in parts):
        raise DataError(
            "the outputs never move, so no lag can be fitted",
            channel=output_names[core],
            hint="Add logs with lever moves, or set lag = false in [narx]",
        )
    for column in core_first(output_names):
        deviations = np.concatenate([part.deviation[:, column] for part in parts])
        spread = float(np.nanstd(deviations))
        scale = spread if spread > 1e-9 else 1.0
        model = _fitted(model, _Task(parts, int(column), scale, dt_s))
    return model


def _first_guess(
    samples: Sequence[LagSamples], input_names: Sequence[str], names: tuple[str, ...]
) -> LagModel:
    corrected = np.concatenate(
        [one.ss / thickness(one.inputs, input_names)[0][:, None] for one in samples]
    )
    low, high = corrected.min(axis=0), corrected.max(axis=0)
    largest = np.nanmax(np.abs(np.concatenate([one.ss - one.measured for one in samples])), axis=0)
    parameters = np.zeros((len(names), len(PARAMETERS)))
    parameters[:, _TAU] = _START_TAU
    parameters[:, _LEAD] = np.where(speeds_of(names), _START_LEAD_S, 0.0)
    parameters[:, _SLOW] = _START_SLOW_TAU
    return LagModel(
        output_names=names,
        parameters=parameters,
        centre=0.5 * (low + high),
        half=np.maximum(0.5 * (high - low), 1e-9),
        limit=_MARGIN * np.maximum(largest, 1e-9),
    )


def _part(
    model: LagModel, one: LagSamples, input_names: Sequence[str], how: tuple[int, float]
) -> _Part:
    core, dt_s = how
    rows = np.flatnonzero(_moving(one.ss[:, core], 2.0 * float(model.half[core]), dt_s))
    begins = np.flatnonzero(np.diff(rows, prepend=-2) > 1)
    deviation = one.ss[rows] - one.measured[rows]
    fast = np.nan_to_num(deviation[begins])
    starts = (begins.astype(np.int64), np.stack([fast, np.zeros_like(fast)], axis=1))
    return _Part(model.drive(one.inputs, input_names, one.ss).rows(rows), deviation, starts)


def _moving(ss: FloatArray, full: float, dt_s: float) -> BoolArray:
    size = max(round(_SPAN_S / dt_s), 2)
    swing = maximum_filter1d(ss, size) - minimum_filter1d(ss, size)
    around = max(round(_AROUND_S / dt_s), 1)
    moving: BoolArray = binary_dilation(swing > _MOVING * full, iterations=around)
    return moving


def _fitted(model: LagModel, task: _Task) -> LagModel:
    """The model with the parameters of one output fitted."""
    free = _free(model, task.column)
    begin = model.parameters[task.column, free]
    columns = np.unique([model.core, task.column])  # the others do not act on it
    small = model.of(columns)
    task = _Task(
        [part.of(columns) for part in task.parts],
        int(np.searchsorted(columns, task.column)),
        task.scale,
        task.dt_s,
    )

    def residuals(values: FloatArray) -> FloatArray:
        return _residuals(_with(small, task.column, free, values), task, values - begin)

    found = least_squares(
        residuals, begin, x_scale="jac", loss="soft_l1", f_scale=_ROBUST, max_nfev=_EVALUATIONS
    )
    return _with(model, int(columns[task.column]), free, found.x)


def _free(model: LagModel, column: int) -> BoolArray:
    names = PARAMETERS if speeds_of(model.output_names)[column] else _PROBE
    free = np.array([name in names for name in PARAMETERS])
    free[_CORE] = column != model.core
    return free


def _with(model: LagModel, column: int, free: BoolArray, values: FloatArray) -> LagModel:
    parameters = model.parameters.copy()
    parameters[column, free] = values
    return replace(model, parameters=parameters)


def _residuals(model: LagModel, task: _Task, moved: FloatArray) -> FloatArray:
    every = max(round(_EVERY_S / task.dt_s), 1)
    errors = []
    for part in task.parts:
        fast, slow = model.run(part.drive, part.starts, task.dt_s)
        error = fast[:, task.column] + slow[:, task.column] - part.deviation[:, task.column]
        errors.append(np.nan_to_num(error[::every]) / task.scale)
    error = np.concatenate(errors)
    prior = _PRIOR * _ROBUST * np.sqrt(len(error) / 1000.0) * moved
    return np.concatenate([error, prior])
