"""Errors of the free run and of the baselines, channel by channel: one log, or many pooled."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass

import numpy as np

from data_prep.log import FloatArray
from eval import metrics
from eval.runs import BASELINES, MODEL, ONE_STEP, Runs
from narxcal.errors import DataError


@dataclass(frozen=True)
class ChannelScores:
    """Figures of one channel in its unit, NaN where the samples do not define one.

    `rmse` is of the free run over all scored samples; `static_rmse` over the quasi-steady ones
    among them, `dynamic_rmse` over the rest. `bias` is the mean error, model minus measured.
    `max_rel_pct` is relative to the measured value at that time (temperatures in degC), which
    counts as no less than 5 % of the largest one; `max_error` is the largest error itself.
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
    steady_state_rmse: float
    first_order_rmse: float
    arx_rmse: float

    def row(self) -> dict[str, float | int | None]:
        """JSON-able values; None where there is no figure."""
        counts = {"samples": int(self.samples), "static_samples": int(self.static_samples)}
        return {**{name: _known(value) for name, value in asdict(self).items()}, **counts}


def score(runs: Sequence[Runs]) -> dict[str, ChannelScores]:
    """Score one log, or several as if they were one long recording.

    Of a channel slower than the raster the samples that were measured count, not those between.

    Raises `DataError` without runs, or where they are of different channels.
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
    columns = _columns(runs)
    return {
        name: ChannelScores(**{key: float(values[k]) for key, values in columns.items()})
        for k, name in enumerate(channels)
    }


def _columns(runs: Sequence[Runs]) -> Mapping[str, FloatArray]:
    """Every figure as (channel,)."""
    measured = np.concatenate([one.log.measured(one.channels) for one in runs])
    scored = np.concatenate([one.scored for one in runs])
    still = np.concatenate([one.still for one in runs]) & scored
    model = _joined(runs, MODEL)
    wrong = np.where((np.isfinite(model - measured)) & scored[:, None], model - measured, np.nan)
    figures: dict[str, FloatArray] = {
        "samples": metrics.counted(measured, model, scored).astype(np.float64),
        "rmse": metrics.rmse(measured, model, scored),
        "nrmse": metrics.nrmse(measured, model, scored),
        "fit_pct": metrics.fit_percent(measured, model, scored),
        "max_rel_pct": metrics.max_relative_percent(measured, model, scored),
        "max_error": _reduced(np.abs(wrong), "max"),
        "bias": _reduced(wrong, "mean"),
        "static_samples": metrics.counted(measured, model, still).astype(np.float64),
        "static_rmse": metrics.rmse(measured, model, still),
        "static_bias": _reduced(wrong[still], "mean"),
        "dynamic_rmse": metrics.rmse(measured, model, scored & ~still),
    }
    for name in (ONE_STEP, *BASELINES):
        figures[f"{name}_rmse"] = metrics.rmse(measured, _joined(runs, name), scored)
    return figures


def _joined(runs: Sequence[Runs], name: str) -> FloatArray:
    """Outputs of one model over all logs; NaN for logs it was not run on."""
    return np.concatenate(
        [one.outputs.get(name, np.full_like(one.measured, np.nan)) for one in runs]
    )


def _reduced(values: FloatArray, how: str) -> FloatArray:
    """Mean or largest of the finite values (channel,); NaN where there is none."""
    found = [column[np.isfinite(column)] for column in values.T]
    return np.array([getattr(part, how)() if len(part) else np.nan for part in found])


def _known(value: float) -> float | None:
    """JSON has no NaN."""
    return value if math.isfinite(value) else None
