"""Level and lag of a free run over a whole log, and what held-out logs allow of them; delays.

    level = median(model - measured),   lag = delay at which their rates of change are most alike

With x_1 .. x_n of held-out training logs, an x of another log is beyond their spread where

    |x| > t(1 - 0.05 / 2 m, p + n - 1) s,   s^2 = (p s_0^2 + sum x_i^2) / (p + n)

for m outputs (Bonferroni), with the scatter s_0 that engines of one type and their meters have,
which counts as p logs. Of fewer than three logs nothing is judged.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import combinations
from typing import Any

import numpy as np
from scipy.stats import t as student

from narxcal.atmosphere import KELVIN
from narxcal.calibration.run_record import MixtureChannel
from narxcal.channels import described
from narxcal.support.arrays import FloatArray, bridge_gaps, known_mean

LEAST_LOGS = 3
# Scatter between engines of a type and their meters, as a share of the level, until left-out logs
# say more; it counts as `PRIOR_LOGS` of them.
_PRIOR = {"%": 0.01, "degC": 0.024, "kg/h": 0.03}
_PRIOR_OTHER, PRIOR_LOGS = 0.03, 1.5
DELAY_STEP_S, _LONGEST_DELAY_S = 0.2, 12.0
_DELAY_PRIOR_S = 0.15  # scatter between logs, until they say more
_LEAST_CORRELATION = 0.3
_FALSE_ALARMS = 0.05  # of one log in any output, as that of the faults that are masked


def level_of(model: FloatArray, measured: FloatArray) -> FloatArray:
    """Median error (n_out,) of a free run (time, n_out); NaN without a measured sample."""
    error = model - measured
    found = [each[np.isfinite(each)] for each in error.T]
    return np.array([np.median(each) if len(each) else np.nan for each in found])


def lag_of(model: FloatArray, measured: FloatArray, dt_s: float) -> FloatArray:
    """Delay (n_out,) of a free run (time, n_out) behind the measurement in s; NaN if unclear."""
    pairs = zip(model.T, measured.T, strict=True)
    return np.array([delay_of(ours, theirs, dt_s) for ours, theirs in pairs])


@dataclass(frozen=True)
class LevelCheck:
    """Level and lag of one output over one log; `allowed` are None with too few held-out logs."""

    channel: str
    error: float
    allowed: float | None
    lag_s: float
    allowed_lag_s: float | None
    held_out_logs: int

    @property
    def open(self) -> bool:
        """Whether the level is known, and too few logs were held out to judge it."""
        return self.allowed is None and bool(np.isfinite(self.error))

    @property
    def ok(self) -> bool | None:
        """Whether the level is within the spread; None where that is not known."""
        if self.allowed is None or not np.isfinite(self.error):
            return None
        return bool(abs(self.error) <= self.allowed)

    @property
    def late(self) -> bool:
        return self.allowed_lag_s is not None and abs(self.lag_s) > self.allowed_lag_s

    def row(self) -> dict[str, Any]:
        return {**asdict(self), "ok": self.ok}


def checks(
    stored: Mapping[str, MixtureChannel],
    names: Sequence[str],
    signals: tuple[FloatArray, FloatArray],
    dt_s: float,
) -> tuple[LevelCheck, ...]:
    """Check a free run and the measurement (time, n_out) of the outputs `names`.

    `stored` is what training kept, by channel.
    """  # fmt: skip
    model, measured = signals
    levels, lags = level_of(model, measured).tolist(), lag_of(model, measured, dt_s).tolist()
    found = []
    for name, error, lag_s, values in zip(names, levels, lags, measured.T, strict=True):
        own = stored.get(name, MixtureChannel())
        held_levels, held_lags = (
            np.array([x for x in each if x is not None], dtype=np.float64)
            for each in (own.held_out_level, own.held_out_lag_s)
        )
        typical = float(np.nanmedian(np.abs(values))) if np.isfinite(values).any() else 0.0
        allowed = _allowed(held_levels, prior_scatter(name, typical), len(names))
        allowed_lag_s = _allowed(held_lags, _DELAY_PRIOR_S, len(names))
        found.append(LevelCheck(name, error, allowed, lag_s, allowed_lag_s, len(held_levels)))
    return tuple(found)


def _allowed(seen: FloatArray, prior: float, outputs: int) -> float | None:
    """Largest size of another one within the spread; None of too few."""
    if len(seen) < LEAST_LOGS:
        return None
    square = (PRIOR_LOGS * prior**2 + np.sum(seen**2)) / (PRIOR_LOGS + len(seen))
    tail = float(student.isf(0.5 * _FALSE_ALARMS / outputs, PRIOR_LOGS + len(seen) - 1.0))
    return tail * float(np.sqrt(square))


def words(check: LevelCheck) -> str:
    return f"{check.channel} {check.error:+.3g} {described(check.channel).unit}"


def prior_share(name: str) -> float:
    """Scatter of a channel between engines of a type and their meters, as a share of the level."""
    return _PRIOR.get(described(name).unit, _PRIOR_OTHER)


def prior_scatter(name: str, level: float) -> float:
    """The same at a level, in its unit."""
    warm = described(name).unit == "degC"
    return prior_share(name) * (level + (KELVIN if warm else 0.0))


def delays_between(values: Mapping[str, FloatArray], step_s: float) -> dict[tuple[str, str], float]:
    """Delay in s of channel i behind channel j, where their rates of change are correlated.

    The largest value of the cross-correlation of the rates over 1 s, interpolated by a parabola.
    """
    rates = {name: _rates(each, step_s) for name, each in values.items()}
    found = {}
    for i, j in combinations(values, 2):
        delay_s = _delay(rates[i], rates[j], step_s)
        if np.isfinite(delay_s):
            found[i, j], found[j, i] = delay_s, -delay_s
    return found


def delay_of(a: FloatArray, b: FloatArray, dt_s: float) -> float:
    """Delay of signal `a` (time,) behind `b` in s; NaN where they are not correlated."""
    size = max(1, round(DELAY_STEP_S / dt_s))
    count = len(a) // size * size
    means = [known_mean(each[:count].reshape(-1, size), axis=1) for each in (a, b)]
    rates = [_rates(each, size * dt_s) for each in means]
    return _delay(rates[0], rates[1], size * dt_s)


def _rates(values: FloatArray, step_s: float) -> FloatArray | None:
    """Changes over 1 s, each over their standard deviation; None where nothing changes."""
    width = max(1, round(1.0 / step_s))
    values = bridge_gaps(values)
    change = values[width:] - values[:-width]
    spread = float(np.std(change)) if np.isfinite(change).all() and len(change) else 0.0
    return np.clip(change / spread, -8.0, 8.0) if spread > 0.0 else None


def _delay(a: FloatArray | None, b: FloatArray | None, step_s: float) -> float:
    reach = round(_LONGEST_DELAY_S / step_s)
    if a is None or b is None or len(a) < 4 * reach:
        return float("nan")
    delay, peak = _peak(a, b, reach)
    return delay * step_s if peak > _LEAST_CORRELATION else float("nan")


def _peak(a: FloatArray, b: FloatArray, reach: int) -> tuple[float, float]:
    """Where the correlation of a(t) with b(t - delay) is largest, in samples, and its value."""
    size = 1 << (len(a) + reach).bit_length()
    product = np.fft.rfft(a, size) * np.conj(np.fft.rfft(b, size))
    whole = np.fft.irfft(product, size)
    near = np.concatenate([whole[-reach:], whole[: reach + 1]])
    near /= np.sqrt(np.sum(a**2) * np.sum(b**2))
    best = int(np.argmax(near))
    if not 0 < best < 2 * reach:
        return float(best - reach), 0.0
    left, top, right = near[best - 1 : best + 2]
    bend = left - 2.0 * top + right
    return best - reach + (0.5 * (left - right) / bend if bend < 0.0 else 0.0), float(top)
