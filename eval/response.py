"""Reads one transient off one curve: settled levels, t10, t90, Ti and Tt."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from eval.crossings import ReadingMode, drift, low_and_high_crossing, residual_deviation
from narxcal.errors import DataError
from narxcal.settings import Section

FloatArray = NDArray[np.float64]

FEWEST_SETTLED = 3  # samples; a median of two is no protection against an outlier
_SLACK_S = 1e-6  # times on a raster are not exact in binary
_NAN = float("nan")


class TransientConfig(Section):
    """How a transient is read.

    The settled values are medians over `before_s` up to the lever movement and over the last
    `after_s`. A response below `least_response` (in `unit`) is not assessable, nor is one whose
    settled parts drift by more than `drift_share` of the response between their two halves.
    `nearest` reads the sample next to the crossing, as the paper does, instead of interpolating.
    """

    reading: ReadingMode = "interpolated"
    before_s: float = Field(default=1.0, gt=0.0)
    after_s: float = Field(default=1.0, gt=0.0)
    least_response: float = Field(default=5.0, ge=0.0)
    unit: str = "%"
    drift_share: float = Field(default=0.05, gt=0.0)


@dataclass(frozen=True)
class Transient:
    """One curve's reading; times in seconds on the log's clock, levels in the channel's unit.

    `Ti_s = t10_s - t0_s`; `Tt_s = t90_s - t10_s` (the `icao` rules add Ti back). `dt_s` is the
    sampling interval, the resolution of a nearest-sample reading. With a `reason` the transient
    is not assessable; what could not be read is NaN.
    """

    t0_s: float
    dt_s: float
    t10_s: float = _NAN
    t90_s: float = _NAN
    Ti_s: float = _NAN
    Tt_s: float = _NAN
    before: float = _NAN
    after: float = _NAN
    response: float = _NAN
    reason: str | None = None


def measure_transient(
    time_s: FloatArray, y: FloatArray, t0_s: float, config: TransientConfig
) -> Transient:
    """Read the transient that a lever movement at `t0_s` starts.

    `time_s` and `y`, both `(time,)`, reach from at least `before_s` before the movement to the
    end of the event; earlier samples are ignored. Push and pull are read alike. Raises
    `DataError` when the arrays do not belong together or do not contain `t0_s`.
    """
    _check(time_s, y, t0_s)
    transient = Transient(t0_s, float(np.median(np.diff(time_s))) if len(time_s) > 1 else _NAN)
    window = time_s >= t0_s - config.before_s - _SLACK_S
    time_s, y = time_s[window], y[window]
    start = y[time_s <= t0_s + _SLACK_S]
    end = y[(time_s > t0_s + _SLACK_S) & (time_s >= time_s[-1] - config.after_s - _SLACK_S)]
    reason = _unreadable(y, start, end) or _too_short(time_s[-1] - t0_s, config.after_s)
    if reason is not None:
        return replace(transient, reason=reason)
    transient = _with_levels(transient, start, end)
    reason = _undefined(transient, (start, end), config)
    if reason is not None:
        return replace(transient, reason=reason)
    noise = np.hypot(residual_deviation(start), residual_deviation(end)) / np.sqrt(2.0)
    t10_s, t90_s = low_and_high_crossing(
        time_s,
        (y - transient.before) / transient.response,
        len(start) - 1,
        float(noise) / abs(transient.response),
        config.reading,
    )
    return replace(transient, t10_s=t10_s, t90_s=t90_s, Ti_s=t10_s - t0_s, Tt_s=t90_s - t10_s)


def _check(time_s: FloatArray, y: FloatArray, t0_s: float) -> None:
    if time_s.ndim != 1 or time_s.shape != y.shape:
        raise DataError(
            f"expected time and response of one shape (time,), got {time_s.shape} and {y.shape}"
        )
    if len(time_s) == 0 or not np.all(np.diff(time_s) > 0.0):
        raise DataError("expected at least 1 sample of strictly increasing time")
    if not time_s[0] <= t0_s <= time_s[-1]:
        raise DataError(
            f"the lever moves at {t0_s:g} s, outside the record from {time_s[0]:g} "
            f"to {time_s[-1]:g} s"
        )


def _unreadable(y: FloatArray, start: FloatArray, end: FloatArray) -> str | None:
    """Why the settled values cannot even be formed."""
    missing = int(np.count_nonzero(~np.isfinite(y)))
    if missing:
        return f"{missing} of {len(y)} samples are missing"
    for part, place in ((start, "up to the move"), (end, "at the end")):
        if len(part) < FEWEST_SETTLED:
            noun = "sample" if len(part) == 1 else "samples"
            return f"only {len(part)} {noun} {place}, {FEWEST_SETTLED} are needed"
    return None


def _too_short(length_s: float, after_s: float) -> str | None:
    if length_s >= after_s - _SLACK_S:
        return None
    return f"the event lasts {length_s:.3g} s, less than the settled part's {after_s:.3g} s"


def _with_levels(transient: Transient, start: FloatArray, end: FloatArray) -> Transient:
    before, after = float(np.median(start)), float(np.median(end))
    return replace(transient, before=before, after=after, response=after - before)


def _undefined(
    transient: Transient, settled: tuple[FloatArray, FloatArray], config: TransientConfig
) -> str | None:
    """Why the levels do not make a response to read."""
    size = abs(transient.response)
    if size < config.least_response or size == 0.0:
        return (
            f"response {size:.3g} {config.unit} is below {config.least_response:.3g} {config.unit}"
        )
    for part, place in zip(settled, ("before the move", "at the end"), strict=True):
        moved = abs(drift(part))
        if moved > config.drift_share * size:
            return f"not settled {place}: still moving by {moved:.2g} {config.unit}"
    return None
