"""Errors of the free run and of the baselines, channel by channel: one log, or many pooled.

Functions take `measured` and `model`, both `(time, channel)`, and an optional `mask` of that shape
or `(time,)`, true where a sample counts; they return `(channel,)`. Samples where either is NaN or
the mask is false are left out of that channel only. A figure that the remaining samples do not
define is NaN.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from eval.judging.free_run import BASELINES, MODEL, NETWORK, ONE_STEP, FreeRun
from narxcal.intervals import LEVEL
from narxcal.support.arrays import BoolArray, FloatArray
from narxcal.support.errors import DataError

# Below this share of the channel's largest magnitude a relative error has no meaning.
_RELATIVE_FLOOR = 0.05
# A variance below this share of the mean square is the rounding of a constant.
_ROUNDING = 1e-24


def counted(
    measured: FloatArray, model: FloatArray, mask: BoolArray | None = None
) -> NDArray[np.intp]:
    """Return how many samples of each channel are scored, `(channel,)`."""
    return np.asarray(_valid(measured, model, mask).sum(axis=0))


def rms(error: FloatArray) -> float:
    """Root mean square of the samples of one error signal that are not NaN."""
    return float(np.sqrt(np.nanmean(error**2)))


def rmse(measured: FloatArray, model: FloatArray, mask: BoolArray | None = None) -> FloatArray:
    """Return the root mean square error, in the channel's unit."""
    valid = _valid(measured, model, mask)
    return np.asarray(np.sqrt(_mean((model - measured) ** 2, valid)))


def nrmse(measured: FloatArray, model: FloatArray, mask: BoolArray | None = None) -> FloatArray:
    """Return the RMSE divided by the standard deviation of the measurement.

    1 is what the measurement's own mean would reach as a model.
    """
    valid = _valid(measured, model, mask)
    error = _mean((model - measured) ** 2, valid)
    swing = _mean((measured - _mean(measured, valid)) ** 2, valid)
    constant = swing <= _ROUNDING * _mean(measured**2, valid)
    return np.sqrt(_ratio(error, np.where(constant, 0.0, swing)))


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
    size = np.where(valid, np.abs(measured), 0.0)
    largest = size.max(axis=0, initial=0.0)
    error = np.where(valid, np.abs(model - measured), 0.0)
    relative = _ratio(error, np.maximum(size, _RELATIVE_FLOOR * largest))
    relative = np.where(valid & (error == 0.0), 0.0, relative)
    worst = np.max(relative, axis=0, where=valid, initial=0.0)
    return np.where(valid.any(axis=0), 100.0 * worst, np.nan)


def _valid(measured: FloatArray, model: FloatArray, mask: BoolArray | None) -> BoolArray:
    if measured.ndim != 2 or measured.shape != model.shape:
        raise DataError(
            f"expected measured and model of one shape (time, channel), got {measured.shape} "
            f"and {model.shape}"
        )
    valid = np.isfinite(measured) & np.isfinite(model)
    if mask is None:
        return valid
    if mask.shape not in (measured.shape, measured.shape[:1]):
        raise DataError(
            f"expected a mask of shape {measured.shape} or {measured.shape[:1]}, got {mask.shape}"
        )
    return valid & (mask if mask.ndim == 2 else mask[:, None])


def _mean(values: FloatArray, valid: BoolArray) -> FloatArray:
    """Mean over time of the valid samples; NaN where there is none."""
    return _ratio(np.where(valid, values, 0.0).sum(axis=0), valid.sum(axis=0).astype(np.float64))


def _ratio(numerator: FloatArray, denominator: FloatArray) -> FloatArray:
    """Divide; NaN where the denominator is zero."""
    return np.divide(
        numerator, denominator, out=np.full_like(denominator, np.nan), where=denominator != 0.0
    )


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
        """Baseline -> its RMSE on the same samples."""
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
    between them. Raises `DataError` without runs, or where they are of different channels.
    """
    if not runs:
        raise DataError("expected at least one log to score, found none")
    channels = runs[0].channels
    for one in runs:
        if one.channels != channels:
            raise DataError(
                f"expected the channels {', '.join(channels)}, found {', '.join(one.channels)}",
                file=one.log.name,
            )
    return {name: _of_channel(runs, k) for k, name in enumerate(channels)}


def _of_channel(runs: Sequence[FreeRun], k: int) -> ChannelScores:
    """Every figure of channel `k`: one at a time, as logs may take much of the memory."""
    measured = np.concatenate([one.log.measured(one.channels[k : k + 1]) for one in runs])
    scored = np.concatenate([one.scored for one in runs])
    static = np.concatenate([one.quasi_steady for one in runs]) & scored
    model = _joined(runs, MODEL, k)
    error = np.where(np.isfinite(model - measured) & scored[:, None], model - measured, np.nan)
    figures: dict[str, FloatArray] = {
        "samples": counted(measured, model, scored).astype(np.float64),
        "rmse": rmse(measured, model, scored),
        "nrmse": nrmse(measured, model, scored),
        "fit_pct": fit_percent(measured, model, scored),
        "max_rel_pct": max_relative_percent(measured, model, scored),
        "max_error": _reduced(np.abs(error), "max"),
        "bias": _reduced(error, "mean"),
        "static_samples": counted(measured, model, static).astype(np.float64),
        "static_rmse": rmse(measured, model, static),
        "static_bias": _reduced(error[static], "mean"),
        "dynamic_rmse": rmse(measured, model, scored & ~static),
    }
    wide = np.concatenate([_column(one, one.half_width, k) for one in runs])
    wide = np.where(np.isfinite(error), wide, np.nan)
    inside = np.where(np.isfinite(wide), np.abs(error) <= wide, np.nan)
    figures |= {"coverage": _reduced(inside, "mean"), "half_width": _reduced(wide, "mean")}
    for name in (ONE_STEP, NETWORK, *BASELINES):
        figures[f"{name}_rmse"] = rmse(measured, _joined(runs, name, k), scored)
    return ChannelScores(**{key: float(values[0]) for key, values in figures.items()})


def _joined(runs: Sequence[FreeRun], name: str, k: int) -> FloatArray:
    """Channel `k` (time, 1) of one model over all logs; NaN for logs it was not run on."""
    return np.concatenate([_column(one, one.outputs.get(name), k) for one in runs])


def _column(run: FreeRun, values: FloatArray | None, k: int) -> FloatArray:
    return np.full((len(run.log), 1), np.nan) if values is None else values[:, k : k + 1]


def _reduced(values: FloatArray, how: str) -> FloatArray:
    """Mean or largest of the finite values (channel,); NaN where there is none."""
    found = [column[np.isfinite(column)] for column in values.T]
    return np.array([getattr(part, how)() if len(part) else np.nan for part in found])
