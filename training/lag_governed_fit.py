"""Fits the lags of an engine whose control holds N1 (`narxcal.lag_governed`) in free run.

Output error by least squares with a robust loss, as in `training.lag_fit`, but over whole logs: the
metal's heat and the clearances show long after the lever has come to rest. Core and fan are fitted
together, for the control closes a loop through both, and every other output behind them. Errors
count the more the lower the output, for it is relative ones that are judged.

The starting values are those of a fit to virtual flights of seed 100; regressors that are
not named there stay out.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from narxcal.errors import DataError
from narxcal.lag import Drive
from narxcal.lag_governed import GovernedLags, governed_shapes
from narxcal.lag_governed_steps import LINES, OTHER_LINES, REGRESSORS, SHARES
from narxcal.lag_steps import CASING
from training.lag_fit import LagSamples, output_scales, thinned_for_lags

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.int64]
_ROBUST = 0.1  # of the deviations' spread: errors above this count less than squared
_PRIOR = 1.0  # one unit of a parameter costs as much as this many _ROBUST once per 3000 samples
_EVALUATIONS = 10
_EVERY_S = 0.19  # one sample in this time is scored
_LEVEL = (0.4, 1.0)  # shares of the largest value; below, errors count no more
_LEAST_MOTION = 1e-6  # of the core, scaled
_FITTED = ("lines", "slopes", "heat", "extra")

_START_LINES = {
    "core_s": {"one": -1.13, "thin": 0.53, "Mach": 0.24, "v": -0.03, "u": -0.33, "vv": 0.4},
    "gain": {"one": 0.51, "thin": 0.04, "v": -0.67, "u": 0.45, "uu": 0.27},
    "reset_s": {"one": 0.26, "thin": 0.75, "Mach": -0.37, "v": -0.58, "u": 0.2},
    "lead_s": {"one": -0.7, "thin": 0.61, "u": 0.37},
    "up": {"one": 0.39, "thin": -1.17, "hot": -1.14, "Mach": 0.15, "v": -0.66, "u": 0.93,
           "vv": -0.41, "vu": 0.41, "uu": -0.32},
    "down": {"one": 0.29, "thin": -0.82, "hot": 0.12, "Mach": -0.17, "v": 1.48, "u": -0.21,
             "vv": -0.55, "vu": 1.46, "uu": -0.97},
    "fan_s": {"one": 0.24, "thin": 0.92, "hot": -0.17, "Mach": -0.61, "v": -0.23, "vv": -0.26,
              "vu": 0.75, "uu": -0.41},
    "push": {"one": -1.88, "thin": 1.17, "hot": 0.14, "Mach": -1.17, "v": -0.13, "vv": 1.11},
}  # fmt: skip
_START_OTHER = {
    "probe_s": {"one": 0.1, "thin": 0.65, "hot": -0.58, "Mach": 0.1, "v": 0.22, "u": -0.33,
                "vv": 0.31},
    "push": {"one": -0.49, "thin": 0.94, "hot": -0.73, "Mach": 0.25, "v": 0.67, "u": -0.88,
             "vv": 0.58},
}  # fmt: skip
_START_SLOPES = ((0.96, 0.0, -0.55, 0.17, 0.07, 0.0), (0.79, 0.0, 0.5, 0.37, -0.3, 0.04))
_START_HEAT = (
    (0.0, 2.85, -0.5, 0.8, 0.05, 2.5),  # of the core
    (0.0, 2.85, -0.5, 0.8, 0.0, 2.5),  # of the fan, which the control holds
    (0.0, 2.85, -0.5, 0.8, -0.07, 2.6),  # of others
)
_FITTED_HEAT = [0, 4, 5]  # the times that metal takes to heat up are not
_START_VALVE_S, _START_CLEARANCE, _START_SHARE = 0.3, 0.2, -0.2


_Arrays = dict[str, FloatArray]


@dataclass(frozen=True, eq=False)
class _Logs:
    """All logs end to end: what drives them, their deviations (T, o), and where each begins."""

    drive: Drive
    deviation: FloatArray
    weight: FloatArray
    begins: IntArray
    dt_s: float

    def of(self, columns: IntArray) -> _Logs:
        """Some of the outputs."""
        ss, target, per_unit = (np.ascontiguousarray(part[:, columns]) for part in self.drive[:3])
        drive = Drive(ss, target, per_unit, self.drive.air)
        deviation, weight = self.deviation[:, columns], self.weight[:, columns]
        return _Logs(drive, deviation, weight, self.begins, self.dt_s)


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
    logs = _joined(model, samples, input_names, dt_s)
    _check_motion(logs, model)
    for other in (None, *range(2, len(output_names))):
        model = _fitted(model, logs, other, threads)
    return model


def governed_start(count: int) -> _Arrays:
    """Lines, slopes, heat and extra of `count` outputs that a fit starts from."""
    others = count - 2
    lines = [_row(_START_LINES[name]) for name in LINES]
    lines += [_row(_START_OTHER[name]) for _ in range(others) for name in OTHER_LINES]
    core, fan, other = _START_HEAT
    return {
        "lines": np.array(lines),
        "slopes": np.array([_START_SLOPES[0], *[_START_SLOPES[1]] * others]),
        "heat": np.array([core, fan, *[other] * others]),
        "extra": np.array([_START_VALVE_S, _START_CLEARANCE, *[_START_SHARE] * others]),
    }


def _row(named: dict[str, float]) -> list[float]:
    return [named.get(name, 0.0) for name in REGRESSORS]


def _free(count: int, other: int | None) -> dict[str, BoolArray]:
    """Which numbers are fitted: those of core and fan, or those of one `other` output."""
    free = {name: np.zeros(governed_shapes(count)[name], dtype=bool) for name in _FITTED}
    if other is None:
        named = [[name in _START_LINES[line] for name in REGRESSORS] for line in LINES]
        free["lines"][: len(LINES)] = named
        free["slopes"][0] = free["heat"][0, _FITTED_HEAT] = free["extra"][:SHARES] = True
        return free
    first = len(LINES) + len(OTHER_LINES) * (other - 2)
    for k, line in enumerate(OTHER_LINES):
        free["lines"][first + k] = [name in _START_OTHER[line] for name in REGRESSORS]
    free["slopes"][other - 1] = free["heat"][other, _FITTED_HEAT] = True
    free["extra"][SHARES + other - 2] = True
    return free


def _joined(
    model: GovernedLags, samples: Sequence[LagSamples], names: Sequence[str], dt_s: float
) -> _Logs:
    inputs, ss, measured = (
        np.concatenate([getattr(one, part) for one in samples])
        for part in ("inputs", "ss", "measured")
    )
    known = np.abs(np.where(np.isfinite(measured), measured, ss))
    share = known / np.maximum(known.max(axis=0), 1e-9)
    lengths = [len(one.ss) for one in samples[:-1]]
    return _Logs(
        drive=model.drive(inputs, names, ss),
        deviation=ss - measured,
        weight=1.0 / np.clip(share, *_LEVEL),
        begins=np.cumsum([0, *lengths]).astype(np.int64),
        dt_s=dt_s,
    )


def _check_motion(logs: _Logs, model: GovernedLags) -> None:
    core = logs.drive.target[:, model.order[0]]
    if np.ptp(core) < _LEAST_MOTION:
        raise DataError(
            "the outputs never move, so no lag can be fitted",
            channel=model.output_names[model.order[0]],
            hint="Add logs with lever moves, or set lag = false in [narx]",
        )


def _fitted(model: GovernedLags, logs: _Logs, other: int | None, threads: int) -> GovernedLags:
    """The model with core and fan fitted, or one `other` output behind them."""
    count = len(model.output_names)
    free = _free(count, other)
    ranks = [0, 1] if other is None else [0, 1, other]
    columns = np.sort(model.order[ranks])  # no other acts on them
    part = logs.of(columns)
    scored = [0, 1] if other is None else [2]
    kept = {name: getattr(model, name) for name in _FITTED}
    begin = np.concatenate([kept[name][free[name]] for name in _FITTED])
    task = _Task(part, np.searchsorted(columns, model.order[ranks])[scored])

    def residuals(values: FloatArray) -> FloatArray:
        trial = _of(_with(model, free, values), ranks, columns)
        return task.residuals(trial, values - begin)

    with ThreadPoolExecutor(threads) as pool:  # the compiled run leaves Python's lock alone
        found = least_squares(
            residuals,
            begin,
            x_scale="jac",
            loss="soft_l1",
            f_scale=_ROBUST,
            max_nfev=_EVALUATIONS,
            workers=pool.map,
        )
    return _with(model, free, found.x)


@dataclass(frozen=True, eq=False)
class _Task:
    """What is fitted to: logs and the columns whose errors count."""

    logs: _Logs
    columns: IntArray

    def residuals(self, model: GovernedLags, moved: FloatArray) -> FloatArray:
        """Errors over the deviations' spread, and how far parameters were `moved`."""
        logs, every = self.logs, max(round(_EVERY_S / self.logs.dt_s), 1)
        deviation = logs.deviation[:, self.columns]
        start = model.start(np.nan_to_num(logs.deviation[logs.begins]))
        states = model.run(logs.drive, (logs.begins, start), logs.dt_s)
        error = states[:, : CASING + 1].sum(axis=1)[:, self.columns] - deviation
        spread = np.maximum(np.nanstd(deviation, axis=0), 1e-9)
        error = np.nan_to_num(error * logs.weight[:, self.columns] / spread)[::every].ravel()
        prior = _PRIOR * _ROBUST * np.sqrt(len(error) / 3000.0) * moved
        return np.concatenate([error, prior])


def _with(model: GovernedLags, free: dict[str, BoolArray], values: FloatArray) -> GovernedLags:
    changed, at = {}, 0
    for name in _FITTED:
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
