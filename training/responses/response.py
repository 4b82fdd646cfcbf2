"""Read one transient from one curve: settled levels, t10, t90, Ti and Tt.

The response is scaled to run from 0 (settled before the lever moves) to 1 (settled afterwards);
t10 and t90 are the times at which it crosses 0.1 and 0.9, read robustly against noise.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from pydantic import Field

from narxcal.support.arrays import FloatArray
from narxcal.support.errors import DataError
from narxcal.support.settings import Section

ReadingMode = Literal["interpolated", "nearest"]

HALF = 0.5
LOW, HIGH = 0.1, 0.9
# Wider bands would reach into the settled parts: 0.1 - 0.05 and 0.9 + 0.05 stay clear of 0 and 1.
WIDEST_HYSTERESIS = 0.05
FEWEST_SETTLED = 3  # samples; a median of two is no protection against an outlier
_SLACK_S = 1e-6  # times on a sampling grid are not exact in binary
_NAN = float("nan")


class Reading(Section):
    """How crossings and settled values are read, whatever the channel.

    The settled values are medians over `before_s` up to the lever movement and over the last
    `after_s`. `nearest` reads the sample next to the crossing, as the paper does, instead of
    interpolating.
    """

    reading: ReadingMode = "interpolated"
    before_s: float = Field(default=1.0, gt=0.0)
    after_s: float = Field(default=1.0, gt=0.0)


class TransientConfig(Reading):
    """How a transient of one channel is read.

    A response below `least_response` (in `unit`) is not assessable, nor is one whose settled parts
    drift by more than `drift_share` of the response between their two halves.
    """

    least_response: float = Field(default=5.0, ge=0.0)
    unit: str = "%"
    drift_share: float = Field(default=0.05, gt=0.0)


@dataclass(frozen=True)
class Transient:
    """One curve's reading; times in seconds on the log's clock, levels in the channel's unit.

    `Ti_s = t10_s - t0_s`; `Tt_s = t90_s - t10_s` (rules that count Tt from the lever add Ti
    back). `dt_s` is the sampling interval, the resolution of a nearest-sample reading. With a
    `reason` the transient is not assessable; what could not be read is NaN.
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
            count = "1 sample" if len(part) == 1 else f"{len(part)} samples"
            return f"only {count} {place}, {FEWEST_SETTLED} are needed"
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


def residual_deviation(values: FloatArray) -> float:
    """Root mean square of `values (time,)` about their straight line: noise without drift."""
    steps = np.arange(len(values)) - (len(values) - 1) / 2
    slope = float(steps @ values) / float(steps @ steps)
    residual = values - values.mean() - slope * steps
    return float(np.sqrt(np.mean(residual**2)))


def drift(values: FloatArray) -> float:
    """Median of the second half minus median of the first half of `values (time,)`."""
    half = (len(values) + 1) // 2
    return float(np.median(values[-half:]) - np.median(values[:half]))


def low_and_high_crossing(
    time_s: FloatArray, share: FloatArray, first: int, noise: float, mode: ReadingMode
) -> tuple[float, float]:
    """Return the times in seconds at which `share (time,)` crosses 10 % and 90 %.

    `first` is the sample of the lever movement; before it the median of `share` is 0, and over
    its end the median is 1, so both crossings exist. The 10 % crossing is the last one before
    the response is half done (a blip that falls back is not the response), the 90 % crossing
    the first one after it (an overshoot or a swing afterwards does not delay it). `noise` is the
    standard deviation of `share` where it is settled.
    """
    hysteresis = min(3.0 * noise, WIDEST_HYSTERESIS)
    half = first + int(np.argmax(share[first:] >= HALF))
    below = int(np.flatnonzero(share[:half] < LOW - hysteresis)[-1])
    above = below + int(np.argmax(share[below:] >= LOW + hysteresis))
    low = _crossing(time_s[below : above + 1], share[below : above + 1] - LOW, mode)
    above = half + int(np.argmax(share[half:] >= HIGH + hysteresis))
    below = int(np.flatnonzero(share[:above] < HIGH - hysteresis)[-1])
    high = _crossing(time_s[below : above + 1], share[below : above + 1] - HIGH, mode)
    return low, high


def _crossing(time_s: FloatArray, excess: FloatArray, mode: ReadingMode) -> float:
    """Middle one of the sign changes of `excess (time,)`, which starts below 0 and ends above.

    Noise turns one crossing into an odd number of them, early and late ones alike; the middle
    one is as often early as late, where the first or the last would be biased.
    """
    positive = excess >= 0.0
    changes = np.flatnonzero(positive[1:] != positive[:-1])
    left = int(changes[len(changes) // 2])
    right = left + 1
    if mode == "nearest":
        return float(time_s[left if abs(excess[left]) < abs(excess[right]) else right])
    weight = excess[left] / (excess[left] - excess[right])
    return float(time_s[left] + weight * (time_s[right] - time_s[left]))
