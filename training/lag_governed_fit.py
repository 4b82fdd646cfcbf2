"""Fits the lags of an engine whose control holds N1 (`narxcal.lumped.lag_governed`) in free run.

Output error by least squares with a robust loss, as in `training.lag_fit`, but over whole logs: the
metal's heat and the clearances show long after the lever has come to rest. Core and fan are fitted
together, for the control closes a loop through both, and every other output behind them. Errors
count the more the lower the output, for it is relative ones that are judged. Slopes are forward
sensitivities (`lag_governed_sensitivity`): with some sixty parameters, differences of runs
cost ten times as much.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares

from narxcal.lumped.lag import CASING, Drive
from narxcal.lumped.lag_governed import FITTED, GovernedLags
from narxcal.lumped.lag_governed_steps import LINES, OTHER_LINES, SHARES
from narxcal.narx.network import AT_START
from narxcal.support.arrays import BoolArray, FloatArray, IntArray
from narxcal.support.errors import DataError
from training.lag_fit import LagSamples, output_scales, thinned_for_lags, zero_where_never
from training.lag_priors import free_numbers, governed_start

_ROBUST = 0.1  # of the deviations' spread: errors above this count less than squared
_PRIOR = 1.0  # one unit of a parameter costs as much as this many _ROBUST once per 3000 samples
_EVALUATIONS = 10
_EVERY_S = 0.19  # one sample in this time is scored
_LEVEL = (0.4, 1.0)  # shares of the largest value; below, errors count no more
_LEAST_MOTION = 1e-6  # of the core, scaled


class _Log(NamedTuple):
    """What drives one log, its deviations (T, o), and how much errors count there (T, o)."""

    drive: Drive
    deviation: FloatArray
    weight: FloatArray

    def of(self, columns: IntArray) -> _Log:
        """Some of the outputs."""
        ss, target, per_unit = (np.ascontiguousarray(part[:, columns]) for part in self.drive[:3])
        drive = Drive(ss, target, per_unit, self.drive.air)
        return _Log(drive, self.deviation[:, columns], self.weight[:, columns])


def fit_governed(
    samples: Sequence[LagSamples],
    names: tuple[Sequence[str], tuple[str, ...]],
    dt_s: float,
    threads: int = 1,
) -> GovernedLags:
    """Fit the lags of all outputs; `names` are those of the inputs and of the outputs.

    The numbers do not depend on the `threads` that share the work.

    Raises `ModelError` without the speeds of a fan and a core, `DataError` where nothing moves.
    """
    input_names, output_names = names
    samples, dt_s = thinned_for_lags(samples, dt_s)
    scales = output_scales(samples, input_names)
    model = GovernedLags(output_names=output_names, **governed_start(len(output_names)), **scales)
    logs = _logs(model, samples, input_names)
    _check_motion(logs, model)
    with ThreadPoolExecutor(threads) as pool:  # compiled runs leave Python's lock alone
        for other in (None, *range(2, len(output_names))):
            model = _fitted(model, (logs, dt_s), other, pool)
    return model


def _logs(model: GovernedLags, samples: Sequence[LagSamples], names: Sequence[str]) -> list[_Log]:
    known = [np.where(np.isfinite(one.measured), one.measured, one.ss) for one in samples]
    largest = np.maximum(np.max([np.abs(values).max(axis=0) for values in known], axis=0), 1e-9)
    return [
        _Log(
            drive=model.drive(one.inputs, names, one.ss),
            deviation=one.ss - one.measured,
            weight=1.0 / np.clip(np.abs(values) / largest, *_LEVEL),
        )
        for one, values in zip(samples, known, strict=True)
    ]


def _check_motion(logs: Sequence[_Log], model: GovernedLags) -> None:
    core = np.concatenate([log.drive.target[:, model.order[0]] for log in logs])
    if np.ptp(core) < _LEAST_MOTION:
        raise DataError(
            "the outputs never move, so no lag can be fitted",
            channel=model.output_names[model.order[0]],
            hint="Add logs with lever moves, or set lag = false in [narx]",
        )


def _fitted(
    model: GovernedLags,
    data: tuple[Sequence[_Log], float],
    other: int | None,
    pool: ThreadPoolExecutor,
) -> GovernedLags:
    """The model with core and fan fitted, or one `other` output behind them."""
    logs, dt_s = data
    free = free_numbers(len(model.output_names), other)
    ranks = [0, 1] if other is None else [0, 1, other]
    columns = np.sort(model.order[ranks])  # no other acts on them
    scored = np.searchsorted(columns, model.order[ranks[-1:] if other else ranks])
    begin = np.concatenate([getattr(model, name)[free[name]] for name in FITTED])
    task = _Task([log.of(columns) for log in logs], scored, dt_s, pool)
    own = free_numbers(len(ranks), None if other is None else 2)  # the same of `_of` the model

    def trial(values: FloatArray) -> GovernedLags:
        return _of(_with(model, free, values), ranks, columns)

    def residuals(values: FloatArray) -> FloatArray:
        return task.residuals(trial(values), values - begin)

    def slopes(values: FloatArray) -> FloatArray:
        return task.slopes(trial(values), own)

    found = least_squares(
        residuals,
        begin,
        slopes,
        x_scale="jac",
        loss="soft_l1",
        f_scale=_ROBUST,
        max_nfev=_EVALUATIONS,
    )
    return _with(model, free, found.x)


@dataclass(frozen=True, eq=False)
class _Task:
    """What is fitted to: logs, the columns whose errors count, the raster, and who runs the logs.

    Errors are counted over the deviations' spread.
    """

    logs: Sequence[_Log]
    columns: IntArray
    dt_s: float
    pool: ThreadPoolExecutor

    @cached_property
    def every(self) -> int:
        """Of how many samples one is scored."""
        return max(round(_EVERY_S / self.dt_s), 1)

    @cached_property
    def scored(self) -> list[tuple[FloatArray, FloatArray]]:
        """Deviations (n, c) of each log and what errors count, which is nothing where masked."""
        every, columns = self.every, self.columns
        deviations = [log.deviation[:, columns] for log in self.logs]
        known = zero_where_never(np.concatenate(deviations))
        spread = np.maximum(np.nanstd(known, axis=0), 1e-9)
        weights = [log.weight[:, columns] / spread for log in self.logs]
        return [
            (np.nan_to_num(value[::every]), np.where(np.isfinite(value), weight, 0.0)[::every])
            for value, weight in zip(deviations, weights, strict=True)
        ]

    @cached_property
    def prior(self) -> float:
        """What a parameter counts that has moved by one unit."""
        errors = sum(weight.size for _, weight in self.scored)
        return float(_PRIOR * _ROBUST * np.sqrt(errors / 3000.0))

    def residuals(self, model: GovernedLags, moved: FloatArray) -> FloatArray:
        """Errors of all logs, and how far parameters were `moved`."""
        errors = []
        for states, (known, weight) in zip(self._runs(model), self.scored, strict=True):
            found = states[:: self.every, : CASING + 1].sum(axis=1)[:, self.columns]
            errors.append(((found - known) * weight).ravel())
        return np.concatenate([*errors, self.prior * moved])

    def slopes(self, model: GovernedLags, free: Mapping[str, BoolArray]) -> FloatArray:
        """Slopes of `residuals` by the parameters that are `free`."""

        def of(log: _Log, states: FloatArray) -> FloatArray:
            scored = (self.columns, self.every)
            return model.sensitivities(log.drive, (states, self.dt_s), free, scored)

        found = self.pool.map(of, self.logs, self._runs(model))
        rows = [
            (slopes * weight[:, :, None]).reshape(-1, slopes.shape[2])
            for slopes, (_, weight) in zip(found, self.scored, strict=True)
        ]
        return np.concatenate([*rows, self.prior * np.eye(rows[0].shape[1])])

    def _runs(self, model: GovernedLags) -> Iterator[FloatArray]:
        """States (T, 6, o) of free runs over all logs."""

        def of(log: _Log) -> FloatArray:
            start = model.start(np.nan_to_num(log.deviation[:1]))
            return model.run(log.drive, (AT_START, start), self.dt_s)

        return self.pool.map(of, self.logs)


def _with(model: GovernedLags, free: dict[str, BoolArray], values: FloatArray) -> GovernedLags:
    changed, at = {}, 0
    for name in FITTED:
        size = int(free[name].sum())
        array = getattr(model, name).copy()
        array[free[name]] = values[at : at + size]
        changed[name] = array
        at += size
    return replace(model, **changed)


def _of(model: GovernedLags, ranks: Sequence[int], columns: IntArray) -> GovernedLags:
    """The model of core, fan and the others of `ranks`, which are `columns` of the outputs."""
    others = [rank for rank in ranks if rank > 1]
    first = [len(LINES) + len(OTHER_LINES) * (rank - 2) + k for rank in others for k in (0, 1)]
    behind = [rank - 1 for rank in others]
    shares = [SHARES + rank - 2 for rank in others]
    return GovernedLags(
        output_names=tuple(model.output_names[column] for column in columns),
        lines=model.lines[[*range(len(LINES)), *first]],
        slopes=model.slopes[[0, *behind]],
        heat=model.heat[list(ranks)],
        extra=model.extra[[*range(SHARES), *shares]],
        centre=model.centre[columns],
        half=model.half[columns],
        limit=model.limit[columns],
    )
