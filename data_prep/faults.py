"""Sensor faults that last: a channel that jumps away and back, spikes, or is out of range.

Signals and masks are `(time,)`, NaN where nothing was measured.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from data_prep.log import Log
from data_prep.moves import noise_of, runs
from data_prep.outliers import resolution, robust_range
from narxcal.channels import CHANNELS
from narxcal.settings import Section

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.intp]
Reason = Literal["frozen", "spiking", "out of range"]

# Slack on the physical limits, in parts of their distance: an air-data computer at rest
# shows Mach -4e-6.
_SLACK = 0.005
# A jump is faster than this many ranges of the channel per second (the quickest measured:
# 0.75, fuel flow of a geared turbofan at a slam) ...
_JUMP_RATE = 1.5
# ... and stands out of the channel's noise and resolution. A log at steady cruise has next to
# no range; this part of the level stands in.
_JUMP_NOISE = 12.0
_JUMP_STEPS = 4.0
_LEAST_RANGE = 0.25
# After an excursion the channel is back where it was, to this part of the larger jump; the
# engine may have accelerated meanwhile.
_RETURN = 0.5
SPOOLS = ("N1_pct", "N2_pct")
# Spools and hot metal cannot jump, whatever the fuel does.
_INERTIAL = frozenset({"N1_pct", "N2_pct", "EGT_C"})


class FaultsConfig(Section):
    """Nested table `[clean.faults]`.

    frozen_s: an output that repeats one value for longer may be frozen (see `data_prep.frozen`).
    excursion_s: longest dropout or plateau between two opposite jumps.
    burst_s, burst_count: so many spikes within this time mask the channel as spiking.
    """

    frozen_s: float = Field(default=2.0, gt=0)
    excursion_s: float = Field(default=60.0, gt=0)
    burst_s: float = Field(default=2.0, gt=0)
    burst_count: int = Field(default=4, ge=2)


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


def jumps(log: Log, name: str) -> tuple[IntArray, IntArray, FloatArray]:
    """Find the jumps no engine can make, faster than its own range in two thirds of a second.

    Returns first and last samples and signed heights; successive steps of one sign are one.
    """
    values = log[name]
    step = np.diff(values)
    low, high = robust_range(values)
    known = np.abs(values[np.isfinite(values)])
    scale = max(high - low, _LEAST_RANGE * float(np.median(known))) if len(known) else 0.0
    quiet = max(_JUMP_NOISE * noise_of(values), _JUMP_STEPS * resolution(values))
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
    """Whether a spool ran down below everything it runs at: then a cut of fuel was real."""
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
    """Whether what `mask` holds lies outside what the channel shows elsewhere."""
    rest = values[~mask & np.isfinite(values)]
    if not len(rest):
        return False
    low, high = np.percentile(rest, (5, 95))
    margin = 0.5 * (high - low)
    floor = max(low - margin, 0.2 * low) if low > 0.0 else low - margin
    held = float(np.nanmedian(values[mask]))
    return bool(held < floor or held > high + margin)


def bursts(log: Log, name: str, spikes: BoolArray, config: FaultsConfig) -> BoolArray:
    """Cover spans in which at least `burst_count` spikes lie within `burst_s`.

    A spike is two jumps, or a run of `spikes` that holds no jump.
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
    # A burst takes in the spikes that follow each other closely at its ends.
    close = np.diff(first) * log.dt_s <= config.burst_s / config.burst_count
    for begin, end in zip(*runs(inside | close), strict=True):
        if inside[begin:end].any():
            mask[first[begin] : last[begin : end + 1].max() + 1] = True
    return mask
