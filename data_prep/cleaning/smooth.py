"""Moving average of 2n + 1 samples, its frequency response, and the comparison of windows."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Annotated, Literal

import numpy as np
import pandas as pd
from pydantic import Field, field_validator

from data_prep.log import Log
from narxcal.channels import described
from narxcal.support.arrays import FloatArray
from narxcal.support.errors import ConfigError
from narxcal.support.settings import Section

# A lever is a command: smoothing would move the start of a slam to an earlier sample.
_SMOOTHED_ROLES = frozenset({"ambient", "output", "auxiliary"})
# Ti of a fast movement is a few tenths of a second; the paper's 11 samples at 32 Hz last 0.34 s.
_USUAL_S, _LONGEST_S = 0.35, 0.5
_MOST = 10_001  # samples; ten seconds of the fastest grid


class SmoothConfig(Section):
    """TOML table `[smooth]`: the window, an odd number of samples (1 leaves the log as it is).

    "auto" is 0.35 s at the rate of the log: 11 samples at 32 Hz, 3 at 10 Hz, 1 below 9 Hz.

    channels: what to smooth; absent, every output and ambient channel. Levers are left alone
    unless named here, switches always.
    """

    window: Annotated[int, Field(ge=1, le=_MOST)] | Literal["auto"] = "auto"
    channels: tuple[str, ...] | None = None

    @field_validator("window")
    @classmethod
    def _odd(cls, window: int | Literal["auto"]) -> int | Literal["auto"]:
        if window != "auto" and window % 2 == 0:
            raise ValueError("a centred window is an odd number of samples")
        return window

    def window_at(self, interval_s: float) -> int:
        return _usual(interval_s) if self.window == "auto" else self.window


def _usual(interval_s: float) -> int:
    fitting = int(_USUAL_S / interval_s + 1e-9)
    return max(1, fitting - 1 + fitting % 2)


def blurs(config: SmoothConfig, interval_s: float) -> str:
    """Warn of a window that blurs fast movements of a log of this interval; empty for others."""
    window = config.window_at(interval_s)
    if window == 1 or config.window == "auto" or window * interval_s <= _LONGEST_S:
        return ""
    return (
        f"[smooth] window = {window} lasts {window * interval_s:.2g} s at "
        f"{1.0 / interval_s:.3g} Hz, which blurs fast movements: take {_usual(interval_s)}"
    )


def smooth(log: Log, config: SmoothConfig | None = None) -> Log:
    """Smooth a cleaned log; a masked sample stays masked and takes part in no average.

    `noise` of the result is what was removed.
    """
    config = config or SmoothConfig()
    names = _names(log, config.channels)
    window = config.window_at(log.dt_s)
    averaged = {name: moving_average(log[name], window) for name in names}
    noise = {name: white_noise(log[name], averaged[name], (window, log.dt_s)) for name in names}
    return replace(log.with_channels(averaged), noise=noise)


def white_noise(raw: FloatArray, averaged: FloatArray, over: tuple[int, float]) -> float:
    """Estimate the variance of the white noise on `raw` `(time,)` from its moving average.

    `over` is the window and the sampling interval in s. An average of n samples removes 1 - 1/n of
    the variance; where the channel moves it removes signal as well, so that the half that moves
    least is used. Zero where nothing is averaged or nothing known.
    """
    window, dt_s = over
    pace = _pace(raw, max(_quarter_second(dt_s), window // 2 + 1))
    full = _sliding(np.isfinite(raw).astype(np.float64), np.ones(window)) == window
    known = np.isfinite(pace) & full
    if window == 1 or not known.any():
        return 0.0
    error = (raw - averaged)[known & (pace <= np.median(pace[known]))]
    return float(np.mean(error**2)) / (1.0 - 1.0 / window)


def _names(log: Log, wanted: Sequence[str] | None) -> list[str]:
    if wanted is None:
        return [name for name in log.channels if described(name).role in _SMOOTHED_ROLES]
    for name in wanted:
        if described(name).role == "switch":
            raise ConfigError(
                f"'{name}' is a switch and cannot be smoothed",
                hint="Remove it from channels in [smooth]",
            )
    return list(wanted)


def moving_average(values: FloatArray, window: int) -> FloatArray:
    """Centred moving average `(time,)` -> `(time,)`, calibration paper equation (5).

    Where the window is cut off by an end of the log or holds missing samples, the average
    would lean to one side; there the value at the centre of the straight line fitted to what
    the window holds is taken, which over a full window *is* the average. So a ramp passes
    unchanged everywhere: no phase shift. Missing samples stay missing.
    """
    known = np.isfinite(values)
    if window == 1 or not known.any():
        return values.copy()
    # Sums over deviations from the mean, which keeps them small and so exact.
    centre = float(values[known].mean())
    deviation = np.where(known, values - centre, 0.0)
    offset = np.arange(window, dtype=np.float64) - window // 2
    weight = known.astype(np.float64)
    s0, s1, s2 = (_sliding(weight, offset**power) for power in range(3))
    y0, y1 = (_sliding(deviation, offset**power) for power in range(2))
    spread = s0 * s2 - s1 * s1
    full = s0 == window
    lone = ~full & (spread < 0.5)
    line = (s2 * y0 - s1 * y1) / np.where(lone | full, 1.0, spread)
    smoothed = np.where(full, y0 / window, line) + centre
    return np.where(lone | ~known, values, smoothed)


def _sliding(values: FloatArray, weights: FloatArray) -> FloatArray:
    """Weighted sum over a centred window; nothing lies beyond the ends."""
    half = len(weights) // 2
    padded = np.concatenate((np.zeros(half), values, np.zeros(half)))
    return np.correlate(padded, weights, mode="valid")


def frequency_response(window: int, frequency_hz: FloatArray, dt_s: float) -> FloatArray:
    """Gain of the moving average: the Dirichlet kernel sin(pi f M T) / (M sin(pi f T)).

    It is real (zero phase) and negative in every second side lobe. Source: Oppenheim and
    Schafer, Discrete-Time Signal Processing, section 2.6.
    """
    angle = np.pi * np.asarray(frequency_hz, dtype=np.float64) * dt_s
    base = np.sin(angle)
    whole = np.abs(base) < 1e-12
    ratio = np.sin(window * angle) / (window * np.where(whole, 1.0, base))
    # At a whole multiple of the sampling rate an odd window passes everything.
    return np.where(whole, 1.0, ratio)


def cutoff_hz(window: int, dt_s: float) -> float:
    """Frequency at which the gain has fallen to 1 / sqrt(2), infinite for a window of one."""
    if window == 1:
        return float("inf")
    frequency = np.linspace(0.0, 1.0 / (window * dt_s), 2001)
    gain = frequency_response(window, frequency, dt_s)
    return float(np.interp(-np.sqrt(0.5), -gain, frequency))


def compare_windows(
    log: Log, channels: Sequence[str], windows: Sequence[int] = (3, 11, 21)
) -> pd.DataFrame:
    """Compare windows by RMS error and frequency response, as the calibration paper does.

    One row per channel and window: `rms` of raw minus smoothed, in the channel's unit, over
    the whole log; `rms_moving` over the twentieth of the samples that move fastest, where
    what exceeds `rms_rest` (the half that moves least: noise removed) is signal lost;
    `noise_gain` 1/sqrt(window), what the average leaves of white noise; `cutoff_hz` where
    the gain is 1/sqrt(2), and `gain_1_hz`. Samples that are missing count nowhere.
    """
    for window in windows:
        SmoothConfig.parse({"window": window})
    rows = [
        {"channel": name, **judged}
        for name in channels
        for judged in _judged(log[name], windows, log.dt_s)
    ]
    return pd.DataFrame(rows)


def _judged(raw: FloatArray, windows: Sequence[int], dt_s: float) -> Iterator[dict[str, float]]:
    pace = _pace(raw, _quarter_second(dt_s))
    known = np.isfinite(pace)
    low, high = np.percentile(pace[known], (50, 95)) if known.any() else (np.nan, np.nan)
    resting, moving = known & (pace <= low), known & (pace >= high)
    for window in windows:
        error = raw - moving_average(raw, window)
        yield {
            "window": window,
            "window_s": window * dt_s,
            "rms": _rms(error),
            "rms_rest": _rms(error[resting]),
            "rms_moving": _rms(error[moving]),
            "noise_gain": float(window**-0.5),
            "cutoff_hz": cutoff_hz(window, dt_s),
            "gain_1_hz": float(frequency_response(window, np.array([1.0]), dt_s)[0]),
        }


def _quarter_second(dt_s: float) -> int:
    """In samples: the same yardstick for every window."""
    return max(1, round(0.25 / dt_s))


def _pace(raw: FloatArray, span: int) -> FloatArray:
    """How far `raw` `(time,)` moves from `span` samples before each to as many after it.

    NaN at the ends and next to missing samples.
    """
    padded = np.concatenate((np.full(span, np.nan), raw, np.full(span, np.nan)))
    moved: FloatArray = np.abs(padded[2 * span :] - padded[: -2 * span])
    return moved


def _rms(error: FloatArray) -> float:
    known = error[np.isfinite(error)]
    return float(np.sqrt(np.mean(known**2))) if len(known) else float("nan")
