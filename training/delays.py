"""Delays between signals, by the cross-correlation of their rates of change."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import combinations

import numpy as np

from narxcal.support.arrays import FloatArray, bridge_gaps, known_mean

DELAY_STEP_S, _LONGEST_DELAY_S = 0.2, 12.0
DELAY_PRIOR_S = 0.15  # scatter between logs, until they say more
_LEAST_CORRELATION = 0.3


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
    rates = [_rates(block_means(each[:count], size), size * dt_s) for each in (a, b)]
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


def delay_table(
    found: Sequence[Mapping[tuple[str, str], float]], names: Sequence[str], prior_logs: float
) -> dict[str, dict[str, tuple[float, float]]]:
    """Target -> source -> mean and standard deviation over logs and as many of the prior."""
    table: dict[str, dict[str, tuple[float, float]]] = {name: {} for name in names}
    for i in names:
        for j in names:
            seen = np.array([one[i, j] for one in found if (i, j) in one])
            if len(seen):
                square = prior_logs * DELAY_PRIOR_S**2 + np.sum((seen - seen.mean()) ** 2)
                spread = np.sqrt(square / (prior_logs + len(seen) - 1))
                table[i][j] = (float(seen.mean()), float(spread))
    return table


def block_means(values: FloatArray, size: int) -> FloatArray:
    """Means (blocks,) of the finite samples of each `size`; NaN where there are none."""
    return known_mean(values.reshape(-1, size), axis=1)
