"""Find lasting sensor faults: a channel is frozen, out of range, spikes, or jumps away and back.

Signals and masks are `(time,)`, NaN where nothing was measured.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from data_prep.log import Log
from narxcal.channels import CHANNELS, SPOOLS
from narxcal.support.arrays import BoolArray, FloatArray, noise_level, robust_range, runs
from narxcal.support.settings import Section

Reason = Literal["frozen", "spiking", "out of range"]

# Slack on the physical limits, in parts of their distance: an air-data computer on
# the ground shows Mach -4e-6.
_SLACK = 0.005
# A jump is faster than this many ranges of the channel per second (the quickest measured:
# 0.75, fuel flow of a geared turbofan at a slam) ...
_JUMP_RATE = 1.5
# ... and exceeds the channel's noise and resolution. A log at steady cruise has next to no
# range; this part of the level replaces it.
_JUMP_NOISE = 12.0
_JUMP_STEPS = 4.0
_LEAST_RANGE = 0.25
# After an excursion the channel is back where it was, to this part of the larger jump; the
# engine may have accelerated meanwhile.
_RETURN = 0.5
# Spools and hot metal cannot jump, whatever the fuel does.
_INERTIAL = frozenset({"N1_pct", "N2_pct", "EGT_C"})


class FaultsConfig(Section):
    """Nested table `[clean.faults]`.

    frozen_s: an output that repeats one value for longer may be frozen (see `data_prep.faults`).
    excursion_s: longest dropout or plateau between two opposite jumps.
    burst_s, burst_count: so many spikes within this time mask the channel as spiking.
    """

    frozen_s: float = Field(default=2.0, gt=0)
    excursion_s: float = Field(default=60.0, gt=0)
    burst_s: float = Field(default=2.0, gt=0)
    burst_count: int = Field(default=4, ge=2)


def resolution(values: FloatArray) -> float:
    """Estimate the step of a quantised channel: small among the changes that happen at all."""
    steps = np.abs(np.diff(values))
    steps = steps[steps > 0.0]
    return float(np.percentile(steps, 5)) if len(steps) else 0.0


def role(name: str) -> str:
    """Look up the role of a channel; one outside the canonical table is an output."""
    return CHANNELS[name].role if name in CHANNELS else "output"


def is_sensed(name: str) -> bool:
    """Whether a channel is a physical quantity that cannot jump, unlike levers and switches."""
    return role(name) in {"output", "ambient", "auxiliary"}


def out_of_range(name: str, values: FloatArray) -> BoolArray:
    """Flag samples that no turbofan and no atmosphere can show."""
    if name not in CHANNELS:
        return np.isinf(values)
    low, high = CHANNELS[name].low, CHANNELS[name].high
    slack = _SLACK * (high - low)
    return (values < low - slack) | (values > high + slack)


def jumps(log: Log, name: str) -> tuple[NDArray[np.intp], NDArray[np.intp], FloatArray]:
    """Find the jumps no engine can make, faster than its own range in two thirds of a second.

    Returns first and last samples and signed heights; successive steps of one sign are one.
    """
    values = log[name]
    step = np.diff(values)
    low, high = robust_range(values)
    known = np.abs(values[np.isfinite(values)])
    scale = max(high - low, _LEAST_RANGE * float(np.median(known))) if len(known) else 0.0
    quiet = max(_JUMP_NOISE * noise_level(values), _JUMP_STEPS * resolution(values))
    least = max(_JUMP_RATE * scale * log.dt_s, quiet)
    found = [runs(sign * step > least) for sign in (1, -1)]
    starts = np.concatenate([start for start, _ in found])
    stops = np.concatenate([stop for _, stop in found])
    order = np.argsort(starts)
    starts, stops = starts[order], stops[order]
    return starts, stops, values[stops] - values[starts]


def excursions(log: Log, name: str, config: FaultsConfig) -> list[tuple[int, int]]:
    """Find where a channel jumps away and back: dropouts to zero, plateaus, single spikes.

    Fuel flow, thrust and pressure ratios can be cut for real: then the spools follow.
    """
    if not is_sensed(name):
        return []
    starts, stops, change = jumps(log, name)
    found, first = [], 0
    while first + 1 < len(starts):
        there, back = change[first], change[first + 1]
        height = max(abs(there), abs(back))
        start, stop = int(starts[first]) + 1, int(stops[first + 1])
        returned = abs(there + back) <= _RETURN * height
        if returned and (stop - start) * log.dt_s <= config.excursion_s:
            if _stands_off(log, name, (start, stop), 0.5 * height):
                found.append((start, stop))
            first += 1
        first += 1
    return [span for span in found if not followed(log, name, *span)]


def _stands_off(log: Log, name: str, span: tuple[int, int], height: float) -> bool:
    """Tell an excursion from the good samples between two spikes of one sign."""
    values, (start, stop), reach = log[name], span, max(1, round(1.0 / log.dt_s))
    around = np.concatenate((values[max(0, start - reach) : start], values[stop : stop + reach]))
    inside, outside = values[start:stop], around[np.isfinite(around)]
    inside = inside[np.isfinite(inside)]
    if not len(inside) or not len(outside):
        return False
    return bool(abs(np.median(inside) - np.median(outside)) > height)


def followed(log: Log, name: str, start: int, stop: int) -> bool:
    """Whether a spool fell below its whole operating range: then a cut of fuel was real."""
    if name in _INERTIAL or role(name) != "output":
        return False
    for spool in SPOOLS:
        if spool not in log.channels:
            continue
        values = log[spool]
        outside = np.concatenate((values[:start], values[stop:]))
        inside = values[start:stop]
        if not np.isfinite(outside).any() or not np.isfinite(inside).any():
            continue
        idle = max(robust_range(outside)[0], 0.25 * robust_range(values)[1])
        if np.nanmin(inside) < 0.85 * idle:
            return True
    return False


def beyond_usual(values: FloatArray, mask: BoolArray) -> bool:
    """Whether the samples of `mask` lie outside the range of the others."""
    others = values[~mask & np.isfinite(values)]
    if not len(others):
        return False
    low, high = np.percentile(others, (5, 95))
    margin = 0.5 * (high - low)
    floor = max(low - margin, 0.2 * low) if low > 0.0 else low - margin
    level = float(np.nanmedian(values[mask]))
    return bool(level < floor or level > high + margin)


def bursts(log: Log, name: str, spikes: BoolArray, config: FaultsConfig) -> BoolArray:
    """Cover spans in which at least `burst_count` spikes lie within `burst_s`.

    A spike is two jumps, or a run of `spikes` without a jump.
    """
    starts, stops, _ = jumps(log, name)
    marked, ends = runs(spikes)
    jumping = np.concatenate(([0], np.cumsum(np.isin(np.arange(len(log)), stops))))
    soft = jumping[ends] == jumping[marked]
    # Both sides of a soft spike count, so that every spike has two marks.
    first = np.concatenate((starts + 1, marked[soft], marked[soft]))
    last = np.concatenate((stops, ends[soft] - 1, ends[soft] - 1))
    order = np.argsort(first, kind="stable")
    first, last = first[order], last[order]
    count = 2 * config.burst_count
    mask = np.zeros(len(log), dtype=np.bool_)
    if len(first) < count:
        return mask
    near = (last[count - 1 :] - first[: len(first) - count + 1]) * log.dt_s <= config.burst_s
    inside = np.zeros(len(first) - 1, dtype=np.bool_)
    for index in np.flatnonzero(near):
        inside[index : index + count - 1] = True
    # A burst includes the spikes that follow each other closely at its ends.
    close = np.diff(first) * log.dt_s <= config.burst_s / config.burst_count
    for begin, end in zip(*runs(inside | close), strict=True):
        if inside[begin:end].any():
            mask[first[begin] : last[begin : end + 1].max() + 1] = True
    return mask


# At most this many freezes are expected in one log; the next longest run is natural.
_FREEZES = 10
_UNNATURAL = 5  # times longer than the longest natural run of equal samples is a freeze
# Noise reverses at least this part of the changes.
_REVERSALS = 0.02
# Another channel changes as usual if at least this part as often as in the whole log.
_AS_USUAL = 0.5
# Below this part of its highest value an engine does not run: it is cranked or windmills.
_STANDSTILL = 0.05


def repeats(values: FloatArray) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
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
    """Flag samples where a noisy output repeats one value for too long.

    All of these have to be true: it is an output; outside its long runs it has noise (a
    simulation without noise has none and may be constant for minutes); the run is longer than
    `frozen_s` and five times its longest natural run; another channel changes meanwhile; it is
    not the zero of an engine at standstill; and its noise exceeds its resolution. Levers,
    ambient channels and switches may be constant; samples between two measurements of a slow
    channel count for nothing.
    """
    never = np.zeros(len(log), dtype=np.bool_)
    values = np.where(log.interpolated.get(name, never), np.nan, log[name])
    mask = never.copy()
    if role(name) != "output":
        return mask
    for start, stop in unnatural(values, config.frozen_s / log.dt_s):
        if _standstill(values, start) or not _others_change(log, name, start, stop):
            continue
        if abs(values[start]) < 1e-9 and followed(log, name, start, stop):
            continue
        mask[start:stop] = True
    return mask


def _quantised(values: FloatArray) -> bool:
    """Whether the resolution exceeds the noise: then a repeated value is no evidence.

    The resolution is the distance of neighbours among all values that occur.
    """
    known = values[np.isfinite(values)]
    apart = np.diff(np.unique(known))
    return bool(len(apart)) and noise_level(known) < float(np.percentile(apart, 5))


def unnatural(values: FloatArray, least: float) -> list[tuple[int, int]]:
    """Find runs of one value, of more than `least` samples, in a signal that else has noise.

    They are five times as long as the longest natural run; (start, stop) in samples.
    """
    starts, stops = repeats(values)
    if len(starts) <= _FREEZES or _quantised(values):
        return []
    # Of a channel slower than the grid its own samples count.
    known = np.concatenate([[0], np.cumsum(np.isfinite(values))])
    length = known[stops] - known[starts]
    least *= float(known[-1]) / max(len(values), 1)
    natural = np.partition(length, -_FREEZES - 1)[-_FREEZES - 1]
    longest = max(least, float(_UNNATURAL * natural))
    long = length > longest
    others = np.ones(len(values), dtype=np.bool_)
    for start, stop in zip(starts[long], stops[long], strict=True):
        others[start:stop] = False
    if not long.any() or not _noisy(values[others & np.isfinite(values)]):
        return []
    return list(zip(starts[long].tolist(), stops[long].tolist(), strict=True))


def _noisy(values: FloatArray) -> bool:
    """Whether a channel has noise: its changes reverse every so often.

    Measured: 3-70 % of the changes of recorded outputs reverse the one before, even where the
    recorder has smoothed and the reader has interpolated; 1 % of a noise-free simulation's.
    """
    signs = np.sign(np.diff(values))
    signs = signs[signs != 0.0]
    if len(signs) < 2 or noise_level(values) == 0.0:
        return False
    return float(np.mean(signs[1:] != signs[:-1])) >= _REVERSALS


def _standstill(values: FloatArray, start: int) -> bool:
    """Tell an engine that ran down to (nearly) zero from a dropout, which jumps there."""
    low, high = robust_range(values)
    before = values[max(0, start - 8) : start]
    entry = float(np.nanmax(np.abs(before - values[start]), initial=0.0))
    return bool(abs(values[start]) < _STANDSTILL * high) and not entry > 0.05 * (high - low)


def _others_change(log: Log, name: str, start: int, stop: int) -> bool:
    """Whether another output or ambient channel goes on changing as it always does."""
    others = [other for other in log.channels if other != name and is_sensed(other)]
    if not others:
        return True
    return any(_changes_as_usual(log[other], start, stop) for other in others)


def _changes_as_usual(values: FloatArray, start: int, stop: int) -> bool:
    changes = np.diff(values) != 0.0
    known = np.isfinite(values[1:]) & np.isfinite(values[:-1])
    usual = float(np.mean(changes[known])) if known.any() else 0.0
    inside = known[start : stop - 1]
    if usual < 0.1 or not inside.any():
        return False
    return float(np.mean(changes[start : stop - 1][inside])) >= _AS_USUAL * usual
