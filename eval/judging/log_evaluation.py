"""One log and a calibration: free run, scores, Ti and Tt of its events, level, evidence."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np

from data_prep.cleaning.identity import Identity, Shared, first_shared
from data_prep.cleaning.plausibility import unchecked_air
from data_prep.events import Event, find_events
from data_prep.log import Log, Source
from data_prep.prepare import with_outputs
from eval.judging.evidence import ErrorCheck, error_checks, judged_shares
from eval.judging.free_run import BASELINES, MODEL, FreeRun, run_log, trimmed
from eval.judging.scores import ChannelScores, score
from eval.judging.trim import rows_for_trim
from eval.run_logs import EvaluateConfig, run_config
from narxcal.calibration.bundle import Bundle
from training.responses.transients import (
    AssessedEvent,
    Assessment,
    Overlay,
    Tally,
    assess_events,
    assessed,
    not_assessable,
    tally,
)
from training.screening.levels import LevelCheck, checks

NEW = "new"


@dataclass(frozen=True, eq=False)
class LogEvaluation:
    """One log: its free run, scores per channel, events with their assessments.

    `role` is what the bundle used the log for: train, validate, test, or new to it; `shared` says
    which of its logs this one holds samples of.
    `untrimmed` are the scores on the same rows before trim, where there was one. `baselines` are
    the baselines' Ti/Tt counts on the same events. `as_recorded` are the scores on the log before
    its faults were masked, where there are some, and `faulty` the share of each channel's samples
    that was masked so. `levels` compare level and lag of the free run with those of held-out logs,
    `errors` its RMSE. `judged` is the share of each output that the figures rest on.
    """

    run: FreeRun
    role: str
    scores: Mapping[str, ChannelScores]
    events: tuple[AssessedEvent, ...]
    baselines: Mapping[str, Tally]
    untrimmed: Mapping[str, ChannelScores] = field(default_factory=dict)
    as_recorded: Mapping[str, ChannelScores] = field(default_factory=dict)
    faulty: Mapping[str, float] = field(default_factory=dict)
    levels: tuple[LevelCheck, ...] = ()
    shared: Shared | None = None
    judged: Mapping[str, float] = field(default_factory=dict)
    errors: tuple[ErrorCheck, ...] = ()

    @property
    def log(self) -> Log:
        """The prepared log, masked samples still NaN."""
        return self.run.log

    @property
    def assessments(self) -> list[Assessment]:
        return [each for event in self.events for each in event.assessments]

    def row(self) -> dict[str, Any]:
        run, log = self.run, self.log
        channels = {name: figures.row() for name, figures in self.scores.items()}
        for name, before in self.untrimmed.items():
            channels[name]["untrimmed_rmse"] = before.rmse
        for name, with_faults in self.as_recorded.items():
            channels[name]["as_recorded_rmse"] = with_faults.rmse
        return {
            "log": log.name,
            "role": self.role,
            "file": log.source.file,
            "sha256": log.source.sha256,
            "samples": len(log),
            "dt_s": log.dt_s,
            "origin_s": float(log.time_s[0]),
            "channels": channels,
            "events": [each.row() for each in self.assessments],
            "ti_tt": tally_row(self.assessments),
            "levels": [each.row() for each in self.levels],
            "errors": [{**asdict(each), "ok": each.ok} for each in self.errors],
            "judged_share": dict(self.judged),
            "holds": None if self.shared is None else _shared_row(self.shared),
            "baselines": {name: baseline.row() for name, baseline in self.baselines.items()},
            "masked": {
                channel: {"samples": sum(reasons.values()), "reasons": reasons}
                for channel, reasons in log.audit.masked().items()
            },
            "inputs": {
                "held_samples": int(np.count_nonzero(~run.inputs_known)),
                "faulty_share": dict(self.faulty),
                "unchecked": list(unchecked_air(log)),
                "outside_envelope_share": float(np.mean(~run.in_envelope)),
                "quasi_steady_share": float(np.mean(run.quasi_steady)),
            },
            "trim": self._trim_row(),
        }

    def _trim_row(self) -> dict[str, Any] | None:
        trim, names = self.run.trim, self.run.channels
        if trim is None:
            return None
        return {
            "scored_from_s": float(self.log.time_s[min(trim.until, len(self.log) - 1)]),
            "levels": trim.nodes.tolist(),
            "altitudes_ft": trim.altitudes_ft.tolist(),
            "offsets": dict(zip(names, np.moveaxis(trim.offsets, 2, 0).tolist(), strict=True)),
            "samples": dict(zip(names, trim.samples, strict=True)),
        }


def _shared_row(shared: Shared) -> dict[str, Any]:
    share, from_s, to_s = shared.overlap
    return {"log": shared.other, "share": share, "from_s": from_s, "to_s": to_s}


def tally_row(assessments: Sequence[Assessment]) -> dict[str, Any]:
    """Counts over all, then per channel and per direction, and why events were not assessed."""
    channels = dict.fromkeys(each.channel for each in assessments)
    return {
        **tally(assessments).row(),
        "channels": {
            name: tally([each for each in assessments if each.channel == name]).row()
            for name in channels
        },
        "push": tally([each for each in assessments if each.label == 0]).row(),
        "pull": tally([each for each in assessments if each.label == 1]).row(),
        "not_assessable_reasons": not_assessable(assessments),
    }


def assess_log(
    bundle: Bundle,
    log: Log,
    settings: EvaluateConfig,
    *,
    trim: float | None = None,
    events: Sequence[Event] | None = None,
) -> LogEvaluation:
    """Run and score one prepared log; `events` are those to judge where they are already found.

    An output that the log lacks has no figures, and no event waits for it to settle. Raises
    `DataError` as `eval.judging.free_run.run_log`, `ConfigError` for a trim outside of 0 to 1.
    """
    config, _ = run_config(bundle)
    outputs = bundle.calibration.output_names
    recorded = with_outputs(log, outputs)
    log = recorded.without_faults()
    role, shared = role_of(bundle, recorded)
    run = run_log(bundle, config, log, recorded)
    if events is None:
        events = find_events(log, config.events.for_log(log, outputs))
    faulty = masked_shares(recorded, log, (*outputs, *bundle.calibration.input_names))
    untrimmed: Mapping[str, ChannelScores] = {}
    if trim is not None:
        until = rows_for_trim(trim, len(log))
        untrimmed = score([replace(run, scored_from=until)])
        run = trimmed(run, until, settings.trim)
        events = [event for event in events if event.start >= until]
    scores = score([run])
    return LogEvaluation(
        run=run,
        role=role,
        scores=scores,
        events=assessed(events, overlay_of(run, MODEL), settings.transients),
        baselines={
            name: tally(assess_events(events, overlay_of(run, name), settings.transients))
            for name in BASELINES
            if name in run.outputs
        },
        untrimmed=untrimmed,
        as_recorded=score([run_log(bundle, config, recorded)]) if faulty else {},
        faulty=faulty,
        levels=_levels(bundle, run),
        shared=shared,
        judged=judged_shares(run, outputs),
        errors=tuple(
            error_checks(bundle.record, run, {name: one.rmse for name, one in scores.items()})
        ),
    )


def _levels(bundle: Bundle, run: FreeRun) -> tuple[LevelCheck, ...]:
    """Level and lag of the scored rows, compared with training logs that were held out."""
    measured = np.where(run.scored[:, None], run.measured, np.nan)
    return checks(bundle.record.weighed.channels, run.channels, (run.model, measured), run.log.dt_s)


def overlay_of(run: FreeRun, name: str) -> Overlay:
    """Flight and one model of a free run, as events are judged on."""
    model = run.outputs[name]
    return Overlay(run.log.time_s, run.measured, model, run.channels, run.inputs_known)


def role_of(bundle: Bundle, log: Log) -> tuple[str, Shared | None]:
    """What the bundle did with a log of these samples, under whatever name."""
    known = {(one.log, one.engine): one for one in bundle.record.identities}
    others = (
        (one.log, Source(one.file, one.sha256, one.engine), Identity.from_json(one.model_dump()))
        for one in known.values()
    )
    shared = first_shared(log, others)
    if shared is not None:
        return next(one.role for one in known.values() if one.log == shared.other), shared
    if log.source.sha256 not in bundle.record.data.values():
        return NEW, None
    split = bundle.record.split
    named = next((role for role in split if log.name in split[role]), None)
    return named or NEW, None


def masked_shares(recorded: Log, log: Log, names: Sequence[str]) -> dict[str, float]:
    """Channel -> share of its recorded samples that are masked in `log`, where any are."""
    shares = {}
    for name in dict.fromkeys(names):
        before, after = (np.isfinite(one[name]).sum() for one in (recorded, log))
        if after < before:
            shares[name] = float(1.0 - after / before)
    return shares
