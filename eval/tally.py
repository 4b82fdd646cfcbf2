"""Counts and mean errors over many Ti/Tt assessments."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from eval.transients import Assessment
from eval.verdict import TimeCheck, Verdict


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
        """Return the tally as JSON-able values."""
        return {**asdict(self), "passed_pct": self.passed_pct}


def tally(assessments: Sequence[Assessment]) -> Tally:
    """Count over any selection of assessments: one log, one channel, pushes only, all."""
    verdicts = [one.verdict for one in assessments]
    outcome = Counter(verdict.ok for verdict in verdicts)
    assessed = [verdict for verdict in verdicts if verdict.ok is not None]
    compared = [verdict for verdict in assessed if verdict.Ti is not None]
    return Tally(
        events=len(verdicts),
        assessed=len(assessed),
        passed=outcome[True],
        compared=len(compared),
        not_assessable=outcome[None],
        mean_relative_Ti_pct=_mean_relative_pct(assessed, _initial),
        mean_relative_Tt_pct=_mean_relative_pct(assessed, _total),
        mean_absolute_Ti_s=_mean_absolute_s(compared, _initial),
        mean_absolute_Tt_s=_mean_absolute_s(compared, _total),
    )


def _initial(verdict: Verdict) -> TimeCheck | None:
    return verdict.Ti


def _total(verdict: Verdict) -> TimeCheck | None:
    return verdict.Tt


_Pick = Callable[[Verdict], TimeCheck | None]


def _mean_relative_pct(assessed: Sequence[Verdict], pick: _Pick) -> float | None:
    shares = [1.0 if check is None else check.relative for check in map(pick, assessed)]
    return 100.0 * sum(shares) / len(shares) if shares else None


def _mean_absolute_s(compared: Sequence[Verdict], pick: _Pick) -> float | None:
    errors = [abs(check.error_s) for check in map(pick, compared) if check is not None]
    return sum(errors) / len(errors) if errors else None
