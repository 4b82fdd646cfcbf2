"""The Ti/Tt rule sets, and the verdict on one transient: how far the model may be off the flight.

Ti is the time from the lever movement to 10 % of the response; where Tt begins, and whether its
tolerance has a floor, depends on the rule set. Where two tolerances are given, the less restrictive
applies. Each `Clause` says whether its text was read in the edition that it names: what was not
is printed as unverified.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Literal

from narxcal.support.errors import ConfigError
from training.responses.response import Transient

RulesName = Literal["paper", "part60", "part60-2016", "cs-fstd", "icao9625"]
DataSource = Literal["flight", "engineering"]
# Of the tolerance for flight-test data (14 CFR Part 60 App. A Att. 2 section 9, edition 1-1-19).
TOLERANCE_SHARE: dict[DataSource, float] = {"flight": 1.0, "engineering": 0.4}

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

    def scaled(self, share: float) -> Tolerance:
        return Tolerance(self.share * share, self.floor_s * share)

    def __str__(self) -> str:
        floor = f" or {self.floor_s:g} s" if self.floor_s else ""
        return f"±{100.0 * self.share:g} %{floor}"


@dataclass(frozen=True)
class Clause:
    """What a rule set says about one subject, in our words.

    `read` names the edition that it was read in; empty for what is recalled or inferred, which
    has to be checked against the reader's own edition.
    """

    subject: str
    text: str
    read: str = ""

    @property
    def mark(self) -> str:
        """How far the clause can be relied on, in words."""
        return f"read in {self.read}" if self.read else "unverified; check your edition"


@dataclass(frozen=True)
class Manoeuvre:
    """The test of one direction: its number, and what is to be flown (`ground`: with WOW)."""

    number: str
    title: str
    condition: str
    movement: str
    ground: bool | None = None


_ACCELERATION = Manoeuvre(
    "1.f.1", "Engine acceleration", "approach or landing",
    "flight idle to go-around power, slam", ground=False,
)  # fmt: skip
_DECELERATION = Manoeuvre(
    "1.f.2", "Engine deceleration", "ground",
    "maximum take-off power to 90 % decay of it, slam", ground=True,
)  # fmt: skip


@dataclass(frozen=True)
class Rules:
    """One rule set; `tt_origin` says whether Tt starts at 10 % or at the lever movement.

    `manoeuvres` are those of a push and of a pull. With `one_decides` a single critical engine
    parameter gives the result of a test and the others support it. `Tt_otherwise` is a second
    reading of the tolerance of Tt where the text is unresolved: `Tt`, the stricter one, decides.
    `least_model_share` is ours, not the regulator's: each curve is read between its own settled
    values, so a model that hardly moves could still be "in time". A model whose response is a
    smaller share of the flight's than this fails.
    """

    name: RulesName
    source: str
    tt_origin: Literal["t10", "lever"]
    clauses: tuple[Clause, ...]
    Ti: Tolerance = Tolerance(0.10, 0.25)
    Tt: Tolerance = Tolerance(0.10, 0.25)
    manoeuvres: tuple[Manoeuvre, Manoeuvre] = (_ACCELERATION, _DECELERATION)
    one_decides: bool = True
    Tt_otherwise: Tolerance | None = None
    least_model_share: float = 0.5

    def total_s(self, initial_s: float, rise_s: float) -> float:
        """Return Tt in seconds, from Ti and the time from 10 % to 90 %."""
        return rise_s if self.tt_origin == "t10" else initial_s + rise_s

    def for_data(self, source: DataSource) -> Rules:
        """Return the rule set with the tolerances for validation data of this source."""
        share, other = TOLERANCE_SHARE[source], self.Tt_otherwise
        return replace(
            self,
            Ti=self.Ti.scaled(share),
            Tt=self.Tt.scaled(share),
            Tt_otherwise=None if other is None else other.scaled(share),
        )


_TABLE = "14 CFR Part 60 App. A, edition 1-1-14"
_ATTACHMENT = "14 CFR Part 60 App. A Att. 2, edition 1-1-19"
_GENERAL = (
    Clause("Two tolerances", "Of two values for one parameter the less restrictive may be used "
           "unless said otherwise.", _ATTACHMENT),
    Clause("Response", "10 % and 90 % are shares of the change between the settled levels before "
           "and after the movement."),
    Clause("Critical parameter", "The most appropriate measure of propulsive force of the engine; "
           "that one channel decides and the others support it is our inference.",
           "ICAO Doc 9625, 4th edition, corrigendum 1"),
    Clause("Related parameters", "All relevant parameters are shown; a mismatch is explained by "
           "related variables.", _ATTACHMENT),
    Clause("Between test points", "A model that is right only at its test points is not "
           "acceptable.", _ATTACHMENT),
    Clause("Validation data", "Unaltered but for known calibration errors and with the method "
           "explained here; re-scaling and digitising are allowed.", _TABLE),
    Clause("Engineering simulator", "Data of one narrow the tolerance to 40 % in general; an "
           "identified model alone is no engineering simulator (our inference).",
           _ATTACHMENT),
    Clause("Recurrent evaluation", "Results are plotted over the reference data, and over the "
           "master's run where that helps; no tolerance between runs; unexplained differences are "
           "investigated.", _TABLE),
)  # fmt: skip
_FROM_T10 = Clause("Ti and Tt", "Ti: from the first lever movement to 10 % of the response of a "
                   "critical engine parameter. Tt: from Ti to 90 % of it.")  # fmt: skip
_FROM_LEVER = Clause("Ti and Tt", "Both from the first lever movement: Ti to 10 %, Tt to 90 % of "
                     "the incremental response of the critical engine parameter.")  # fmt: skip
_BOTH_FLOORS = Clause("Tolerances", "Ti ±10 % or ±0.25 s; Tt ±10 % or ±0.25 s.")

_SETS = (
    Rules(
        name="paper",
        source="NARX dynamic calibration paper, section 3.2",
        tt_origin="t10",
        manoeuvres=(
            Manoeuvre("push", "Engine acceleration", "any", "lever advanced"),
            Manoeuvre("pull", "Engine deceleration", "any", "lever retarded"),
        ),
        clauses=(
            Clause("Ti and Tt", "Ti from the lever movement to 10 %, Tt from 10 % to 90 %, each "
                   "±10 % or ±0.25 s, in every judged channel.", "the paper, section 3.2"),
            _GENERAL[1],
        ),
        one_decides=False,
    ),
    Rules(
        name="part60",
        source="14 CFR Part 60 App. A Table A2A, 1.f.1 and 1.f.2 (1-1-14 edition)",
        tt_origin="t10",
        Tt=Tolerance(0.10, 0.0),
        clauses=(
            Clause("Tolerances", "Tt ±10 %, and Ti ±10 % or ±0.25 s; no floor for Tt.", _TABLE),
            _FROM_T10,
            *_GENERAL,
        ),
    ),
    Rules(
        name="part60-2016",
        source="14 CFR Part 60 as amended in 2016 (unverified)",
        tt_origin="lever",
        clauses=(_BOTH_FLOORS, _FROM_LEVER, *_GENERAL),
    ),
    Rules(
        name="cs-fstd",
        source="EASA CS-FSTD(A) Issue 2, AMC1 FSTD(A).300, 1.f.1 and 1.f.2 (unverified)",
        tt_origin="lever",
        Tt=Tolerance(0.10, 0.0),
        Tt_otherwise=Tolerance(0.10, 0.25),
        clauses=(
            Clause("Tolerances", "Ti ±10 % or ±0.25 s; Tt ±10 %, with or without a floor of "
                   "0.25 s: unresolved. Judged without; a sheet on which the other reading "
                   "differs shows both."),
            _FROM_LEVER,
            *_GENERAL,
            Clause("Master guide", "The approved guide becomes the master, the basis of recurrent "
                   "evaluations.", "EASA CS-FSTD(A) Issue 2"),
        ),
    ),
    Rules(
        name="icao9625",
        source="ICAO Doc 9625, engine acceleration and deceleration (unverified)",
        tt_origin="lever",
        clauses=(_BOTH_FLOORS, _FROM_LEVER, *_GENERAL),
    ),
)  # fmt: skip
RULES: dict[str, Rules] = {one.name: one for one in _SETS}


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

    rules: Rules
    ok: bool | None
    Ti: TimeCheck | None = None
    Tt: TimeCheck | None = None
    reason: str | None = None

    @property
    def otherwise(self) -> bool | None:
        """Result by the other reading of the tolerance of Tt; None where that is the same."""
        other = self.rules.Tt_otherwise
        if other is None or self.Ti is None or self.Tt is None:
            return None
        ok = self.Ti.ok and abs(self.Tt.error_s) <= other.allowed_s(self.Tt.flight_s) + _SLACK_S
        return ok if ok is not self.ok else None


def compare_transients(flight: Transient, model: Transient, rules: Rules) -> Verdict:
    """Judge the model's transient against the flight's.

    Each curve is read between its own settled values, as on a regulator's over-plot: a wrong
    steady level, which RMSE shows, stays apart from wrong timing. The flight alone decides
    whether there is anything to assess; whatever is wrong with the model is a failure.
    """
    if flight.reason is not None:
        return Verdict(rules, None, reason=flight.reason)
    failure = _failure(flight, model, rules)
    if failure is not None:
        return Verdict(rules, ok=False, reason=f"model: {failure}")
    initial = _check(flight.Ti_s, model.Ti_s, rules.Ti, flight.dt_s)
    flight_s, model_s = (rules.total_s(one.Ti_s, one.Tt_s) for one in (flight, model))
    total = _check(flight_s, model_s, rules.Tt, flight.dt_s)
    return Verdict(rules, initial.ok and total.ok, initial, total)


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
        used = verdict.rules
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
