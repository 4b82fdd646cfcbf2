"""Fits the lags of `narxcal.lumped.lag` in free run to the deviations of training logs.

An output-error estimate of few physical parameters (Jategaonkar, Flight Vehicle System
Identification, chapter 4) by least squares with a robust loss (soft L1): what no lag explains,
an unrecorded bleed, must not bend it. The core spool is fitted first, for the others follow it; its
limits go by the fan, which is taken as measured meanwhile.

Only stretches in which the core moves are scored. *Relative* errors are divided by the swing of the
output around them, so that a small move counts as much as a slam, as it does in tolerances of Ti
and Tt; they are scored closer to the moves, where the time constants show.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.ndimage import binary_dilation, maximum_filter1d, minimum_filter1d
from scipy.optimize import least_squares

from narxcal.lumped.lag import PARAMETERS, Drive, LagModel, core_first, core_of, thickness
from narxcal.support.arrays import BoolArray, FloatArray, IntArray
from narxcal.support.errors import DataError
from training.lag_priors import LagForm, fans_of, free_parameters, prior_units, start_values

_ROBUST = 0.15  # of the deviations' spread: errors above this count less than squared
_PRIOR = 2.0  # one unit of a parameter costs as much as this many _ROBUST once per 1000 samples
_EVALUATIONS = {False: 15, True: 25}  # without and with limits
_MOVING = 0.03  # of the core's range within some seconds: there the lags are scored
_STRETCHES_S = {False: (10.0, 3.0), True: (5.0, 1.0)}  # of relative errors: within, and around
_SWING_S = 15.0  # a response with its settling
_LEAST_SWING, _USUAL_SWING = 0.05, 0.3  # as shares of the output's range; the latter counts once
_RASTER_S = 0.1  # the lags are exact between samples, so that no finer raster is needed
_EVERY_S = 0.2  # one sample in this time is scored
_MARGIN = 1.5  # times the largest deviation of the logs is the limit


@dataclass(frozen=True, eq=False)
class LagSamples:
    """One log: inputs (time, n_in), trimmed steady state and measured outputs (time, n_out)."""

    inputs: FloatArray
    ss: FloatArray
    measured: FloatArray

    def rows(self, part: slice) -> LagSamples:
        """Some of the samples."""
        return LagSamples(self.inputs[part], self.ss[part], self.measured[part])


class _Part(NamedTuple):
    """The moving stretches of one log, end to end; an error counts `weight` (time, n_out) times.

    `taken` (time, n_out), where it has rows, are deviations that are not simulated; NaN elsewhere.
    """

    drive: Drive
    deviation: FloatArray
    starts: tuple[IntArray, FloatArray]
    weight: FloatArray
    taken: FloatArray

    def of(self, columns: IntArray) -> _Part:
        """Some of the outputs."""
        ss, target, per_unit = (part[:, columns] for part in self.drive[:3])
        rows, parts = self.starts
        drive = Drive(ss, target, per_unit, self.drive.air)
        starts = (rows, parts[:, :, columns])
        rest = (self.deviation, self.weight, self.taken)
        deviation, weight, taken = (part[:, columns] for part in rest)
        return _Part(drive, deviation, starts, weight, taken)

    def taking(self, columns: IntArray) -> _Part:
        """With the deviations of some outputs taken as measured."""
        taken = np.full_like(self.deviation, np.nan)
        taken[:, columns] = self.deviation[:, columns]
        return self._replace(taken=taken)


class _Scored(NamedTuple):
    """What is scored: where the output `core` moves, in absolute or relative errors."""

    core: int
    dt_s: float
    relative: bool


class _Task(NamedTuple):
    parts: list[_Part]
    column: int
    scale: float
    dt_s: float
    limited: bool


def fit_lags(
    samples: Sequence[LagSamples],
    names: tuple[Sequence[str], tuple[str, ...]],
    dt_s: float,
    form: LagForm = LagForm(),  # noqa: B008 (it cannot be changed)
) -> LagModel:
    """Fit the lags of all outputs; `names` are those of the inputs and of the outputs.

    With `relative`, errors count as shares of the response that they belong to; with `limited`,
    there are limits of acceleration and deceleration too, and temperatures answer to the core's;
    with `heat`, what the metal gives up drives the spools.
    Raises `DataError` where nothing ever moves.
    """
    input_names, output_names = names
    samples, dt_s = thinned_for_lags(samples, dt_s)
    none = np.zeros((len(output_names), len(PARAMETERS)))
    scales = output_scales(samples, input_names)
    model = LagModel(output_names=output_names, parameters=none, **scales)
    model = replace(model, parameters=start_values(model, form))
    core = core_of(output_names)
    scored = _Scored(core, dt_s, form.relative)
    parts = [_part(model, one, input_names, scored) for one in samples]
    if not sum(len(part.deviation) for part in parts):
        raise DataError(
            "the outputs never move, so no lag can be fitted",
            channel=output_names[core],
            hint="Add logs with lever moves, or set lag = false in [narx]",
        )
    for column in core_first(output_names):
        deviations = np.concatenate([part.deviation[:, column] for part in parts])
        spread = float(np.nanstd(zero_where_never(deviations)))
        scale = spread if spread > 1e-9 else 1.0
        model = _fitted(model, _Task(parts, int(column), scale, dt_s, form.limited))
    return model


def thinned_for_lags(
    samples: Sequence[LagSamples], dt_s: float, raster_s: float = _RASTER_S
) -> tuple[list[LagSamples], float]:
    """The logs on the raster that lags are fitted on, at most `raster_s`, and that raster in s."""
    every = max(int(raster_s / dt_s + 1e-6), 1)
    return [one.rows(slice(None, None, every)) for one in samples], every * dt_s


def output_scales(
    samples: Sequence[LagSamples], input_names: Sequence[str]
) -> dict[str, FloatArray]:
    """Centre and half range of the corrected outputs, and the limit of deviations, (n_out,)."""
    corrected = np.concatenate(
        [one.ss / thickness(one.inputs, input_names)[0][:, None] for one in samples]
    )
    low, high = corrected.min(axis=0), corrected.max(axis=0)
    deviations = np.concatenate([one.ss - one.measured for one in samples])
    largest = np.nanmax(np.abs(zero_where_never(deviations)), axis=0)
    return {
        "centre": 0.5 * (low + high),
        "half": np.maximum(0.5 * (high - low), 1e-9),
        "limit": _MARGIN * np.maximum(largest, 1e-9),
    }


def zero_where_never(deviations: FloatArray) -> FloatArray:
    """`deviations` (time, ...), 0 for an output of which no sample is known."""
    return np.where(np.isfinite(deviations).any(axis=0), deviations, 0.0)


def _part(model: LagModel, one: LagSamples, input_names: Sequence[str], scored: _Scored) -> _Part:
    full = 2.0 * model.half[scored.core]
    ss = one.ss[:, scored.core]
    rows = np.flatnonzero(moving(ss, full, scored.dt_s, relative=scored.relative))
    begins = np.flatnonzero(np.diff(rows, prepend=-2) > 1)
    deviation = one.ss[rows] - one.measured[rows]
    starts = (begins.astype(np.int64), model.start(np.nan_to_num(deviation[begins])))
    drive = model.drive(one.inputs, input_names, one.ss).rows(rows)
    none = np.empty((0, deviation.shape[1]))
    return _Part(drive, deviation, starts, _weight(model, one, scored)[rows], none)


def moving(ss: FloatArray, full: float, dt_s: float, *, relative: bool = False) -> BoolArray:
    """Rows (time,) in and around the moves of a steady-state value `ss` whose range is `full`."""
    span_s, around_s = _STRETCHES_S[relative]
    around = max(round(around_s / dt_s), 1)
    rows: BoolArray = binary_dilation(_swing(ss, span_s, dt_s) > _MOVING * full, iterations=around)
    return rows


def _weight(model: LagModel, one: LagSamples, scored: _Scored) -> FloatArray:
    """How much errors count (time, n_out): all alike, or the less the more the output swings."""
    if not scored.relative:
        return np.ones_like(one.ss)
    known = np.where(np.isfinite(one.measured), one.measured, one.ss)
    swings = [_swing(column, _SWING_S, scored.dt_s) for column in known.T]
    share = np.stack(swings, axis=1) / (2.0 * model.half)
    weight: FloatArray = _USUAL_SWING / np.maximum(share, _LEAST_SWING)
    return weight


def _swing(values: FloatArray, span_s: float, dt_s: float) -> FloatArray:
    """Largest less smallest value within `span_s` around each sample."""
    size = max(round(span_s / dt_s), 2)
    swing: FloatArray = maximum_filter1d(values, size) - minimum_filter1d(values, size)
    return swing


def _fitted(model: LagModel, task: _Task) -> LagModel:
    """The model with the parameters of one output fitted."""
    free = free_parameters(model, task.column, limited=task.limited)
    begin = model.parameters[task.column, free]
    unit = prior_units(model, task.column, limited=task.limited)[free]
    fans = fans_of(model) if task.limited and task.column == model.core else []
    columns = np.unique([model.core, task.column, *fans[:1]])  # the others do not act on it
    small, column = model.of(columns), int(np.searchsorted(columns, task.column))
    parts = [part.of(columns) for part in task.parts]
    if fans:
        parts = [part.taking(np.flatnonzero(columns != task.column)) for part in parts]
    task = task._replace(parts=parts, column=column)

    def residuals(values: FloatArray) -> FloatArray:
        return _residuals(_with(small, column, free, values), task, (values - begin) / unit)

    most = _EVALUATIONS[task.limited]
    found = least_squares(
        residuals, begin, x_scale="jac", loss="soft_l1", f_scale=_ROBUST, max_nfev=most
    )
    return _with(model, int(columns[column]), free, found.x)


def _with(model: LagModel, column: int, free: BoolArray, values: FloatArray) -> LagModel:
    parameters = model.parameters.copy()
    parameters[column, free] = values
    return replace(model, parameters=parameters)


def _residuals(model: LagModel, task: _Task, moved: FloatArray) -> FloatArray:
    every = max(round(_EVERY_S / task.dt_s), 1)
    errors = []
    for part in task.parts:
        states = model.run(part.drive, part.starts, task.dt_s, part.taken)
        error = states[:, :, task.column].sum(axis=1) - part.deviation[:, task.column]
        weighted = error * part.weight[:, task.column]
        errors.append(np.nan_to_num(weighted[::every]) / task.scale)
    error = np.concatenate(errors)
    prior = _PRIOR * _ROBUST * np.sqrt(len(error) / 1000.0) * moved
    return np.concatenate([error, prior])
