"""When a response, scaled to run from 0 to 1, crosses a level, read robustly against noise."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
ReadingMode = Literal["interpolated", "nearest"]

HALF = 0.5
LOW, HIGH = 0.1, 0.9
# Wider bands would reach into the settled parts: 0.1 - 0.05 and 0.9 + 0.05 stay clear of 0 and 1.
WIDEST_HYSTERESIS = 0.05


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
