"""Judges one model transient against the flight's under a rule set."""

from __future__ import annotations

import math
from dataclasses import dataclass

from eval.response import Transient
from eval.rules import Rules, Tolerance

# Decimal times are not exact in binary: an error of exactly the tolerance passes.
_SLACK_S = 1e-9


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
    """Outcome of one event on one channel.

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
