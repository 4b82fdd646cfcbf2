"""The time bands a Ti/Tt plot shades: where the model may cross 10 % and 90 %."""

from __future__ import annotations

from dataclasses import dataclass

from eval.response import Transient
from eval.rules import Rules
from narxcal.errors import DataError


@dataclass(frozen=True)
class Band:
    """From `start_s` to `stop_s` on the log's clock, at `level` in the channel's unit."""

    start_s: float
    stop_s: float
    level: float


def tolerance_windows(flight: Transient, rules: Rules) -> tuple[Band, Band]:
    """Bands around the flight's t10 and t90 for an assessable flight transient.

    Where Tt starts at t10, the second band holds for a model that is on time at 10 %: one that
    is early or late there may be as early or late at 90 %. Raises `DataError` for a transient
    that is not assessable.
    """
    if flight.reason is not None:
        raise DataError(f"a transient that is not assessable has no windows: {flight.reason}")
    total_s = rules.total_s(flight.Ti_s, flight.Tt_s)
    return (
        _band(flight.t10_s, rules.Ti.allowed_s(flight.Ti_s), flight.before + 0.1 * flight.response),
        _band(flight.t90_s, rules.Tt.allowed_s(total_s), flight.before + 0.9 * flight.response),
    )


def _band(centre_s: float, allowed_s: float, level: float) -> Band:
    return Band(centre_s - allowed_s, centre_s + allowed_s, level)
