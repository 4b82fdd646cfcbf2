"""The Ti/Tt rule sets: where Tt starts and how far the model may be from the flight.

Ti is the time from the lever movement to 10 % of the response. Sources disagree on Tt:

- `paper`: the calibration paper, section 3.2: Ti from 0 to t1 (10 %), Tt from t1 to t2 (90 %),
  both within +-10 % or 0.25 s.
- `part60`: 14 CFR Part 60 App. A Table A2A, 1.f.1/1.f.2 (1-1-14 edition): "(+-10 % Tt) and
  (+-10 % Ti, or +-0.25 s)"; Tt from Ti (Appendix F, quoted from memory). No floor for Tt.
- `icao`: ICAO 9625 / EASA CS-FSTD(A), quoted from memory: Tt from the lever movement to 90 %,
  both within +-10 % or 0.25 s.

Where two tolerances are given, the less restrictive applies (Part 60 App. A Att. 2, section 2).

The time bands a Ti/Tt plot shades: where the model may cross 10 % and 90 %.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from eval.response import Transient
from narxcal.support.errors import ConfigError, DataError

RulesName = Literal["paper", "part60", "icao"]


@dataclass(frozen=True)
class Tolerance:
    """`share` of the flight's time, or `floor_s` seconds if that is more."""

    share: float
    floor_s: float

    def allowed_s(self, flight_s: float) -> float:
        """Largest error in seconds that passes for a flight reading in seconds."""
        return max(self.share * abs(flight_s), self.floor_s)


@dataclass(frozen=True)
class Rules:
    """One rule set; `tt_origin` says whether Tt starts at 10 % or at the lever movement.

    `least_model_share` is ours, not the regulator's: each curve is read between its own settled
    values, so a model that hardly moves could still be "in time". A model whose response is a
    smaller share of the flight's than this fails.
    """

    name: RulesName
    source: str
    tt_origin: Literal["t10", "lever"]
    Ti: Tolerance
    Tt: Tolerance
    least_model_share: float = 0.5

    def total_s(self, initial_s: float, rise_s: float) -> float:
        """Return Tt in seconds, from Ti and the time from 10 % to 90 %."""
        return rise_s if self.tt_origin == "t10" else initial_s + rise_s


RULES: dict[RulesName, Rules] = {
    "paper": Rules(
        name="paper",
        source="NARX dynamic calibration paper, section 3.2",
        tt_origin="t10",
        Ti=Tolerance(0.10, 0.25),
        Tt=Tolerance(0.10, 0.25),
    ),
    "part60": Rules(
        name="part60",
        source="14 CFR Part 60 App. A Table A2A, 1.f.1 and 1.f.2 (1-1-14 edition)",
        tt_origin="t10",
        Ti=Tolerance(0.10, 0.25),
        Tt=Tolerance(0.10, 0.0),
    ),
    "icao": Rules(
        name="icao",
        source="ICAO 9625 / EASA CS-FSTD(A), engine acceleration and deceleration",
        tt_origin="lever",
        Ti=Tolerance(0.10, 0.25),
        Tt=Tolerance(0.10, 0.25),
    ),
}


def rules(name: str) -> Rules:
    """Look a rule set up; raises `ConfigError` naming the known ones."""
    for known, found in RULES.items():
        if known == name:
            return found
    raise ConfigError(f"unknown rule set '{name}'", hint=f"Known rule sets: {', '.join(RULES)}")


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
