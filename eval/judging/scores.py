"""Errors of the free run and of the baselines, channel by channel: one log, or many pooled.

Functions take `measured` and `model`, both `(time, channel)`, and an optional `mask` `(time,)`,
true where a sample counts; they return `(channel,)`. Samples where either is NaN are left out of
that channel only. A figure that the remaining samples do not define is NaN.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from eval.judging.free_run import BASELINES, MODEL, NETWORK, ONE_STEP, FreeRun
from narxcal.intervals import LEVEL
from narxcal.support.arrays import BoolArray, FloatArray
from narxcal.support.errors import DataError

# Below this share of the channel's largest magnitude a relative error has no meaning.
_RELATIVE_FLOOR = 0.05
# A variance below this share of the mean square is the rounding of a constant.
_ROUNDING = 1e-24


def rms(error: FloatArray) -> float:
    """Root mean square of the samples of one error signal that are not NaN; NaN without any."""
    return math.sqrt(_mean(error**2))


def rmse(measured: FloatArray, model: FloatArray, mask: BoolArray | None = None) -> FloatArray:
    errors = np.where(_valid(measured, model, mask), model - measured, np.nan)
    return np.array([rms(column) for column in errors.T])


def nrmse(measured: FloatArray, model: FloatArray, mask: BoolArray | None = None) -> FloatArray:
    """Return the RMSE divided by the standard deviation of the measurement.

    1 is what the measurement's own mean would reach as a model.
    """
    valid = _valid(measured, model, mask)
    found = np.full(measured.shape[1], np.nan)
    for k, rows in enumerate(valid.T):
        known = measured[rows, k]
        if len(known) and known.var() > _ROUNDING * np.mean(known**2):
            found[k] = rms(model[rows, k] - known) / known.std()
    return found


def fit_percent(
    measured: FloatArray, model: FloatArray, mask: BoolArray | None = None
) -> FloatArray:
    """Return `100 (1 - ||measured - model|| / ||measured - mean||)`, as MATLAB's `compare`."""
    return np.asarray(100.0 * (1.0 - nrmse(measured, model, mask)))


def max_relative_percent(
    measured: FloatArray, model: FloatArray, mask: BoolArray | None = None
) -> FloatArray:
    """Return the largest error relative to the measured value at that time, in percent.

    The measured value counts as no less than 5 % of the largest one of its channel, so that a
    stopped engine does not divide by zero and no sample has to be left out.
    """
    valid = _valid(measured, model, mask)
    found = np.full(measured.shape[1], np.nan)
    for k, rows in enumerate(valid.T):
        error, size = np.abs(model[rows, k] - measured[rows, k]), np.abs(measured[rows, k])
        size = np.maximum(size, _RELATIVE_FLOOR * size.max(initial=0.0))
        ratios = np.divide(error, size, out=np.full_like(size, np.nan), where=size > 0.0)
        ratios[error == 0.0] = 0.0
        found[k] = 100.0 * ratios.max() if len(ratios) else np.nan
    return found


def _valid(measured: FloatArray, model: FloatArray, mask: BoolArray | None) -> BoolArray:
    valid = np.isfinite(measured) & np.isfinite(model)
    return valid if mask is None else valid & mask[:, None]


def _mean(values: FloatArray) -> float:
    known = values[np.isfinite(values)]
    return float(known.mean()) if len(known) else math.nan


@dataclass(frozen=True)
class ChannelScores:
    """Figures of one channel in its unit, NaN where the samples do not define one.

    `rmse` is of the free run over all scored samples; `static_rmse` over the quasi-steady ones
    among them, `dynamic_rmse` over the rest. `bias` is the mean error, model minus measured.
    `max_rel_pct` is relative to the measured value at that time (temperatures in degC), which
    counts as no less than 5 % of the largest one; `max_error` is the largest error itself.
    `network_rmse` is that of the network, which differs from `rmse` where a simple model leads.
    `coverage` is the share of samples within the interval of the free run, `half_width` its mean.
    """

    samples: float
    rmse: float
    nrmse: float
    fit_pct: float
    max_rel_pct: float
    max_error: float
    bias: float
    static_samples: float
    static_rmse: float
    static_bias: float
    dynamic_rmse: float
    one_step_rmse: float
    network_rmse: float
    steady_state_rmse: float
    first_order_rmse: float
    arx_rmse: float
    coverage: float
    half_width: float

    @property
    def best_rmse(self) -> float:
        """Lowest RMSE of free run and baselines; NaN where none is defined."""
        known = [self.rmse, *self.baselines.values()]
        return min((value for value in known if math.isfinite(value)), default=math.nan)

    @property
    def baselines(self) -> dict[str, float]:
        return {name: getattr(self, f"{name}_rmse") for name in BASELINES}

    def row(self) -> dict[str, Any]:
        """As a table; NaN where there is no figure, and no interval where the model has none."""
        counts = {"samples": int(self.samples), "static_samples": int(self.static_samples)}
        row: dict[str, Any] = {**asdict(self), **counts}
        share = {key: row.pop(key) for key in ("coverage", "half_width")}
        known = math.isfinite(self.coverage)
        return {**row, "interval": {"level": LEVEL, **share} if known else None}


def score(runs: Sequence[FreeRun]) -> dict[str, ChannelScores]:
    """Score one log, or several as if they were one long recording.

    Of a channel slower than the sampling grid only measured samples count, not those interpolated
    between them. Raises `DataError` without runs.
    """
    if not runs:
        raise DataError("expected at least one log to score, found none")
    return {name: _of_channel(runs, k) for k, name in enumerate(runs[0].channels)}


def _of_channel(runs: Sequence[FreeRun], k: int) -> ChannelScores:
    """Every figure of channel `k`: one at a time, as logs may take much of the memory."""
    measured = np.concatenate([one.log.measured(one.channels[k : k + 1]) for one in runs])
    scored = np.concatenate([one.scored for one in runs])
    static = np.concatenate([one.quasi_steady for one in runs]) & scored

    def model_of(name: str) -> FloatArray:
        return np.concatenate([_column(one, one.outputs.get(name), k) for one in runs])

    model = model_of(MODEL)
    error = np.where(scored[:, None], model - measured, np.nan)
    wide = np.concatenate([_column(one, one.half_width, k) for one in runs])
    wide = np.where(np.isfinite(error), wide, np.nan)
    inside = np.where(np.isfinite(wide), np.abs(error) <= wide, np.nan)
    others = (ONE_STEP, NETWORK, *BASELINES)
    return ChannelScores(
        samples=float(np.isfinite(error).sum()),
        rmse=rms(error),
        nrmse=float(nrmse(measured, model, scored)[0]),
        fit_pct=float(fit_percent(measured, model, scored)[0]),
        max_rel_pct=float(max_relative_percent(measured, model, scored)[0]),
        max_error=float(np.fmax.reduce(np.abs(error), axis=None)),
        bias=_mean(error),
        static_samples=float(np.isfinite(error[static]).sum()),
        static_rmse=rms(error[static]),
        static_bias=_mean(error[static]),
        dynamic_rmse=rms(error[~static]),
        coverage=_mean(inside),
        half_width=_mean(wide),
        **{f"{name}_rmse": float(rmse(measured, model_of(name), scored)[0]) for name in others},
    )


def _column(run: FreeRun, values: FloatArray | None, k: int) -> FloatArray:
    return np.full((len(run.log), 1), np.nan) if values is None else values[:, k : k + 1]
