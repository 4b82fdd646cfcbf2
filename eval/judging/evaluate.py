"""Evaluate a calibration on logs: one verdict of all of them.

`Evaluation.outcome` is the only place where pass or fail is decided: terminal, page, JSON and exit
code show it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

from data_prep.log import Finding, Log
from data_prep.prepare import cautions
from eval.judging.evidence import (
    Count,
    contradictions,
    counts,
    too_few,
    trained_words,
    why_not_judged,
)
from eval.judging.free_run import STEADY_STATE, outside_envelope
from eval.judging.log_evaluation import NEW, LogEvaluation, assess_log, tally_row
from eval.judging.outcome import Outcome, plural
from eval.judging.scores import ChannelScores, score
from eval.run_logs import EvaluateConfig, run_config
from narxcal.calibration.bundle import Bundle
from narxcal.calibration.certificate import Certificate
from narxcal.channels import described, symbol
from narxcal.support.errors import ConfigError
from narxcal.support.files import finite
from narxcal.support.progress import Progress, silent
from training.responses.transients import Assessment, Tally, not_assessable, tally
from training.screening.levels import LEAST_LOGS, LevelCheck, words

SCHEMA = "narxcal.evaluate/1"
_MOST_REASONS = 3  # why transients are not assessed, in the verdict


@dataclass(frozen=True, eq=False)
class Evaluation:
    """All logs and what they have to reach.

    `certificate` says whether the model settles at constant inputs; `cautions` are what a reader of
    the figures has to know.
    """

    logs: tuple[LogEvaluation, ...]
    config: EvaluateConfig
    trim: float | None = None
    certificate: Certificate | None = None
    cautions: tuple[str, ...] = ()

    @property
    def assessments(self) -> list[Assessment]:
        return [each for log in self.logs for each in log.assessments]

    @property
    def tally(self) -> Tally:
        return tally(self.assessments)

    @cached_property
    def pooled(self) -> dict[str, ChannelScores]:
        """Scores per channel over all logs as one recording."""
        return score([log.run for log in self.logs])

    @property
    def missed(self) -> list[str]:
        """Each requirement that is not met; empty if the evaluation is passed.

        Raises `ConfigError` for a bound on a channel that the model does not give.
        """
        return [*self.failed, *self.lacking]

    @cached_property
    def failed(self) -> list[str]:
        """What is wrong with the model, as far as these logs tell."""
        return [
            *self._hunting(),
            *self._failed_times(),
            *self._wrong_levels(),
            *self._large_errors(),
            *self._unusual_errors(),
        ]

    def _hunting(self) -> list[str]:
        found = self.certificate
        return [] if found is None or found.settled else [f"The model {found.words}"]

    @cached_property
    def lacking(self) -> list[str]:
        """What a verdict needs and these logs do not give."""
        return [
            *self._trained_on(),
            *self._unknown_errors(),
            *self._copied(),
            *self._loose_bounds(),
            *(text for one in self.logs for text in contradictions(one.log, one.run.channels)),
            *self._not_judged(),
            *self._too_few_events(),
        ]

    def _trained_on(self) -> list[str]:
        return [
            trained_words(one.log.name, one.role, one.shared)
            for one in self.logs
            if one.role in {"train", "validate"}
        ]

    def _unknown_errors(self) -> list[str]:
        checks = [each for one in self.logs for each in one.errors]
        unknown = dict.fromkeys(symbol(each.channel) for each in checks if each.usual is None)
        why = "the run has no record of errors on held-out logs: train it anew"
        return [f"{', '.join(unknown)}: {why}"] if unknown else []

    def _copied(self) -> list[str]:
        """Outputs that a sensor with noise cannot have measured."""
        return [
            f"{one.log.name}: {symbol(each.channel)} is no measurement: RMSE {each.rmse:.3g} "
            f"{described(each.channel).unit}, its noise alone leaves more ({each.least:.3g} is the "
            f"least of {each.logs} held-out training logs)"
            for one in self.logs
            for each in one.errors
            if each.copied
        ]

    def _loose_bounds(self) -> list[str]:
        """Bounds that the steady-state model alone would meet."""
        texts = [
            f"largest_rmse.{name} = {bound:g} is no bound: the steady state alone has RMSE "
            f"{self.pooled[name].steady_state_rmse:.3g}"
            for name, bound in self.config.largest_rmse.items()
            if name in self.pooled and bound >= self.pooled[name].steady_state_rmse
        ]
        static = [one.baselines[STEADY_STATE] for one in self.logs if STEADY_STATE in one.baselines]
        assessed, least = sum(each.assessed for each in static), self.config.least_passed_pct
        share = 100.0 * sum(each.passed for each in static) / max(assessed, 1)
        if "least_passed_pct" in self.config.changed and 0.0 < least <= share:
            texts.append(
                f"least_passed_pct = {least:g} is no bound: of the steady state alone {share:.1f} "
                "% pass"
            )
        return texts

    def _not_judged(self) -> list[str]:
        """Outputs of which too little is judged, in one count over cleaning, faults and gaps."""
        least = self.config.least_judged_pct
        return [
            f"{one.log.name}: {name} is not assessable, {100.0 * share:.0f} % of it is judged "
            f"({why_not_judged(one.log, name)}), at least {least:g} % have to be"
            for one in self.logs
            for name, share in one.judged.items()
            if 100.0 * share < least
        ]

    def _unusual_errors(self) -> list[str]:
        """Outputs with a larger error than the held-out logs allow, unless a bound is set."""
        bounded = self.config.largest_rmse
        return [
            f"{one.log.name}: {each.words}"
            for one in self.logs
            for each in one.errors
            if each.ok is False and each.channel not in bounded
        ]

    def _too_few_events(self) -> list[str]:
        """Engines with fewer events than a verdict takes, or none with the reason.

        `least_passed_pct = 0` demands no transients where errors are bounded instead.
        """
        if self.config.least_passed_pct == 0.0 and self.config.largest_rmse:
            return []
        texts = []
        for engine in dict.fromkeys(one.log.source.engine for one in self.logs):
            own = [one for one in self.logs if one.log.source.engine == engine]
            found = [each for one in own for each in one.assessments]
            whose = f"Ti/Tt of engine {engine}" if engine else "Ti/Tt"
            rated = self.config.transients.channels
            channels = [name for name in rated if name in own[0].run.channels]
            if not any(each.verdict.ok is not None for each in found):
                none = "no event was found" if channels else _none_rated(rated, own[0].run.channels)
                most = next(iter(not_assessable(found, figures=True)), none)
                texts.append(f"{whose}: no transient could be assessed ({most})")
                continue
            texts += too_few(counts(found, channels), self.config.least_events, whose)
        return texts

    @property
    def counts(self) -> list[Count]:
        channels = dict.fromkeys(name for one in self.logs for name in one.run.channels)
        judged = [name for name in self.config.transients.channels if name in channels]
        return counts(self.assessments, judged)

    @property
    def findings(self) -> list[Finding]:
        return [each for log in self.logs for each in log.log.findings]

    def _failed_times(self) -> list[str]:
        found, least = self.tally, self.config.least_passed_pct
        if found.passed_pct is None or found.passed_pct >= least:
            return []
        share = f"({found.passed_pct:.1f} %), at least {least:g} % have to"
        return [f"Ti/Tt: {found.passed} of {found.assessed} transients pass {share}"]

    def _wrong_levels(self) -> list[str]:
        return [
            f"{one.log.name}: level error of {words(each)}, {each.allowed:.3g} is the spread of "
            f"{each.held_out_logs} held-out training logs"
            for one in self.logs
            for each in one.levels
            if each.ok is False
        ]

    @property
    def level_cautions(self) -> list[str]:
        """Levels that can't be judged, with their sizes, and lags beyond the spread."""
        found = self._open_levels()
        for one in self.logs:
            found += [
                f"{one.log.name}: {each.channel} is {abs(each.lag_s):.2g} s "
                f"{'late' if each.lag_s > 0.0 else 'early'} over the whole log, "
                f"{each.allowed_lag_s:.2g} s is the spread of held-out training logs"
                for each in one.levels
                if each.late
            ]
        return found

    def _open_levels(self) -> list[str]:
        """Levels that can't be judged in one line: of several logs the largest of each output."""
        logs = [one for one in self.logs if any(each.open for each in one.levels)]
        if not logs:
            return []
        largest: dict[str, LevelCheck] = {}
        for each in (level for one in logs for level in one.levels if level.open):
            before = largest.get(each.channel, each)
            largest[each.channel] = max(before, each, key=lambda level: abs(level.error))
        more = f" and {len(logs) - 1} more" if len(logs) > 1 else ""
        size = f"of {'up to ' if more else ''}{', '.join(map(words, largest.values()))}"
        few = f"fewer than {LEAST_LOGS} training logs were held out"
        return [f"{logs[0].log.name}{more}: level error {size} is not judged: {few}"]

    def _large_errors(self) -> list[str]:
        texts = []
        for name, bound in self.config.largest_rmse.items():
            pooled = self.pooled
            if name not in pooled:
                raise ConfigError(
                    "[evaluate.largest_rmse] bounds a channel that the model does not give",
                    channel=name,
                    hint=f"It gives {', '.join(pooled)}",
                )
            if math.isnan(pooled[name].rmse):
                texts.append(f"{name}: no sample to judge by, at most RMSE {bound:g} allowed")
            elif not pooled[name].rmse <= bound:
                texts.append(f"{name}: RMSE {pooled[name].rmse:.3g}, at most {bound:g} allowed")
        return texts

    @cached_property
    def outcome(self) -> Outcome:
        """The verdict: what is missed, then what was counted, then how the baselines do."""
        failed, lacking, found = self.failed, self.lacking, self.tally
        passed = False if failed else None if lacking else True
        baselines = tuple(_against_baselines(one) for one in self.logs)
        set_here = [
            f"{name} = {own} (default {usual})"
            for name, (own, usual) in self.config.changed.items()
        ]
        bounds = [f"Set in [evaluate]: {', '.join(set_here)}"] if set_here else []
        lines = tuple(f"{text.rstrip('.')}." for text in (*failed, *lacking, *bounds))
        if not found.assessed:
            headline = "No event could be assessed for Ti and Tt"
            return Outcome(passed, headline, (*lines, *baselines))
        share = 100.0 * found.passed / found.assessed
        headline = (
            f"{found.passed} of {found.assessed} assessable transients ({share:.0f} %) meet the "
            f"'{self.config.transients.rules}' rules for Ti and Tt"
        )
        whole = [ok for log in self.logs for event in log.events if (ok := event.ok) is not None]
        said = [f"{sum(whole)} of {plural(len(whole), 'event')} pass in every channel."]
        if found.not_assessable:
            why = not_assessable(self.assessments, figures=True)
            reasons = [f"{reason} ({count})" for reason, count in why.items()][:_MOST_REASONS]
            said.append(
                f"{plural(found.not_assessable, 'transient')} could not be assessed and count "
                f"neither way: {'; '.join(reasons)}{', ...' * (len(why) > len(reasons))}."
            )
        return Outcome(passed, headline, (*lines, *said, self._evidence_words(), *baselines))

    @property
    def new_logs(self) -> int:
        return sum(one.role in {NEW, "test"} for one in self.logs)

    def _evidence_words(self) -> str:
        """What the verdict rests on."""
        each = ", ".join(
            f"{symbol(one.channel)} {one.passed} of {one.assessed} {one.plural}"
            for one in self.counts
        )
        share = min((share for one in self.logs for share in one.judged.values()), default=0.0)
        least = min((one.at_least_pct for one in self.counts), default=0.0)
        return (
            f"Evidence: {plural(self.new_logs, 'new log')}, {each}; with 90 % confidence at least "
            f"{least:.0f} % of such transients pass; at least {100.0 * share:.0f} % of each "
            "output of each log is judged."
        )

    def document(self) -> dict[str, Any]:
        """`evaluate.json`; None where a figure does not exist."""
        used, missed = self.config.transients.rule_set, self.missed
        found: dict[str, Any] = finite(
            {
                "schema": SCHEMA,
                "ok": not missed,
                "missed": missed,
                "least_passed_pct": self.config.least_passed_pct,
                "bounds": {
                    name: {"value": own, "default": usual}
                    for name, (own, usual) in self.config.changed.items()
                },
                "evidence": {
                    "new_logs": self.new_logs,
                    "least_events": self.config.least_events,
                    "least_judged_pct": self.config.least_judged_pct,
                    "transients": [each.row() for each in self.counts],
                    "lacking": self.lacking,
                },
                "trim": self.trim,
                "findings": [each.row() for each in self.findings],
                "certificate": None if self.certificate is None else self.certificate.row(),
                "rules": {
                    "name": used.name,
                    "source": used.source,
                    "tt_origin": used.tt_origin,
                    "data_source": self.config.transients.data_source,
                },
                "logs": [log.row() for log in self.logs],
                "pooled": {
                    "channels": {name: one.row() for name, one in self.pooled.items()},
                    "ti_tt": tally_row(self.assessments),
                },
            }
        )
        return found


def _none_rated(rated: Sequence[str], outputs: Sequence[str]) -> str:
    return (
        f"the model has no output {' or '.join(rated)}, and nothing says how its "
        f"{', '.join(outputs)} are judged: before training, name channels and their "
        "least_response in [evaluate.transients]"
    )


def _against_baselines(one: LogEvaluation) -> str:
    best = {name: (found.rmse, found.best_rmse) for name, found in one.scores.items()}
    won = [symbol(name) for name, (own, least) in best.items() if own == least]
    lost = [symbol(name) for name, (own, least) in best.items() if own > least]
    text = f"{one.log.name}: lowest free-run RMSE of all models in {', '.join(won) or 'no channel'}"
    return f"{text}; a baseline does better in {', '.join(lost)}." if lost else f"{text}."


def evaluate(
    bundle: Bundle,
    logs: Sequence[Log],
    trim: float | None = None,
    settings: EvaluateConfig | None = None,
    progress: Progress = silent,
) -> Evaluation:
    """Evaluate prepared logs; with `trim`, that share of each log is used up for offsets.

    Raises `DataError` for logs that the model cannot be run on, `ConfigError` for a trim
    outside of 0 to 1.
    """
    config, own = run_config(bundle)
    settings = settings or own
    found = []
    for number, log in enumerate(logs):
        progress(number, len(logs), log.name)
        found.append(assess_log(bundle, log, settings, trim=trim))
    result = Evaluation(tuple(found), settings, trim, bundle.certificate)
    said = (
        *bundle.record.doubtful_logs,
        *cautions(logs, config, config.narx.outputs),
        *(each.caution for each in result.findings),
        *result.level_cautions,
        *(text for one in found if (text := outside_envelope(bundle, one.run))),
    )
    return replace(result, cautions=said)
