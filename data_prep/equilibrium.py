"""Where a log stands still: the samples a steady-state model may be fitted to.

Leaves out what no model here describes: the engine while it starts, stands or runs down.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, field_validator
from scipy.ndimage import binary_dilation, binary_opening, maximum_filter1d, minimum_filter1d

from data_prep.log import Audit, AuditEntry, Log
from data_prep.recorded import recorded
from narxcal.channels import channel
from narxcal.support.arrays import BoolArray, FloatArray, spans
from narxcal.support.settings import Section


class QuasiSteadyConfig(Section):
    """A sample is quasi-steady if, in the window centred on it, nothing moves much.

    `speed_pct` bounds the range of every speed channel in % and `driver_fraction` that of the
    driver as a share of its own robust range in the log.
    """

    window_s: float = Field(default=6.0, gt=0)
    speed_pct: float = Field(default=2.0, gt=0)
    driver_fraction: float = Field(default=0.03, gt=0)


def quasi_steady(
    log: Log, driver: str, speeds: tuple[str, ...], config: QuasiSteadyConfig
) -> NDArray[np.bool_]:
    """Mark quasi-steady samples (time,); a sample with NaN in its window is not.

    A speed of which the log has no sample at all says nothing.
    """
    # A window that reaches beyond the log sees no more than the log.
    size = 2 * min(round(0.5 * config.window_s / log.dt_s), len(log)) + 1
    values = log[driver]
    low, high = np.nanpercentile(values, [1, 99]) if np.isfinite(values).any() else (0.0, 0.0)
    still = _range(values, size) <= config.driver_fraction * (high - low)
    for name in recorded(log, speeds):
        still &= _range(log[name], size) <= config.speed_pct
    return still


def _range(values: FloatArray, size: int) -> FloatArray:
    known = np.isfinite(values)
    filled = np.where(known, values, 0.0)
    width: FloatArray = maximum_filter1d(filled, size) - minimum_filter1d(filled, size)
    return np.where(minimum_filter1d(known.astype(np.int8), size) == 1, width, np.inf)


# Below any idle, and about where starters let go.
USUAL: Mapping[str, float] = MappingProxyType({"N1_pct": 12.0, "N2_pct": 40.0})


class RunningConfig(Section):
    """TOML table `[running]`: when an engine counts as running.

    It stands where each of the channels of `above` that the log has is below its value for at
    least `least_s`. That, and `margin_s` before and after, is left out of the log, which is split
    there. An empty `above` keeps everything; so does a log in which the engine never runs.
    """

    above: Mapping[str, float] = Field(default_factory=lambda: dict(USUAL))
    least_s: float = Field(default=5.0, ge=0.0)
    margin_s: float = Field(default=20.0, ge=0.0)

    @field_validator("above")
    @classmethod
    def _known(cls, above: Mapping[str, float]) -> Mapping[str, float]:
        for name in above:
            channel(name)
        return above


def while_running(logs: Sequence[Log], config: RunningConfig) -> list[Log]:
    """The stretches of logs in which the engine runs; the audit says how much went.

    The first stretch keeps the log's name, the next ones are `NAME#2` and so on: numbers go on
    where a recording was split before.
    """
    taken: dict[str, int] = {}
    kept = []
    for part in (part for log in logs for part in _parts(log, config)):
        name = part.name.partition("#")[0]
        taken[name] = taken.get(name, 0) + 1
        number = taken[name]
        kept.append(replace(part, name=f"{name}#{number}" if number > 1 else name))
    return kept


def _parts(log: Log, config: RunningConfig) -> list[Log]:
    out = _standing(log, config)
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


def _standing(log: Log, config: RunningConfig) -> BoolArray:
    """Samples to leave out; a missing reading does not say that the engine stands."""
    there = [name for name in config.above if name in log.channels]
    if not there:
        return np.zeros(len(log), dtype=np.bool_)
    below = np.all([log[name] < config.above[name] for name in there], axis=0)
    least, margin = (round(time / log.dt_s) for time in (config.least_s, config.margin_s))
    # What stands at an end of the log stood before or goes on standing.
    padded = np.pad(below, least, mode="edge")
    standing = binary_opening(padded, np.ones(max(least, 1), np.bool_))[least : least + len(log)]
    if margin and standing.any():
        standing = binary_dilation(standing, np.ones(3, np.bool_), iterations=margin)
    return np.asarray(standing)
