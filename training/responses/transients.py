"""Ti and Tt of every event of a log: what is assessed, what passes, why not, and how many.

Models of a speed are chosen by the loss of their free runs over held-out logs. With r an error of
Ti or Tt over its tolerance, the loss of a transient is the mean of both

    r^2 / (1 + r^2)

which is 1/2 at the edge of the tolerance and bounded, so that one wild transient does not decide
(Geman and McClure 1987). A model whose response cannot be read has loss 1.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Literal, NamedTuple

import numpy as np
from pydantic import Field

from data_prep.events import Event, Speed, find_events
from data_prep.log import Log
from narxcal.channels import described
from narxcal.support.arrays import BoolArray, FloatArray, IntArray
from narxcal.support.errors import ConfigError, DataError
from training.config import RunConfig
from training.responses.response import Reading, Transient, TransientConfig, measure_transient
from training.responses.rules import (
    DataSource,
    Rules,
    RulesName,
    TimeCheck,
    Verdict,
    compare_transients,
    rules,
)

# A measured figure in a reason; reasons that differ in nothing else are counted together.
_FIGURE = re.compile(r"-?\d+(\.\d+)?(e[+-]?\d+)?")

# What makes a transient of such a reason readable.
_TO_DO = {
    "samples up to the move": ": raise before_s of [evaluate.transients]",
    "samples at the end": ": raise after_s of [evaluate.transients]",
}
# In the channel's unit: some thirty times the noise of recorded channels, so that 10 % of the
# response is well above it.
LEAST_RESPONSE = {"N1_pct": 5.0, "N2_pct": 3.0, "EGT_C": 30.0}


class TransientsConfig(Reading):
    """Which channels are judged by which rules, and how their transients are read.

    The rules are written for rapid movements: `speeds = ["fast"]` keeps to those, while by
    default every movement is judged. `data_source` says where the validation data come from: those
    of an "engineering" simulator narrow the tolerances. `least_response` (channel -> value in its
    unit) adds to and overrides the built-in values.
    """

    rules: RulesName = "paper"
    channels: tuple[str, ...] = ("N1_pct", "N2_pct")
    speeds: tuple[Speed, ...] = ("fast", "slow", "small")
    data_source: DataSource = "flight"
    least_response: Mapping[str, float] = Field(default_factory=dict)

    @property
    def rule_set(self) -> Rules:
        """The rules with the tolerances for the source of the data."""
        return rules(self.rules).for_data(self.data_source)

    def reading_of(self, channel: str) -> TransientConfig:
        """How one channel is read; `ConfigError` if its least response is not known."""
        least = {**LEAST_RESPONSE, **self.least_response}
        if channel not in least:
            raise ConfigError(
                "the smallest response to assess is not set",
                channel=channel,
                hint=f"Set least_response.{channel}",
            )
        return TransientConfig(
            reading=self.reading,
            before_s=self.before_s,
            after_s=self.after_s,
            least_response=least[channel],
            unit=described(channel).unit,
        )


@dataclass(frozen=True, eq=False)
class Overlay:
    """Flight and free-run model of one log, both `(time, channel)`, on `time_s (time,)`.

    `inputs_known (time,)` is false where an input of the model is missing: nothing is assessed
    there. Elsewhere a model value that is not finite is a failure of the model.
    """

    time_s: FloatArray
    flight: FloatArray
    model: FloatArray
    channels: tuple[str, ...]
    inputs_known: BoolArray | None = None

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
        """One entry of `events` in `evaluate.json`; times in seconds."""
        verdict = self.verdict
        total_s = verdict.rules.total_s(self.flight.Ti_s, self.flight.Tt_s)
        return {
            "start_s": self.start_s,
            "label": ("push", "pull")[self.label],
            "speed": self.speed,
            "channel": self.channel,
            "ok": verdict.ok,
            "reason": verdict.reason,
            "Ti": _time_row(verdict.Ti, self.flight.Ti_s, verdict.ok),
            "Tt": _time_row(verdict.Tt, total_s, verdict.ok),
            "raw": {"flight": asdict(self.flight), "model": asdict(self.model)},
        }


@dataclass(frozen=True)
class AssessedEvent:
    """One event with its assessments, at most one per channel; none where there is no model."""

    event: Event
    assessments: tuple[Assessment, ...] = ()

    @property
    def ok(self) -> bool | None:
        """True if every channel that could be assessed passes, None if none could."""
        verdicts = [one.verdict.ok for one in self.assessments if one.verdict.ok is not None]
        return all(verdicts) if verdicts else None

    @property
    def severity(self) -> float:
        """Largest error in units of what is allowed; infinite for a failure without times."""
        worst = 0.0
        for verdict in (one.verdict for one in self.assessments):
            if verdict.ok is None:
                continue
            if verdict.Ti is None or verdict.Tt is None:
                return float("inf")
            for check in (verdict.Ti, verdict.Tt):
                worst = max(worst, abs(check.error_s) / max(check.allowed_s, 1e-9))
        return worst

    @property
    def move(self) -> str:
        """`fast push`, `slow pull`."""
        return f"{self.event.speed} {('push', 'pull')[self.event.label]}"

    def of(self, channel: str) -> Assessment | None:
        return next((one for one in self.assessments if one.channel == channel), None)


def assess_events(
    events: Sequence[Event], overlay: Overlay, config: TransientsConfig
) -> list[Assessment]:
    """Judge every event on every configured channel that `overlay` has, event by event."""
    return [each for one in assessed(events, overlay, config) for each in one.assessments]


def assessed(
    events: Sequence[Event], overlay: Overlay, config: TransientsConfig
) -> tuple[AssessedEvent, ...]:
    """As `assess_events`, with the assessments of each event together."""
    columns = [k for k, name in enumerate(overlay.channels) if name in config.channels]
    return tuple(
        AssessedEvent(event, tuple(_assess(event, overlay, k, config) for k in columns))
        for event in events
    )


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
    # The flight decides what can be assessed; a model that is just below the limits of its
    # reading, next to a flight just above them, must not fail for that.
    own = reading.model_copy(
        update={"least_response": 0.0, "drift_share": 2.0 * reading.drift_share}
    )
    model = measure_transient(time_s, overlay.model[rows, column], t0_s, own)
    verdict = compare_transients(flight, model, config.rule_set)
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
        return {"flight": flight_s, "model": None, "error": None, "allowed": None, "ok": ok}
    return {
        "flight": check.flight_s,
        "model": check.model_s,
        "error": check.error_s,
        "allowed": check.allowed_s,
        "ok": check.ok,
    }


class Responses(NamedTuple):
    """Rows (transients,) where the lever moves; of each and output the loss, and 1 for a pass.

    NaN where the rules of [evaluate] judge none.
    """

    rows: IntArray
    losses: FloatArray
    passed: FloatArray


def responses(log: Log, model: FloatArray, names: Sequence[str], config: RunConfig) -> Responses:
    """Judge the transients of a free run (time, outputs) of the outputs `names`."""
    settings = TransientsConfig.parse(config.evaluate.get("transients", {}))
    events = find_events(log, config.events.for_log(log, names))
    overlay = Overlay(log.time_s, log.matrix(names), model, tuple(names))
    losses, passed = np.full((2, len(events), len(names)), np.nan)
    for row, one in enumerate(assessed(events, overlay, settings)):
        for each in one.assessments:
            if each.verdict.ok is not None:
                at = row, names.index(each.channel)
                losses[at], passed[at] = _loss(each.verdict), each.verdict.ok
    return Responses(np.array([event.start for event in events], dtype=np.int64), losses, passed)


def _loss(verdict: Verdict) -> float:
    if verdict.Ti is None or verdict.Tt is None:
        return 1.0
    found = 0.0
    for check in (verdict.Ti, verdict.Tt):
        square = (check.error_s / max(check.allowed_s, 1e-9)) ** 2
        found += 0.5 * square / (1.0 + square)
    return found


@dataclass(frozen=True)
class Tally:
    """Counts and means over assessments; a mean over nothing is None.

    `mean_relative_*_pct` averages `TimeCheck.relative`; an event that the model failed before
    its times could be compared enters with 100 %, so that failing never improves the mean.
    `mean_absolute_*_s` averages over the `compared` events. Events that are not assessable enter
    neither count nor mean; `not_assessable` is how many those are.
    """

    events: int
    assessed: int
    passed: int
    compared: int
    not_assessable: int
    mean_relative_Ti_pct: float | None
    mean_relative_Tt_pct: float | None
    mean_absolute_Ti_s: float | None
    mean_absolute_Tt_s: float | None

    @property
    def passed_pct(self) -> float | None:
        """Passed among assessed events, in percent."""
        return 100.0 * self.passed / self.assessed if self.assessed else None

    def row(self) -> dict[str, Any]:
        return {**asdict(self), "passed_pct": self.passed_pct}


def tally(assessments: Sequence[Assessment]) -> Tally:
    """Count over any selection of assessments: one log, one channel, pushes only, all."""
    verdicts = [one.verdict for one in assessments]
    assessable = [verdict for verdict in verdicts if verdict.ok is not None]
    initial, total = _checks(assessable, "Ti"), _checks(assessable, "Tt")
    return Tally(
        events=len(verdicts),
        assessed=len(assessable),
        passed=sum(verdict.ok is True for verdict in assessable),
        compared=sum(check is not None for check in initial),
        not_assessable=len(verdicts) - len(assessable),
        mean_relative_Ti_pct=_mean(_percent(check) for check in initial),
        mean_relative_Tt_pct=_mean(_percent(check) for check in total),
        mean_absolute_Ti_s=_mean(abs(c.error_s) for c in initial if c is not None),
        mean_absolute_Tt_s=_mean(abs(c.error_s) for c in total if c is not None),
    )


def not_assessable(assessments: Sequence[Assessment], *, figures: bool = False) -> dict[str, int]:
    """Reason -> number of transients that could not be assessed for it.

    A measured figure is `..`, in the order of the reasons; with `figures` it is its range over the
    transients, with what to do, and the most frequent reason comes first.
    """
    found: dict[str, list[str]] = {}
    for each in assessments:
        if each.verdict.ok is None:
            reason = str(each.verdict.reason)
            number = _FIGURE.search(reason)
            alike = (
                re.sub(r" of \d+ samples| samples?\b", " samples", reason) if figures else reason
            )
            found.setdefault(_FIGURE.sub("..", alike, count=1), []).append(
                number[0] if number else ""
            )
    if not figures:
        return {reason: len(found[reason]) for reason in sorted(found)}
    return {
        _ranged(reason, numbers): len(numbers)
        for reason, numbers in sorted(found.items(), key=lambda one: (-len(one[1]), one[0]))
    }


def _ranged(reason: str, numbers: Sequence[str]) -> str:
    ends = (
        []
        if not numbers[0]
        else list(dict.fromkeys((min(numbers, key=float), max(numbers, key=float))))
    )
    hint = next((text for words, text in _TO_DO.items() if words in reason), "")
    return reason.replace("..", " to ".join(ends), 1) + hint


def _checks(verdicts: Sequence[Verdict], name: Literal["Ti", "Tt"]) -> list[TimeCheck | None]:
    return [getattr(verdict, name) for verdict in verdicts]


def _percent(check: TimeCheck | None) -> float:
    return 100.0 if check is None else 100.0 * check.relative


def _mean(values: Iterable[float]) -> float | None:
    known = list(values)
    return sum(known) / len(known) if known else None
