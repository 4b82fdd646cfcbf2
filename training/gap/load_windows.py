"""Windows of a load that was found by its levels: when each began and ended, and its size."""

from __future__ import annotations

import numpy as np

from data_prep.moves import spans
from narxcal.effects.base import FloatArray
from narxcal.effects.steady import FOLLOW_S
from training.gap.finding import Interval
from training.gap.levels import BoolArray, Found, Levels
from training.gap.path_windows import Window
from training.gap.quadratic import Misfit

_NEAR_S, _ROUND_S = 6.0, 15.0  # how far off an edge may be, and what tells where it is
_Z90, _CHI90 = 1.645, 2.71
_MEMORY = 10.0  # blocks after which a level wanders anew
_MOST = 9.0  # variances of a channel: more tells no more


def told(
    found: Found, levels: Levels, measure: Misfit, dt_s: float
) -> tuple[tuple[Window, ...], FloatArray]:
    """Windows of every flight, and `on` (flights, time)."""
    steps, count = measure.gap.shape[1], levels.known.shape[1]
    size = max(1, steps // count)
    rows = np.minimum(np.arange(steps) // size, count - 1)
    # What is left with the load in it, on the raster: less each flight's own nuisances.
    own = levels.residual - found.left - found.on[..., None] * found.shift
    known = measure.weights > 0.0
    gap = np.where(known, measure.gap - own[:, rows], 0.0)
    on, windows = np.zeros((len(gap), steps)), []
    scale = _scale(found, levels)
    for group in levels.groups:
        flights = list(group)
        parts = gap[flights], known[flights]
        for first, stop in spans(found.on[flights[0]]):
            start = _edge(parts, found.shift / scale, scale, (first * size, 1.0, dt_s))
            end = _edge(parts, found.shift / scale, scale, (stop * size, -1.0, dt_s))
            if end[1] <= start[1]:
                continue
            on[flights, start[1] : end[1]] = 1.0
            seconds = [tuple(k * dt_s for k in each) for each in (start, end)]
            for f in flights:
                shift = _sizes(found, levels, (f, first, stop), scale)
                windows.append(_window(f, seconds, shift))
    return tuple(windows), on


def _window(flight: int, seconds: list[tuple[float, ...]], shift: tuple[Interval, ...]) -> Window:
    (begin, start, late), (early, stop, end) = seconds
    return Window(flight, start, stop, shift, 0.0, (begin, late), (early, end))


def _scale(found: Found, levels: Levels) -> FloatArray:
    known = found.left[levels.known]
    return np.asarray(np.maximum(1.4826 * np.median(np.abs(known), axis=0), 1e-9))


def _edge(
    parts: tuple[FloatArray, BoolArray],
    shift: FloatArray,
    scale: FloatArray,
    where: tuple[int, float, float],
) -> tuple[int, int, int]:
    """Earliest, likeliest and latest sample of a change near one, up (1) or down (-1)."""
    (gap, known), (middle, sign, dt_s) = parts, where
    steps = gap.shape[1]
    if middle <= 0 or middle >= steps - 1:
        edge = 0 if middle <= 0 else steps
        return edge, edge, edge
    near, wide = round(_NEAR_S / dt_s), round(_ROUND_S / dt_s)
    low, high = max(0, middle - near - wide), min(steps, middle + near + wide)
    tried = np.arange(max(1, middle - near), min(steps - 1, middle + near) + 1)
    since = (np.arange(low, high)[None] - tried[:, None]) * dt_s
    taken = np.where(since > 0.0, 1.0 - np.exp(-np.maximum(since, 0.0) / FOLLOW_S), 0.0)
    there = taken if sign > 0.0 else 1.0 - taken
    z = gap[:, low:high] / scale
    away = (z[None] - there[:, None, :, None] * shift) ** 2
    cost = (np.minimum(away, _MOST) * known[None, :, low:high]).sum(axis=(1, 2, 3)) * dt_s
    best = int(np.argmin(cost))
    close = np.flatnonzero(cost <= cost[best] + _CHI90)
    return int(tried[close[0]]), int(tried[best]), int(tried[close[-1]])


def _sizes(
    found: Found, levels: Levels, where: tuple[int, int, int], scale: FloatArray
) -> tuple[Interval, ...]:
    """Shift in one window of one flight, with 90 % intervals."""
    f, first, stop = where
    inside = levels.known[f].copy()
    inside[:first], inside[stop:] = False, False
    off = levels.known[f] & ~found.on[f]
    rest = found.left[f]
    more = rest[inside].mean(axis=0) if inside.any() else np.zeros(len(scale))
    heard = [max(1.0, np.count_nonzero(each) / _MEMORY) for each in (inside, off)]
    reach = _Z90 * scale * np.sqrt(sum(1.0 / each for each in heard))
    value = found.shift + more
    return tuple(
        Interval(float(v), float(v - r), float(v + r)) for v, r in zip(value, reach, strict=True)
    )
