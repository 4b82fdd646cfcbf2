"""Find the equilibrium parts of a log, and leave out where the engine does not run.

One detector serves the steady-state fit, the local trim and the ends of events: a sample is in
equilibrium where no channel of interest moves by more than its band within a window.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType

import numpy as np
from pydantic import Field
from scipy.ndimage import binary_dilation, binary_opening, maximum_filter1d, minimum_filter1d

from data_prep.log import Audit, AuditEntry, Log
from narxcal.support.arrays import (
    BoolArray,
    FloatArray,
    bridge_gaps,
    long_runs,
    robust_range,
    spans,
)
from narxcal.support.settings import Section


class QuasiSteadyConfig(Section):
    """Bands of a quasi-steady sample, in the window of `window_s` centred on it.

    `speed_pct` is the band of every speed channel in % and `driver_fraction` that of the driver as
    a share of its own robust range in the log.
    """

    window_s: float = Field(default=6.0, gt=0)
    speed_pct: float = Field(default=2.0, gt=0)
    driver_fraction: float = Field(default=0.03, gt=0)


def quasi_steady(
    log: Log, driver: str, speeds: tuple[str, ...], config: QuasiSteadyConfig
) -> BoolArray:
    """Mark quasi-steady samples (time,); a sample with NaN in its window is not.

    A speed of which the log has no sample at all is left out.
    """
    # A window that reaches beyond the log sees no more than the log.
    size = 2 * min(round(0.5 * config.window_s / log.dt_s), len(log)) + 1
    values = log[driver]
    low, high = np.nanpercentile(values, [1, 99]) if np.isfinite(values).any() else (0.0, 0.0)
    bands = dict.fromkeys(log.recorded(speeds), config.speed_pct)
    bands[driver] = min(config.driver_fraction * (high - low), bands.get(driver, np.inf))
    return in_equilibrium(log, bands, size)


def in_equilibrium(
    log: Log, bands: Mapping[str, float], size: int, *, ahead: bool = False, longest_gap: int = 0
) -> BoolArray:
    """Mark samples (time,) where no channel of `bands` moves by more than its band.

    `bands` maps channels to their largest range (peak to peak, in their unit) within a window of
    `size` samples, which is centred on the sample or, with `ahead`, begins there. A window with a
    gap of more than `longest_gap` samples is not in equilibrium.
    """
    found = np.ones(len(log), dtype=np.bool_)
    for name, band in bands.items():
        origin = -(size // 2) if ahead else 0
        gaps = long_runs(~np.isfinite(log[name]), longest_gap).view(np.int8)
        found &= maximum_filter1d(gaps, size, origin=origin) == 0
        found &= peak_to_peak(bridge_gaps(log[name]), size, origin) <= band
    return found


def peak_to_peak(values: FloatArray, size: int, origin: int = 0) -> FloatArray:
    """Largest minus smallest value (time, ...) in the window of `size` samples about each one.

    The window is centred at `origin` 0 and begins at the sample at -(size // 2).
    """
    swing: FloatArray = maximum_filter1d(values, size, axis=0, origin=origin)
    swing -= minimum_filter1d(values, size, axis=0, origin=origin)
    return swing


# Below any idle, and about where starters disengage.
BELOW_IDLE: Mapping[str, float] = MappingProxyType({"N1_pct": 12.0, "N2_pct": 40.0})


class RunningConfig(Section):
    """TOML table `[running]`: when an engine counts as running.

    It does not where each of the channels of `above` that the log has is below its value, or where
    N2 is and no fuel flows, for at least `least_s`. That, and `margin_s` before and after, is left
    out of the log, which is split there. An empty `above` keeps everything; so does a log in which
    the engine never runs.
    """

    above: Mapping[str, float] = Field(default_factory=lambda: dict(BELOW_IDLE))
    least_s: float = Field(default=5.0, ge=0.0)
    margin_s: float = Field(default=20.0, ge=0.0)


def while_running(logs: Sequence[Log], config: RunningConfig) -> list[Log]:
    """Return the stretches of logs in which the engine runs; the audit counts what was left out.

    The first stretch keeps the log's name, the next ones are `NAME#2` and so on: numbers go on
    where a recording was split before.
    """
    parts: dict[str, int] = {}
    kept = []
    for part in (part for log in logs for part in _parts(log, config)):
        name = part.name.partition("#")[0]
        parts[name] = parts.get(name, 0) + 1
        number = parts[name]
        kept.append(replace(part, name=f"{name}#{number}" if number > 1 else name))
    return kept


def _parts(log: Log, config: RunningConfig) -> list[Log]:
    out = _not_running(log, config)
    if not out.any() or out.all():
        return [log]
    least = max(2, round(config.margin_s / log.dt_s))
    kept = [(start, stop) for start, stop in spans(~out) if stop - start >= least]
    if not kept:
        return [log]
    lost = len(log) - sum(stop - start for start, stop in kept)
    entry = AuditEntry("*", "dropped", "engine not running", lost)
    parts = [replace(log.part(start, stop), audit=Audit()) for start, stop in kept]
    parts[0] = replace(parts[0], audit=log.audit.add(entry))
    return parts


_NO_FUEL = 0.02  # share of the largest fuel flow; idle takes about a tenth of it


def _windmills(log: Log, config: RunningConfig) -> BoolArray:
    """Mark the samples without fuel in which the core turns below idle.

    In flight the wind keeps the fan above its limit. A core at speed contradicts a fuel flow of
    zero: then the meter is at fault.
    """
    if not {"FF_kgph", "N2_pct"} <= log.channels.keys() or "N2_pct" not in config.above:
        return np.zeros(len(log), dtype=np.bool_)
    most = robust_range(log["FF_kgph"])[1]
    return (log["FF_kgph"] < _NO_FUEL * most) & (log["N2_pct"] < config.above["N2_pct"])


def _not_running(log: Log, config: RunningConfig) -> BoolArray:
    """Mark the samples to leave out; a missing reading is no sign that the engine does not run."""
    there = [name for name in config.above if name in log.channels]
    if not there:
        return np.zeros(len(log), dtype=np.bool_)
    below = np.all([log[name] < config.above[name] for name in there], axis=0)
    below |= _windmills(log, config)
    least, margin = (round(time / log.dt_s) for time in (config.least_s, config.margin_s))
    # What is below at an end of the log was so before or goes on so.
    padded = np.pad(below, least, mode="edge")
    out = binary_opening(padded, np.ones(max(least, 1), np.bool_))[least : least + len(log)]
    if margin and out.any():
        out = binary_dilation(out, np.ones(3, np.bool_), iterations=margin)
    return np.asarray(out)
