"""How far the gap really shrinks: the found effects on flights, in three measures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from data_prep.events import Event
from eval.gap.claimed import Values, with_effects
from eval.gap.data import FloatArray, GapData
from eval.gap.evidence import HeldOut, TimeShrink
from eval.gap.times import TimeErrors, time_errors
from narxcal.effects.running import RateForm
from training.gap.finding import ChannelShrink
from training.gap.quadratic import misfit


def held_out(values: Values, data: GapData, emulator: RateForm | None) -> HeldOut:
    """Add the effects to the simulator of flights that took no part in finding them."""
    after = with_effects(values, data.flights, emulator)
    return HeldOut(data, audible_share(data, after), channel_shrink(data, after), after)


def audible_share(data: GapData, after: FloatArray) -> float:
    """Share of the gap above noise and nuisances that `after` takes away; 0 without a gap."""
    measure = misfit(data.flights, data.real, data.noise)
    before = measure.size(measure.gap)
    left = measure.size(measure.gap - np.where(measure.weights > 0.0, after - data.flights.y, 0.0))
    audible = float((before - measure.floor).sum())
    return float((before - left).sum()) / audible if audible > 0.0 else 0.0


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
    first, then = ({(e.flight, e.start): e for e in found.events} for found in (before, after))
    common = [key for key in first if key in then]

    def mean(found: Mapping[tuple[int, int], object], name: str) -> float:
        values = [abs(float(getattr(found[key], name))) for key in common]
        return float(np.mean(values)) if values else float("nan")

    return TimeShrink(
        len(common),
        mean(first, "Ti_s"),
        mean(then, "Ti_s"),
        mean(first, "Tt_s"),
        mean(then, "Tt_s"),
    )
