"""Ti/Tt validator over the events of a log: what is assessed, what passes, and why not."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from data_prep.events import Event, Speed
from eval.response import ReadingMode, Transient, TransientConfig, measure_transient
from eval.rules import RulesName
from eval.rules import rules as rules_of
from eval.verdict import TimeCheck, Verdict, compare_transients
from narxcal.channels import channel as channel_of
from narxcal.support.arrays import FloatArray
from narxcal.support.errors import ConfigError, DataError
from narxcal.support.settings import Section

__all__ = [
    "Assessment",
    "Overlay",
    "TimeCheck",
    "Transient",
    "TransientConfig",
    "TransientsConfig",
    "Verdict",
    "assess_events",
    "compare_transients",
    "measure_transient",
]


# In the channel's unit: some thirty times the recording noise of FACTS.md A8, so that 10 % of
# the response stands clear of it.
LEAST_RESPONSE = {"N1_pct": 5.0, "N2_pct": 3.0, "EGT_C": 30.0}


class TransientsConfig(Section):
    """Which channels are judged by which rules, and how their transients are read.

    The rules are written for rapid movements: `speeds = ["fast"]` keeps to those, while by
    default every movement is judged and none is spared. `least_response` (channel -> value in
    its unit) adds to and overrides the built-in values.
    """

    rules: RulesName = "paper"
    reading: ReadingMode = "interpolated"
    channels: tuple[str, ...] = ("N1_pct", "N2_pct")
    speeds: tuple[Speed, ...] = ("fast", "slow", "small")
    before_s: float = Field(default=1.0, gt=0.0)
    after_s: float = Field(default=1.0, gt=0.0)
    least_response: Mapping[str, float] = Field(default_factory=dict)

    def reading_of(self, channel: str) -> TransientConfig:
        """Return the reading of one channel; `ConfigError` if its least response is not known."""
        least = {**LEAST_RESPONSE, **self.least_response}
        if channel not in least:
            raise ConfigError(
                "the smallest response worth assessing is not known",
                channel=channel,
                hint=f"Set least_response.{channel}",
            )
        return TransientConfig(
            reading=self.reading,
            before_s=self.before_s,
            after_s=self.after_s,
            least_response=least[channel],
            unit=channel_of(channel).unit,
        )


@dataclass(frozen=True, eq=False)
class Overlay:
    """Flight and free-run model of one log, both `(time, channel)`, on `time_s (time,)`.

    `inputs_known (time,)` is false where the model's inputs are missing: it was not asked there.
    Where it was asked, a model value that is not finite is the model's failure.
    """

    time_s: FloatArray
    flight: FloatArray
    model: FloatArray
    channels: tuple[str, ...]
    inputs_known: NDArray[np.bool_] | None = None

    def __post_init__(self) -> None:
        shape = (len(self.time_s), len(self.channels))
        if self.flight.shape != shape or self.model.shape != shape:
            raise DataError(
                f"expected flight and model of shape (time, channel) = {shape}, "
                f"got {self.flight.shape} and {self.model.shape}"
            )


@dataclass(frozen=True)
class Assessment:
    """One event on one channel: both readings and the verdict."""

    start_s: float
    label: int
    speed: str
    channel: str
    flight: Transient
    model: Transient
    verdict: Verdict

    def row(self) -> dict[str, Any]:
        """Return the JSON row of `evaluate.json`; times in seconds, None where there is none."""
        verdict = self.verdict
        total_s = rules_of(verdict.rules).total_s(self.flight.Ti_s, self.flight.Tt_s)
        return {
            "start_s": self.start_s,
            "label": ("push", "pull")[self.label],
            "speed": self.speed,
            "channel": self.channel,
            "ok": verdict.ok,
            "reason": verdict.reason,
            "Ti": _time_row(verdict.Ti, self.flight.Ti_s, verdict.ok),
            "Tt": _time_row(verdict.Tt, total_s, verdict.ok),
            "raw": {"flight": _raw(self.flight), "model": _raw(self.model)},
        }


def assess_events(
    events: Sequence[Event], overlay: Overlay, config: TransientsConfig
) -> list[Assessment]:
    """Judge every event on every configured channel that `overlay` has, event by event."""
    return [
        _assess(event, overlay, column, config)
        for event in events
        for column, name in enumerate(overlay.channels)
        if name in config.channels
    ]


def _assess(event: Event, overlay: Overlay, column: int, config: TransientsConfig) -> Assessment:
    reading = config.reading_of(overlay.channels[column])
    t0_s = float(overlay.time_s[event.start])
    first = int(np.searchsorted(overlay.time_s, t0_s - reading.before_s - 1e-6))
    rows = slice(first, event.stop)
    time_s = overlay.time_s[rows]
    flight = measure_transient(time_s, overlay.flight[rows, column], t0_s, reading)
    obstacle = _obstacle(event, config) or _unknown_inputs(overlay, rows)
    if obstacle is not None:
        flight = Transient(t0_s=t0_s, dt_s=flight.dt_s, reason=obstacle)
    # What is worth assessing, and whether it is settled enough, is decided on the flight. A model
    # beside a flight that just passes must not fail for a hair's breadth.
    own = reading.model_copy(
        update={"least_response": 0.0, "drift_share": 2.0 * reading.drift_share}
    )
    model = measure_transient(time_s, overlay.model[rows, column], t0_s, own)
    verdict = compare_transients(flight, model, rules_of(config.rules))
    name = overlay.channels[column]
    return Assessment(t0_s, event.label, event.speed, name, flight, model, verdict)


def _obstacle(event: Event, config: TransientsConfig) -> str | None:
    """Why the event as a whole cannot be assessed on any channel."""
    if event.speed not in config.speeds:
        return f"the movement is {event.speed}; only {' and '.join(config.speeds)} ones are judged"
    if event.interrupted:
        return "the lever moves again before the response settles"
    if not event.settled:
        return "the response does not settle"
    return None


def _unknown_inputs(overlay: Overlay, rows: slice) -> str | None:
    if overlay.inputs_known is None or overlay.inputs_known[rows].all():
        return None
    known = overlay.inputs_known[rows]
    return f"inputs are missing at {np.count_nonzero(~known)} of {len(known)} samples"


def _time_row(check: TimeCheck | None, flight_s: float, ok: bool | None) -> dict[str, Any]:
    if check is None:
        return {"flight": _known(flight_s), "model": None, "error": None, "allowed": None, "ok": ok}
    return {
        "flight": check.flight_s,
        "model": check.model_s,
        "error": check.error_s,
        "allowed": check.allowed_s,
        "ok": check.ok,
    }


def _raw(transient: Transient) -> dict[str, float | str | None]:
    return {
        name: _known(value) if isinstance(value, float) else value
        for name, value in asdict(transient).items()
    }


def _known(value: float) -> float | None:
    """JSON has no NaN."""
    return value if math.isfinite(value) else None
