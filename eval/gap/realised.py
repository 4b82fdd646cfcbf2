"""How far the gap really shrinks: the found effects on flights, in three measures.

`after` is (flights, time, outputs), what the simulator says with the effects; `before` and `left`
are (flights,), the squared gap over its noise without and with them.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from data_prep.events import Event
from eval.gap.claimed import Values, with_effects
from eval.gap.data import GapData
from eval.gap.evidence import HeldOut, TimeShrink
from eval.gap.times import TimeErrors, time_errors
from narxcal.effects.running import Emulator
from narxcal.support.arrays import FloatArray
from training.gap.finding import ChannelShrink
from training.gap.quadratic import TOLERANCE


def held_out(values: Values, data: GapData, emulator: Emulator | None) -> HeldOut:
    """Add the effects to the simulator of flights that took no part in finding them."""
    after = with_effects(values, data.flights, emulator)
    share = float(pooled_share(*squares(data, after)))
    return HeldOut(data, share, channel_shrink(data, after), after)


def squares(data: GapData, after: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Sums of squares of the gap above the noise per flight, before and `after`: (flights,) each.

    Plain differences of recorded and simulated outputs, each channel over
    `noise^2 + (0.001 range)^2`, so that anybody can form them from the logs.
    """
    variance = data.noise**2 + (TOLERANCE * data.span) ** 2
    floor = (np.isfinite(data.gap) * (data.noise**2 / variance)).sum(axis=(1, 2))
    before = np.nansum(data.gap**2 / variance, axis=(1, 2)) - floor
    left = np.nansum((data.real - after) ** 2 / variance, axis=(1, 2)) - floor
    return before, left


def pooled_share(before: FloatArray, left: FloatArray) -> float:
    """Share of the squared gap that is taken away over all flights; 0 where there is no gap.

    No more than all: what is left may by chance be less than the noise.
    """
    whole = float(before.sum())
    return min(1.0, 1.0 - float(left.sum()) / whole) if whole > 0.0 else 0.0


def channel_shrink(data: GapData, after: FloatArray) -> dict[str, ChannelShrink]:
    """Root mean squares of recorded less simulated, before and after, and the noise."""
    before = np.sqrt(np.nanmean(data.gap**2, axis=(0, 1)))
    left = np.sqrt(np.nanmean((data.real - after) ** 2, axis=(0, 1)))
    return {
        name: ChannelShrink(float(before[k]), float(left[k]), float(data.noise[k]))
        for k, name in enumerate(data.flights.signals.outputs)
    }


def time_shrink(
    data: GapData, after: FloatArray, events: Sequence[Sequence[Event]]
) -> dict[str, TimeShrink]:
    """Errors of Ti and Tt before and after, over the events that could be read both times."""
    first = time_errors(data, data.flights.y, events)
    then = time_errors(data, after, events)
    return {name: _both(first[name], then[name]) for name in first}


def _both(before: TimeErrors, after: TimeErrors) -> TimeShrink:
    first, then = before.shared_with(after), after.shared_with(before)
    times = [found.mean_abs(name) for name in ("Ti_s", "Tt_s") for found in (first, then)]
    return TimeShrink(len(first.events), *times)
