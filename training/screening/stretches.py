"""Stretches of a channel that are at fault, while the rest of the log is not: these are masked.

A detector takes a subject and the channels that may be at fault, and returns findings.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from data_prep.cleaning.faults import resolution
from data_prep.log import Finding
from narxcal.channels import CHANNELS
from narxcal.support.arrays import BoolArray, FloatArray, spans
from training.screening.redundancy import Residuals, blocks_of, moving_mean
from training.screening.scatter import BLOCK_S, Blocks, Step, strongest_step
from training.screening.subject import TELLING, Subject

_BRIDGED_S, _FAR_BLOCKS = 60.0, 3  # so many blocks are no outliers
_STILL = 0.2  # of the motion that the other channels show
_STILL_S, _LEAST_STILL_S = 60.0, 30.0
_MOSTLY = 0.98


def strongest(subject: Subject, channels: Sequence[str]) -> list[Finding]:
    """The strongest stretch of one channel with all that is as wrong, if it is at fault."""
    found = subject.shown.apart_from(subject.mate)
    limits = subject.bank.step_limits(subject.share, apart=subject.mate is not None)
    best: tuple[float, str, Blocks, list[tuple[int, int]]] | None = None
    for name in channels:
        if len(found.errors[name]) < 2:
            continue  # of two channels neither can be said to be wrong
        blocks = blocks_of(found, name)
        step = strongest_step(blocks, limits[name])
        parts = _at_fault(blocks, step, subject.limit[name], limits[name])
        if parts and (best is None or step.excess > best[0]):
            best = step.excess, name, blocks, parts
    if best is None:
        return []
    _, name, blocks, parts = best
    spans_s = [_span_s(subject, blocks, *part) for part in parts]
    levels = [float(np.median(np.abs(blocks.r[slice(*part)]))) for part in parts]
    pairs = zip(levels, spans_s, strict=True)
    return [subject.misfit(found, name, level, span_s) for level, span_s in pairs]


def _at_fault(
    blocks: Blocks, step: Step, limit: float, steps: Mapping[int, float]
) -> list[tuple[int, int]]:
    """Blocks at fault: the step, or all but it where that agrees; empty where nothing is.

    A fault once proven, what is nearer to it than to the rest, or as far from that as no stretch
    of a sound log is (limits `steps`), is no longer used.
    """
    if step.excess < 1.0:
        return []
    inside = np.zeros(len(blocks.r), dtype=np.bool_)
    inside[step.start : step.stop] = True
    sides = [(float(np.median(blocks.r[rows])), rows) for rows in (inside, ~inside)]
    (right, _), (wrong, rows) = sorted(sides, key=lambda side: abs(side[0]))
    if abs(right) > limit:
        return []
    far = (blocks.r - right) * np.sign(wrong) > min(0.5 * abs(wrong - right), *steps.values())
    for start, stop in spans(rows):
        first, last = _extended(far, start, stop)
        rows[first:last] = True
    return spans(rows)


def _extended(far: BoolArray, start: int, stop: int) -> tuple[int, int]:
    """The span `start:stop` with what is far from the rest of the log next to it.

    Gaps of up to `_BRIDGED_S` are bridged: a sensor that fails before and after them is not
    believed within.
    """
    reach = round(_BRIDGED_S / BLOCK_S)
    while True:
        first = max(start - reach, 0)
        before, after = np.flatnonzero(far[first:start]), np.flatnonzero(far[stop : stop + reach])
        if len(before) < _FAR_BLOCKS and len(after) < _FAR_BLOCKS:
            return start, stop
        start = first + int(before[0]) if len(before) >= _FAR_BLOCKS else start
        stop = stop + int(after[-1]) + 1 if len(after) >= _FAR_BLOCKS else stop


def _span_s(subject: Subject, blocks: Blocks, start: int, stop: int) -> tuple[float, float]:
    """Times of a stretch, to the middles of the next blocks.

    Less than half of a block whose median agrees can be wrong, and what cannot be compared in
    between is not believed.
    """
    first = subject.log.time_s[0] if start == 0 else blocks.time_s[start - 1]
    last = subject.log.time_s[-1] if stop == len(blocks.r) else blocks.time_s[stop]
    return float(first), float(last)


def motionless(subject: Subject, name: str) -> Iterator[Finding]:
    """Stretches in which a channel shows noise, or nothing, while the others agree that it moves.

    A channel that is set in steps, as benches and simulators set it, may stay.
    """
    if len(subject.sensed) < TELLING or _in_steps(subject.log[name]):
        return
    found, y = subject.shown, subject.signals.values[name]
    size, step_s = round(_STILL_S / found.signals.step_s), found.signals.step_s
    own, implied = _moving_spread(y, size), _implied(found, name, size)
    # Half of the steps that sound logs show: a motion to both sides has that standard deviation.
    limits = subject.step_limits[name]
    scatter = 0.5 * limits.get(1, limits.get(0, np.inf)) * abs(subject.bank.centre[name])
    least = np.maximum(scatter * found.corrected.scale[name], 3.0 * resolution(y))
    if subject.mate is not None and name in subject.mate.errors:
        # The other engine moves, too, while this one's channel stays.
        implied = np.minimum(implied, _moving_spread(subject.mate.signals.values[name], size))
    quiet = (own < _STILL * implied) & (implied > least)
    time_s, ends = found.signals.time_s, subject.log.time_s[[0, -1]]
    for start, stop in _followed(y, own, quiet, size // 2):
        if (stop - start) * step_s < _LEAST_STILL_S:
            continue
        level = float(np.nanmedian(y[start:stop]))
        text = f"stays at {level:.4g} while {subject.others(name)} move"
        reach = time_s[[start, stop - 1]] + [-0.5 * step_s, 0.5 * step_s]
        span_s = float(max(reach[0], ends[0])), float(min(reach[1], ends[1]))
        everywhere = stop - start > _MOSTLY * len(y)
        about = None if everywhere else span_s
        yield subject.log.finding("stuck", name, text, about, size=level, unit=CHANNELS[name].unit)


def _in_steps(values: FloatArray) -> bool:
    """Whether most samples repeat the one before, also outside of the longest such stretch."""
    still = np.diff(values[np.isfinite(values)]) == 0.0
    longest = max((stop - start for start, stop in spans(still)), default=0)
    return bool(2 * (int(still.sum()) - longest) > len(still) - longest)


def _followed(y: FloatArray, own: FloatArray, quiet: BoolArray, half: int) -> list[tuple[int, int]]:
    """Stretches around quiet windows, for as long as the channel keeps its level."""
    still = np.zeros(len(y), dtype=np.bool_)
    for start, stop in spans(quiet):
        first, last = max(start - half, 0), min(stop + half, len(y))
        level, width = np.nanmedian(y[first:last]), 4.0 * float(np.nanmax(own[start:stop]))
        same = np.abs(moving_mean(y, 5) - level) <= max(width, 1e-9)
        same[start:stop] = True
        first, last = next(part for part in spans(same) if part[0] <= start < part[1])
        still[first:last] = True
    return spans(still)


def _implied(found: Residuals, name: str, size: int) -> FloatArray:
    """Standard deviation in a window (time,) that half of the other channels ask for, or more."""
    scale = found.scale(name)
    parts = [
        _moving_spread(found.corrected.raw(name, found.corrected.x[name] - each * scale), size)
        for each in found.errors[name].values()
    ]
    ordered = np.sort(np.nan_to_num(np.stack(parts)), axis=0)
    return np.asarray(ordered[(len(parts) - 1) // 2])


def _moving_spread(values: FloatArray, size: int) -> FloatArray:
    centred = values - (np.nanmean(values) if np.isfinite(values).any() else 0.0)
    square = moving_mean(centred**2, size) - moving_mean(centred, size) ** 2
    return np.sqrt(np.maximum(square, 0.0))
