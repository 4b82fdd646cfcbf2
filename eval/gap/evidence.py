"""Everything that a diagnosis rests on, for the page to draw and the document to quote."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from eval.gap.data import GapData
from eval.gap.hidden_load import Spell
from eval.gap.where import Where
from narxcal.support.arrays import FloatArray
from training.budget.result import Interval
from training.gap.finding import ChannelShrink, Finding


@dataclass(frozen=True)
class TimeShrink:
    """Mean absolute errors of Ti and Tt in seconds over `events`, before and after."""

    events: int
    Ti_before_s: float
    Ti_after_s: float
    Tt_before_s: float
    Tt_after_s: float


@dataclass(frozen=True, eq=False)
class HeldOut:
    """What the found effects do on flights that took no part in finding them.

    `share` of the squared gap above the noise that they take away, as predicted; `channels` the
    RMSE before and after; `after` (flights, time, outputs) the simulator with them.
    `emulator_rmse` per channel is of the emulator's free run there, where the effects rest on it.
    """

    data: GapData
    share: float
    channels: Mapping[str, ChannelShrink]
    after: FloatArray
    emulator_rmse: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Evidence:
    """A diagnosis in full.

    `after` (flights, time, outputs) is the simulator with the claimed effects, or as it was where
    nothing is claimed; `predicted` the share of the squared gap that they will take off other
    flights, `channels` the RMSE on these. `times` is how Ti and Tt errors shrink with them, per
    channel, on held-out flights where there are any. `facts` go into `quality` as they are.
    `windows` are those of an unlogged load, found here and in the held-out flights.
    """

    data: GapData
    finding: Finding
    where: Where
    after: FloatArray
    times: Mapping[str, TimeShrink]
    predicted: Interval
    channels: Mapping[str, ChannelShrink]
    held_out: HeldOut | None = None
    facts: Mapping[str, object] = field(default_factory=dict)
    windows: tuple[Spell, ...] = ()
