"""Find lasting sensor faults: a channel is frozen, out of range, spikes, or jumps away and back.

Signals and masks are `(time,)`, NaN where nothing was measured.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from scipy.ndimage import uniform_filter1d

from data_prep.log import Log
from narxcal.channels import SPOOLS, Channel
from narxcal.support.arrays import (
    BoolArray,
    FloatArray,
    IntArray,
    bridge_gaps,
    noise_level,
    robust_range,
    runs,
)
from narxcal.support.settings import Section

Reason = Literal["frozen", "spiking", "out of range"]

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

    frozen_s: an output that repeats one value for longer may be frozen (see the module's text).
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
    return float(np.percentile(steps, 5.0)) if len(steps) else 0.0


def is_sensed(channel: Channel) -> bool:
    """Whether a channel is a physical quantity that cannot jump, unlike levers and switches."""
    return channel.role in {"output", "ambient", "auxiliary"}


def out_of_range(channel: Channel, values: FloatArray) -> BoolArray:
    """Flag samples that no engine and no atmosphere can show."""
    low, high = channel.limits
    return (values < low) | (values > high)


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
    if not is_sensed(log.channel(name)):
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
    if name in _INERTIAL or log.channel(name).role != "output":
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


# False alarms per hour of a log and channel.
RATE_PER_H = 0.01
# At most this many freezes are expected in one log: the next longest runs are natural.
_FREEZES = 10
_TAIL = 0.02  # share of the runs that make the tail, and the least number that shows its shape
_LEAST_TAIL = 20
_LEVELS = 10  # of the motion of the other channels, with as many samples each
_MOTION_S = 2.0  # over which it is taken
# Noise reverses at least this part of the changes. Measured: 3-70 % of the changes of recorded
# outputs reverse the one before, even where the recorder has smoothed and the reader has
# interpolated; 1 % of a noise-free simulation's.
_REVERSALS = 0.02
# Part of its range within which a channel rests: noise at idle of recorded speeds takes 0.6 %.
_REST = 0.01
_LARGEST_STEP = 0.1  # likewise, from a stop to the next sample; a dropout jumps further
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
    """Flag samples where an output repeats one value for longer than sound ones do.

    Left alone is what lasts less than `frozen_s`, a value that comes back where all else that is
    commanded and measured of the engine rests, a channel at its stop, the zero of an engine at
    standstill and a cut of fuel that the spools follow. Levers, ambient channels and switches may
    be constant.
    """
    mask = np.zeros(len(log), dtype=np.bool_)
    if log.channel(name).role != "output":
        return mask
    values, found = log[name], unnatural(log, name, config.frozen_s)
    levels = [float(values[start]) for start, _ in found]
    for start, stop in found:
        if abs(values[start]) < 1e-9:  # what a lost sensor shows
            sound = followed(log, name, start, stop)
        else:
            again = levels.count(float(values[start])) > 1
            sound = _at_stop(values, start, stop) or (again and _rests(log, name, start, stop))
        if sound or _standstill(values, start):
            continue
        mask[start:stop] = True
    return mask


def _rests(log: Log, name: str, start: int, stop: int) -> bool:
    """Whether commands and the other outputs rest: what depends on them may, too."""
    others = [
        robust_range(log[each][start:stop]) + robust_range(log[each])
        for each in log.recorded(tuple(log.channels))
        if each != name and log.channel(each).role in {"lever", "output"}
    ]
    return bool(others) and all(b - a <= _REST * (high - low) for a, b, low, high in others)


def _at_stop(values: FloatArray, start: int, stop: int) -> bool:
    """Whether a channel moves to its lowest or highest value and away again, without a jump."""
    if values[start] not in (np.nanmin(values), np.nanmax(values)):
        return False
    around = values[[max(start - 1, 0), min(stop, len(values) - 1)]]
    low, high = robust_range(values)
    return bool(np.nanmax(np.abs(around - values[start])) <= _LARGEST_STEP * (high - low))


def unnatural(log: Log, name: str, least_s: float) -> list[tuple[int, int]]:
    """Find runs of one value that the channel's own behaviour in the log does not explain.

    The exposure of a run is the number of changes that were to be expected in it,

        x = sum_k h(m_k),   h(m) = -ln P(no change from sample to sample | m),

    with m the motion of the other channels and P its share in samples of the same log with as much
    motion: so the resolution, the noise and the rate of the recorder are accounted for. Exposures
    of natural runs have an exponential tail above a level u, with the mean g of x - u, taken from
    all but the `_FREEZES` largest. With k runs above u, of which k' were used,

        E[longer runs] = k (1 + (x - u) / (k' g))^-k'

    by the predictive distribution of an exponential variable. A run of which fewer than
    `RATE_PER_H` an hour are expected is unnatural. Samples between two measurements of a slow
    channel count for nothing, nor do those at which no other channel changes, for then the recorder
    may pause. A channel that most samples repeat is coarser than its noise, and one without noise
    rests in equilibrium: of both nothing is concluded.

    Returns (start, stop) in samples of what lasts for more than `least_s`.
    """
    values = log.measured([name])[:, 0]
    known = np.flatnonzero(np.isfinite(values))
    starts, stops = repeats(values)
    long = (stops - starts) * log.dt_s > least_s
    lengths = np.diff(np.searchsorted(known, starts), append=len(known))
    if not long.any() or not _noisy(values[known], lengths):
        return []
    few = RATE_PER_H * len(log) * log.dt_s / 3600.0
    found = long & (expected_beyond(*_exposures(log, name, known, starts)) < few)
    return list(zip(starts[found].tolist(), stops[found].tolist(), strict=True))


def expected_beyond(least: FloatArray, most: FloatArray) -> FloatArray:
    """How many natural runs of a log are expected beyond each one's exposure (runs,).

    A run is known to whole samples: its exposure lies between `least` and `most`.
    """
    count = len(least)
    many = min(max(round(_TAIL * count), _LEAST_TAIL), count // 2)
    largest = min(_FREEZES, many // 2)
    if not largest:
        return np.full(count, np.inf)
    ordered = np.sort(most)[::-1]
    level = float(np.sort(least)[::-1][many])
    tail = ordered[largest:many] - level
    # The largest ones count as those below them: they may be faults.
    total = float(tail.sum() + largest * tail[0])
    if not total > 0.0:
        return np.full(count, np.inf)
    beyond = np.maximum(least - level, 0.0)
    return np.asarray(many * np.exp(-(many - largest) * np.log1p(beyond / total)))


def _noisy(known: FloatArray, lengths: IntArray) -> bool:
    """Whether a channel has noise beyond its resolution, outside of its longest runs."""
    if len(lengths) <= _FREEZES:
        return False
    natural = np.sort(lengths)[:-_FREEZES]
    signs = np.sign(np.diff(known))
    signs = signs[signs != 0.0]
    reversals = float(np.mean(signs[1:] != signs[:-1]))
    return bool(2 * len(natural) >= natural.sum()) and reversals >= _REVERSALS


def _exposures(
    log: Log, name: str, known: IntArray, starts: IntArray
) -> tuple[FloatArray, FloatArray]:
    """Bounds of the exposures (runs,) of runs that begin at `starts`, two of the `known` samples.

    Least without the sample that ends a run, most with it.
    """
    changed = np.isin(known, starts)
    motion, alive = _motion(log, name, known)
    edges = np.quantile(motion, np.linspace(0.0, 1.0, _LEVELS + 1)[1:-1])
    level = np.searchsorted(edges, motion)
    changes, samples = (
        np.bincount(level, each, _LEVELS) for each in (changed, np.ones_like(motion))
    )
    hazard = -np.log1p(-(changes + 0.5) / (samples + 1.0))[level] * alive
    total = np.append(0.0, np.cumsum(hazard))
    ends = np.append(np.searchsorted(known, starts), len(known))
    least = np.diff(total[ends])
    return least, least + np.append(hazard[ends[1:-1]], 0.0)


def _motion(log: Log, name: str, known: IntArray) -> tuple[FloatArray, BoolArray]:
    """Motion of the other channels at the `known` samples, and whether any of them changes."""
    motion, alive = np.zeros(len(log)), np.zeros(len(log), dtype=np.bool_)
    others = [other for other in log.channels if other != name and is_sensed(log.channel(other))]
    size = max(1, round(_MOTION_S / log.dt_s))
    for other in others:
        low, high = robust_range(log[other])
        if high > low:
            values = bridge_gaps(log[other])
            slow = uniform_filter1d(values, size, mode="nearest")
            motion += np.abs(np.gradient(slow)) / (high - low)
            alive[1:] |= np.diff(values) != 0.0
    return motion[known], alive[known] if others else np.ones(len(known), dtype=np.bool_)


def _standstill(values: FloatArray, start: int) -> bool:
    """Tell an engine that ran down to (nearly) zero from a dropout, which jumps there."""
    low, high = robust_range(values)
    before = values[max(0, start - 8) : start]
    entry = float(np.nanmax(np.abs(before - values[start]), initial=0.0))
    return bool(abs(values[start]) < _STANDSTILL * high) and not entry > 0.05 * (high - low)
