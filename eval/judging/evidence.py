"""What a verdict rests on: which logs, how much of them, how many events, and errors like before.

A PASS is a statement about flights to come. It takes, besides transients within the rules,

| statement | needs |
|---|---|
| new logs | none of them holds samples that the model was trained on or stopped by |
| judged share | `least_judged_pct` of each output of each log: what cleaning, faults and gaps of inputs leave |
| events | `least_events` pushes and as many pulls, assessed in each channel that the rules judge |
| error | RMSE within what held-out training logs allow, and no less than a tenth of the least of them |
| findings | nothing that contradicts the training logs for certain |

Of models of which half of the transients pass, 1.6 % pass 3 pushes and 3 pulls of 3 and 3; 2 and 2
are passed by 6 %. Hence `least_events` = 3.

With x_1 .. x_n the ln RMSE of n held-out training logs, that of another one is allowed to be

    mean x + t(1 - 0.05 / m, p + n - 1) s sqrt(1 + 1 / n),
    s^2 = (p s_0^2 + sum (x_i - mean x)^2) / (p + n - 1)

for m outputs. s_0 = 0.35 is the scatter of ln RMSE between logs of one model, which counts as p = 3
logs (0.18 to 0.36 over the held-out logs of `make demo` and of the two Citation flights). Errors of
logs that the model was fitted to are too small: they count twice where there are no others.

The errors on held-out logs hold the noise of the sensors. A tenth of the least of them is ln 10 / s_0 =
6.6 scatters away: no model earns that, but its own output in the place of a measurement does.
"""  # noqa: E501 -- a table

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Final

import numpy as np
from scipy.stats import beta
from scipy.stats import t as student

from data_prep.cleaning.identity import Shared
from data_prep.log import Log
from eval.judging.free_run import FreeRun
from narxcal.calibration.run_record import RunRecord
from narxcal.channels import described, symbol
from training.responses.transients import Assessment

BLANK: Final = "blank"  # why `data_prep.sources.grid` filled a sample: no row held it
_SCATTER, _PRIOR_LOGS, _FALSE_ALARMS = 0.35, 3.0, 0.05
_COPIED: Final = 0.1  # of the least known error: no error of a measurement
_FITTED: Final = 2.0  # times the error on logs that the model was fitted to
_RESOLUTION: Final = 1e-3  # of the largest value: smaller errors are those of a recorder
_DIRECTIONS: Final = ("push", "pull")
_CONFIDENCE: Final = 0.9


@dataclass(frozen=True)
class ErrorCheck:
    """RMSE of one output over one log, and the largest that `logs` held-out logs allow.

    `allowed` is None where the run stores no errors. `fitted` says that those logs were fitted to,
    `least` is the smallest of their errors.
    """

    channel: str
    rmse: float
    usual: float | None
    allowed: float | None
    logs: int
    fitted: bool
    least: float = 0.0

    @property
    def copied(self) -> bool:
        """Whether the error is too small for a measurement with the noise of its sensor."""
        return self.rmse < _COPIED * self.least

    @property
    def ok(self) -> bool | None:
        """Whether the error is like before; None where that is not known."""
        if self.allowed is None or not math.isfinite(self.rmse):
            return None
        return self.rmse <= self.allowed

    @property
    def words(self) -> str:
        """What is wrong, without a full stop."""
        unit = described(self.channel).unit
        whose = "training logs" if self.fitted else "held-out training logs"
        return (
            f"{symbol(self.channel)} RMSE {self.rmse:.3g} {unit}, {self.usual or 0.0:.3g} is usual "
            f"on {self.logs} {whose} and at most {self.allowed or 0.0:.3g} like them"
        )


def error_checks(record: RunRecord, run: FreeRun, rmse: Mapping[str, float]) -> list[ErrorCheck]:
    """Compare the errors of one log with those of the logs that training held out."""
    found = []
    for name, error in rmse.items():
        known, fitted = _known_errors(record, name)
        values = run.measured[:, run.channels.index(name)]
        floor = _RESOLUTION * float(np.nanmax(np.abs(values))) if np.isfinite(values).any() else 0.0
        usual, allowed = _allowed(known, len(rmse), floor)
        if fitted and usual is not None and allowed is not None:
            allowed = max(_FITTED * allowed, floor)
        least = min(known, default=0.0)
        found.append(ErrorCheck(name, error, usual, allowed, len(known), fitted, least))
    return found


def _known_errors(record: RunRecord, name: str) -> tuple[list[float], bool]:
    """RMSE of the logs that training held out, and whether they were fitted to all the same."""
    held = record.held_out
    if held is None:
        return [], True
    return [each for each in held.rmse.get(name, ()) if math.isfinite(each)], held.fitted


def _allowed(
    known: Sequence[float], outputs: int, floor: float
) -> tuple[float | None, float | None]:
    """Usual and largest RMSE of another log; None without any held-out one."""
    if not known:
        return None, None
    x = np.log(np.maximum(known, 1e-12))
    count = len(x)
    degrees = _PRIOR_LOGS + count - 1.0
    square = (_PRIOR_LOGS * _SCATTER**2 + float(np.sum((x - x.mean()) ** 2))) / degrees
    tail = float(student.isf(_FALSE_ALARMS / outputs, degrees))
    usual = float(np.exp(x.mean()))
    return usual, max(usual * math.exp(tail * math.sqrt(square * (1.0 + 1.0 / count))), floor)


def judged_shares(run: FreeRun, names: Sequence[str]) -> dict[str, float]:
    """Share of each output's samples that are scored, of all that its log spans after the trim."""
    log, rows = run.log, run.scored[run.scored_from :]
    shares = {}
    for name in names:
        known = np.isfinite(log[name])[run.scored_from :] & rows
        filled = sum(
            entry.samples
            for entry in log.audit.entries
            if (entry.channel, entry.action, entry.reason) == (name, "filled", BLANK)
        )
        # Of samples on a line over blanks as many are scored as of all others.
        share = known.sum() / max(len(rows), 1) * (1.0 - min(1.0, filled / len(log)))
        shares[name] = float(share)
    return shares


def why_not_judged(log: Log, name: str) -> str:
    """What most of the samples of a channel were masked for; empty where nothing was."""
    reasons = dict(log.audit.masked().get(name, {}))
    for entry in log.audit.entries:
        if entry.channel == name and (entry.action, entry.reason) == ("filled", BLANK):
            reasons["rows are missing"] = reasons.get("rows are missing", 0) + entry.samples
    return max(reasons, key=lambda each: reasons[each], default="inputs are missing")


@dataclass(frozen=True)
class Count:
    """Transients of one channel in one direction."""

    channel: str
    direction: str
    passed: int
    assessed: int

    @property
    def plural(self) -> str:
        return {"push": "pushes", "pull": "pulls"}[self.direction]

    @property
    def at_least_pct(self) -> float:
        """Percentage that passes in the long run, at least, with 90 % confidence.

        One-sided limit of Clopper and Pearson (1934), which takes transients as independent.
        """
        if not self.passed:
            return 0.0
        low = beta.ppf(1.0 - _CONFIDENCE, self.passed, self.assessed - self.passed + 1)
        return 100.0 * float(low)

    def row(self) -> dict[str, Any]:
        return {**asdict(self), "at_least_pct": self.at_least_pct}


def counts(assessments: Sequence[Assessment], channels: Iterable[str]) -> list[Count]:
    """Assessed transients by channel and direction, also where there are none."""
    found = []
    for name in channels:
        for label, direction in enumerate(_DIRECTIONS):
            own = [
                each.verdict.ok
                for each in assessments
                if each.channel == name and each.label == label and each.verdict.ok is not None
            ]
            found.append(Count(name, direction, sum(own), len(own)))
    return found


def too_few(found: Sequence[Count], least: int, whose: str) -> list[str]:
    """Directions with fewer events than a verdict takes, in one line."""
    few = [
        f"{each.assessed or 'no'} {each.direction if each.assessed == 1 else each.plural} in "
        f"{symbol(each.channel)}"
        for each in found
        if each.assessed < least
    ]
    if not few:
        return []
    return [f"{whose}: {', '.join(few)}; a verdict takes {least} of each that can be assessed"]


def trained_words(log: str, role: str, shared: Shared | None) -> str:
    """Say that a log is no new one."""
    did = {"train": "trained on it", "validate": "stopped its training by it"}[role]
    which = "" if shared is None or shared.other == log else f" under the name {shared.other}"
    part = ""
    if shared is not None and shared.overlap.share < 0.995:
        part = f" ({100.0 * shared.overlap.share:.0f} % of it)"
    return f"{log}: the model was {did}{which}{part}; that earns no pass"


def contradictions(log: Log, names: Sequence[str]) -> list[str]:
    """Findings about the whole log in channels of the model: nothing is masked for them."""
    return [
        f"{log.name}: the log contradicts the training logs: {' and '.join(each.channels)} "
        f"{each.kind}, {each.evidence}"
        for each in log.findings
        if not each.local and {*names, "time_s"} & {*each.channels}
    ]
