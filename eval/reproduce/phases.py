"""In which phase of the flight an event lies."""

from __future__ import annotations

import numpy as np

from data_prep.events import PUSH, Event
from data_prep.log import FloatArray, Log

PHASES = ("ground", "take-off", "climb", "cruise", "descent", "approach")
SPEEDS = ("fast", "slow", "small")
_VERTICAL_FTPM = 500.0  # the aircraft's own instrument calls less than this level
_AVERAGED_S = 30.0
_HIGH_SHARE = 0.7  # of the lever's range: more is taken as take-off power


def phase_of(log: Log, event: Event, driver: str) -> str:
    """Name the phase by what the log says where the lever starts to move.

    With weight on wheels: take-off where the lever goes up beyond 70 % of its range in the log,
    else ground. In the air: approach where the approach discrete is set; else climb or descent
    by more than 500 ft/min over half a minute, and cruise otherwise. Channels that the log
    lacks tell nothing.
    """
    if _at(log, "WOW", event.start) > 0.5:
        lever = log[driver]
        high = np.nanmin(lever) + _HIGH_SHARE * (np.nanmax(lever) - np.nanmin(lever))
        return "take-off" if event.label == PUSH and event.lever_after > high else "ground"
    if _at(log, "Approach", event.start) > 0.5:
        return "approach"
    rate = _vertical_ftpm(log, event.start)
    if abs(rate) <= _VERTICAL_FTPM:
        return "cruise"
    return "climb" if rate > 0.0 else "descent"


def _at(log: Log, name: str, row: int) -> float:
    if name not in log.channels or not np.isfinite(log[name][row]):
        return 0.0
    return float(log[name][row])


def _vertical_ftpm(log: Log, row: int) -> float:
    """Mean climb rate round `row`, 0 where the altitude is not known."""
    if "ALT_ft" not in log.channels:
        return 0.0
    half = max(1, round(0.5 * _AVERAGED_S / log.dt_s))
    rows = slice(max(0, row - half), row + half + 1)
    altitude: FloatArray = log["ALT_ft"][rows]
    known = np.flatnonzero(np.isfinite(altitude))
    if len(known) < 2:
        return 0.0
    span_s = float(known[-1] - known[0]) * log.dt_s
    return 60.0 * float(altitude[known[-1]] - altitude[known[0]]) / span_s
