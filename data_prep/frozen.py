"""Frozen channels: a sensor that repeats one value while the engine goes on living.

Signals and masks are `(time,)`, NaN where nothing was measured.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from data_prep.faults import FaultsConfig, followed, is_sensed, role
from data_prep.log import Log
from data_prep.moves import noise_of
from data_prep.outliers import robust_range

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.intp]

# At most this many freezes are expected in one log; the next longest run is natural.
_FREEZES = 10
_UNNATURAL = 5  # times longer than the longest natural run of equal samples is a freeze
# Noise reverses at least this part of the changes.
_REVERSALS = 0.02
# A witness lives if it changes at least this part as often as in the rest of the log.
_ALIVE = 0.5
# Below this part of its highest value an engine does not run, it is cranked or windmills.
_STANDSTILL = 0.05
# No engine moves one of these a lot and leaves another exactly as it is.
_CORE = ("N1_pct", "N2_pct", "EGT_C", "FF_kgph")


def repeats(values: FloatArray) -> tuple[IntArray, IntArray]:
    """Find the runs of equal samples, starts and (exclusive) stops; NaN is passed over."""
    index = np.flatnonzero(np.isfinite(values))
    if not len(index):
        return np.empty(0, dtype=np.intp), np.empty(0, dtype=np.intp)
    known = values[index]
    step = np.abs(np.diff(known)) > 1e-9 * np.maximum(1.0, np.abs(known[1:]))
    edges = np.flatnonzero(step) + 1
    firsts = np.concatenate(([0], edges))
    lasts = np.concatenate((edges, [len(index)])) - 1
    return index[firsts], index[lasts] + 1


def frozen(log: Log, name: str, config: FaultsConfig) -> BoolArray:
    """Flag samples where an output with live noise repeats one value impossibly long.

    All of these have to hold: it is an output; outside its long runs it has noise (a
    simulation without noise has none and may rest for minutes); the run is longer than
    `frozen_s` and five times its longest natural run; another channel lives on meanwhile;
    and it is not the zero of an engine at standstill. Or: it never changes at all, while
    another core output moves by a fifth. Levers, ambient channels and switches may rest.
    """
    values = log[name]
    mask = np.zeros(len(values), dtype=np.bool_)
    if role(name) != "output":
        return mask
    if _dead(log, name):
        return np.isfinite(values)
    for start, stop in _unnatural(values, config.frozen_s / log.dt_s):
        if _standstill(values, start) or not _witnessed(log, name, start, stop):
            continue
        if abs(values[start]) < 1e-9 and followed(log, name, start, stop):
            continue
        mask[start:stop] = True
    return mask


def _dead(log: Log, name: str) -> bool:
    """Whether a core output keeps one value all along while another one shows real moves."""
    if name not in _CORE or not _constant(log[name]):
        return False
    others = [log[other] for other in _CORE if other != name and other in log.channels]
    return any(np.ptp(robust_range(other)) > 0.2 * abs(robust_range(other)[1]) for other in others)


def _constant(values: FloatArray) -> bool:
    return len(repeats(values)[0]) == 1


def _unnatural(values: FloatArray, least: float) -> list[tuple[int, int]]:
    starts, stops = repeats(values)
    if len(starts) <= _FREEZES:
        return []
    length = stops - starts
    natural = np.partition(length, -_FREEZES - 1)[-_FREEZES - 1]
    longest = max(least, float(_UNNATURAL * natural))
    long = length > longest
    rest = np.ones(len(values), dtype=np.bool_)
    for start, stop in zip(starts[long], stops[long], strict=True):
        rest[start:stop] = False
    if not long.any() or not _noisy(values[rest & np.isfinite(values)]):
        return []
    return list(zip(starts[long].tolist(), stops[long].tolist(), strict=True))


def _noisy(values: FloatArray) -> bool:
    """Whether a channel has live noise: it turns round every so often.

    Measured: 3-70 % of the changes of recorded outputs reverse the one before, even where the
    recorder has smoothed and the reader has interpolated; 1 % of a noise-free simulation's.
    """
    signs = np.sign(np.diff(values))
    signs = signs[signs != 0.0]
    if len(signs) < 2 or noise_of(values) == 0.0:
        return False
    return float(np.mean(signs[1:] != signs[:-1])) >= _REVERSALS


def _standstill(values: FloatArray, start: int) -> bool:
    """Tell an engine that ran down to (nearly) zero from a dropout, which jumps there."""
    low, high = robust_range(values)
    before = values[max(0, start - 8) : start]
    entry = float(np.nanmax(np.abs(before - values[start]), initial=0.0))
    return bool(abs(values[start]) < _STANDSTILL * high) and not entry > 0.05 * (high - low)


def _witnessed(log: Log, name: str, start: int, stop: int) -> bool:
    """Whether another output or ambient channel goes on changing as it always does."""
    others = [other for other in log.channels if other != name and is_sensed(other)]
    if not others:
        return True
    return any(_lives(log[other], start, stop) for other in others)


def _lives(values: FloatArray, start: int, stop: int) -> bool:
    changes = np.diff(values) != 0.0
    known = np.isfinite(values[1:]) & np.isfinite(values[:-1])
    usual = float(np.mean(changes[known])) if known.any() else 0.0
    inside = known[start : stop - 1]
    if usual < 0.1 or not inside.any():
        return False
    return float(np.mean(changes[start : stop - 1][inside])) >= _ALIVE * usual
