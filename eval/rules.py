"""The Ti/Tt rule sets, and the verdict on one transient: how far the model may be off the flight.

Ti is the time from the lever movement to 10 % of the response. Sources disagree on Tt:

- `paper`: the calibration paper, section 3.2: Ti from 0 to t1 (10 %), Tt from t1 to t2 (90 %),
  both within +-10 % or 0.25 s.
- `part60`: 14 CFR Part 60 App. A Table A2A, 1.f.1/1.f.2 (1-1-14 edition): "(+-10 % Tt) and
  (+-10 % Ti, or +-0.25 s)"; Tt from Ti (Appendix F, quoted from memory). No floor for Tt.
- `icao`: ICAO 9625 / EASA CS-FSTD(A), quoted from memory: Tt from the lever movement to 90 %,
  both within +-10 % or 0.25 s.

Where two tolerances are given, the less restrictive applies (Part 60 App. A Att. 2, section 2).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

from eval.response import Transient
from narxcal.support.errors import ConfigError

RulesName = Literal["paper", "part60", "icao"]

# Decimal times are not exact in binary: an error of exactly the tolerance passes.
_SLACK_S = 1e-9


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


RULES: dict[str, Rules] = {
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
    if name not in RULES:
        raise ConfigError(f"unknown rule set '{name}'", hint=f"Known rule sets: {', '.join(RULES)}")
    return RULES[name]


@dataclass(frozen=True)
class TimeCheck:
    """One of Ti and Tt, in seconds; `error_s` is model minus flight.

    `relative` is the error's size as a share of the flight's time, but of no less than the
    sampling interval: a shorter time is not resolved, and a driver that lags (a fuel meter) can
    make Ti zero or negative.
    """

    flight_s: float
    model_s: float
    error_s: float
    allowed_s: float
    relative: float
    ok: bool


@dataclass(frozen=True)
class Verdict:
    """Result of one event on one channel.

    `ok` is None where the flight's transient is not assessable. `reason` says why it is not, or
    why the model failed before its times could be compared (then `Ti` and `Tt` are None).
    """

    rules: str
    ok: bool | None
    Ti: TimeCheck | None = None
    Tt: TimeCheck | None = None
    reason: str | None = None


def compare_transients(flight: Transient, model: Transient, rules: Rules) -> Verdict:
    """Judge the model's transient against the flight's.

    Each curve is read between its own settled values, as on a regulator's over-plot: a wrong
    steady level, which RMSE shows, stays apart from wrong timing. The flight alone decides
    whether there is anything to assess; whatever is wrong with the model is a failure.
    """
    if flight.reason is not None:
        return Verdict(rules.name, None, reason=flight.reason)
    failure = _failure(flight, model, rules)
    if failure is not None:
        return Verdict(rules.name, ok=False, reason=f"model: {failure}")
    initial = _check(flight.Ti_s, model.Ti_s, rules.Ti, flight.dt_s)
    flight_s, model_s = (rules.total_s(one.Ti_s, one.Tt_s) for one in (flight, model))
    total = _check(flight_s, model_s, rules.Tt, flight.dt_s)
    return Verdict(rules.name, initial.ok and total.ok, initial, total)


def _failure(flight: Transient, model: Transient, rules: Rules) -> str | None:
    """Why the model cannot pass whatever its times are."""
    if math.isfinite(model.response):
        percent = 100.0 * model.response / flight.response
        if percent < 0.0:
            return (
                f"it moves by {model.response:.3g} where the flight moves by {flight.response:.3g}"
            )
        least = 100.0 * rules.least_model_share
        if percent < least:
            return (
                f"its response {abs(model.response):.3g} is {abs(percent):.0f} % of the flight's, "
                f"less than {least:.0f} %"
            )
    return model.reason


def _check(flight_s: float, model_s: float, tolerance: Tolerance, dt_s: float) -> TimeCheck:
    error_s = model_s - flight_s
    allowed_s = tolerance.allowed_s(flight_s)
    return TimeCheck(
        flight_s=flight_s,
        model_s=model_s,
        error_s=error_s,
        allowed_s=allowed_s,
        relative=abs(error_s) / max(abs(flight_s), dt_s),
        ok=abs(error_s) <= allowed_s + _SLACK_S,
    )


def time_bands(flight: Transient, model: Transient, verdict: Verdict) -> list[tuple[float, float]]:
    """(start, stop) on the log's clock in which the model may reach 10 % and 90 %.

    Empty for a transient that was not assessed. Where the rule set counts Tt from 10 %, the
    second band starts from the model's own t10, so that a curve inside its bands is one that
    passed; a model that could not be compared is taken to be on time there.
    """
    if verdict.ok is None:
        return []
    if verdict.Ti is None or verdict.Tt is None:
        used = rules(verdict.rules)
        total_s = used.total_s(flight.Ti_s, flight.Tt_s)
        bands = (
            (flight.t10_s, used.Ti.allowed_s(flight.Ti_s)),
            (flight.t90_s, used.Tt.allowed_s(total_s)),
        )
    else:
        bands = (
            (model.t10_s - verdict.Ti.error_s, verdict.Ti.allowed_s),
            (model.t90_s - verdict.Tt.error_s, verdict.Tt.allowed_s),
        )
    return [(centre_s - allowed_s, centre_s + allowed_s) for centre_s, allowed_s in bands]
