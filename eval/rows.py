"""Rows of `evaluate.json`: values that JSON can hold, None where a figure does not exist."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from typing import Any

import numpy as np

from data_prep.log import Log
from eval.judged import LogEvaluation
from eval.runs import MODEL, Runs
from eval.tally import tally
from eval.transients import Assessment
from eval.trim import Trim

# What was measured in one event; reasons that differ in nothing else are counted together.
_MEASURED = re.compile(r"-?\d+(\.\d+)?(e[+-]?\d+)?")


def log_row(one: LogEvaluation) -> dict[str, Any]:
    """One entry of `logs`."""
    runs = one.runs
    channels = {}
    for name, figures in one.scores.items():
        channels[name] = figures.row()
        if name in one.untrimmed:
            channels[name]["untrimmed_rmse"] = one.untrimmed[name].row()["rmse"]
    return {
        "log": one.log.name,
        "role": one.role,
        "file": one.log.source.file,
        "sha256": one.log.source.sha256,
        "samples": len(one.log),
        "dt_s": one.log.dt_s,
        "channels": channels,
        "events": [each.row() for each in one.assessments],
        "ti_tt": tally_rows(one.assessments),
        "baselines": {name: rival.row() for name, rival in one.rivals.items()},
        "masked": _masked_rows(one.log),
        "inputs": {
            "held_samples": int(np.count_nonzero(~runs.known)),
            "outside_envelope_share": float(np.mean(~runs.inside)),
            "quasi_steady_share": float(np.mean(runs.still)),
        },
        "trim": _trim_row(runs, one.log),
    }


def tally_rows(assessments: Sequence[Assessment]) -> dict[str, Any]:
    """Counts over all, then per channel and per direction, and why events were not assessed."""
    channels = list(dict.fromkeys(each.channel for each in assessments))
    reasons = Counter(
        _MEASURED.sub("..", str(each.verdict.reason), count=1)
        for each in assessments
        if each.verdict.ok is None
    )
    return {
        **tally(assessments).row(),
        "channels": {
            name: tally([each for each in assessments if each.channel == name]).row()
            for name in channels
        },
        "push": tally([each for each in assessments if each.label == 0]).row(),
        "pull": tally([each for each in assessments if each.label == 1]).row(),
        "not_assessable_reasons": dict(sorted(reasons.items())),
    }


def _masked_rows(log: Log) -> dict[str, Any]:
    return {
        channel: {"samples": sum(reasons.values()), "reasons": reasons}
        for channel, reasons in log.audit.masked().items()
    }


def _trim_row(runs: Runs, log: Log) -> dict[str, Any] | None:
    trim: Trim | None = (runs.trims or {}).get(MODEL)
    if trim is None:
        return None
    return {
        "scored_from_s": float(log.time_s[min(trim.until, len(log) - 1)]),
        "levels": trim.nodes.tolist(),
        "offsets": dict(zip(runs.channels, trim.offsets.T.tolist(), strict=True)),
        "samples": dict(zip(runs.channels, trim.samples, strict=True)),
    }
