"""The tables of a fleet's dataset, and the rows that one evaluated log gives them.

| table | a row is |
|---|---|
| logs | a log, a file that could not be evaluated, or a file that is there twice |
| scores | an output of a log: errors of the free run, level and lag against the flight |
| events | a transient: an output at one lever movement, its Ti and Tt |
| faults | a finding of `data_prep.cleaning.plausibility` or `training.screening.screen` |
| trims | an output in equilibrium at one power level: its mean residual |

Every row names tail, file, engine and log. The offset of a trim is the mean of measured minus model
over the scored quasi-steady samples of one tenth of the power level (`FreeRun.level`). Errors
are correlated over a minute, so its standard error is that of the means m_b of minutes with n_b of
its n samples (batch means, a ratio estimator):

    offset = sum n_b m_b / n,   se^2 = B / (B - 1) sum (n_b / n)^2 (m_b - offset)^2

for B minutes; of one minute there is none.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, fields
from typing import Any, Final

import numpy as np

from eval.judging.evaluate import Evaluation
from eval.judging.log_evaluation import LogEvaluation
from eval.judging.scores import ChannelScores
from eval.judging.trim import TrimConfig
from eval.run_logs import EvaluateConfig
from narxcal.support.arrays import FloatArray, IntArray
from narxcal.support.files import finite
from training.responses.transients import Assessment, tally
from training.screening.levels import lag_of, level_of

GOOD, FAILED, DUPLICATE = "good", "failed", "duplicate"
Row = dict[str, Any]

_WHOSE: Final = {"tail": "string", "file": "string", "engine": "string", "log": "string"}
_TIMES: Final = {
    f"{name}_{part}": "bool" if part == "ok" else "double"
    for name in ("Ti", "Tt")
    for part in ("flight_s", "model_s", "error_s", "allowed_s", "ok")
}
TABLES: Final[Mapping[str, Mapping[str, str]]] = {
    "logs": _WHOSE
    | dict.fromkeys(("sha256", "status", "reason", "role", "failed", "lacking"), "string")
    | dict.fromkeys(("size", "samples", "masked", "findings", "events"), "int64")
    | dict.fromkeys(("transients", "assessed", "passed"), "int64")
    | dict.fromkeys(("start_s", "dt_s", "hours", "outside_envelope_share"), "double")
    | {"quasi_steady_share": "double", "digest": "string"},
    "scores": _WHOSE
    | {"channel": "string"}
    | {each.name: "double" for each in fields(ChannelScores)}
    | dict.fromkeys(("level_error", "lag_s"), "double"),
    "events": _WHOSE
    | {"start_s": "double"}
    | dict.fromkeys(("direction", "speed", "channel"), "string")
    | {"ok": "bool", "reason": "string"}
    | _TIMES,
    "faults": _WHOSE
    | dict.fromkeys(("kind", "channel", "partner", "unit", "evidence", "remedy"), "string")
    | dict.fromkeys(("start_s", "end_s", "size", "probability"), "double"),
    "trims": _WHOSE
    | {"channel": "string", "samples": "int64", "minutes": "int64"}
    | dict.fromkeys(("level", "altitude_ft", "offset", "standard_error"), "double"),
}
_LEVELS = TrimConfig().spacing


def rows_of(one: LogEvaluation, settings: EvaluateConfig) -> dict[str, list[Row]]:
    """Table -> its rows of one log; without tail and file, which the log does not know."""
    found = {
        "logs": [_log_row(one, settings)],
        "scores": _score_rows(one),
        "events": [_event_row(each) for each in one.assessments],
        "faults": [_fault_row(each.row()) for each in one.log.findings],
        "trims": list(_trim_rows(one)),
    }
    whose = {"log": one.log.name, "engine": one.log.source.engine}
    return {table: [whose | finite(row) for row in rows] for table, rows in found.items()}


def _log_row(one: LogEvaluation, settings: EvaluateConfig) -> Row:
    log, run, alone = one.log, one.run, Evaluation((one,), settings)
    found = tally(one.assessments)
    return {
        "sha256": log.source.sha256,
        "status": GOOD,
        "role": one.role,
        "failed": "; ".join(alone.failed),
        "lacking": "; ".join(alone.lacking),
        "samples": len(log),
        "masked": sum(sum(each.values()) for each in log.audit.masked().values()),
        "findings": len(log.findings),
        "events": len(one.events),
        "transients": len(one.assessments),
        "assessed": found.assessed,
        "passed": found.passed,
        "start_s": float(log.time_s[0]),
        "dt_s": log.dt_s,
        "hours": len(log) * log.dt_s / 3600.0,
        "outside_envelope_share": float(np.mean(~run.in_envelope)),
        "quasi_steady_share": float(np.mean(run.quasi_steady)),
        "digest": log.identity.digest,
    }


def _score_rows(one: LogEvaluation) -> list[Row]:
    run = one.run
    measured = np.where(run.scored[:, None], run.measured, np.nan)
    levels, lags = level_of(run.model, measured), lag_of(run.model, measured, run.log.dt_s)
    return [
        {
            "channel": name,
            **asdict(one.scores[name]),
            "level_error": float(levels[k]),
            "lag_s": float(lags[k]),
        }
        for k, name in enumerate(run.channels)
    ]


def _event_row(each: Assessment) -> Row:
    row = each.row()
    times = {
        f"{name}_{part if part == 'ok' else f'{part}_s'}": value
        for name in ("Ti", "Tt")
        for part, value in row[name].items()
    }
    kept = {name: row[name] for name in ("start_s", "speed", "channel", "ok", "reason")}
    return {"direction": row["label"], **kept, **times}


def _fault_row(row: Row) -> Row:
    return {name: row[name] for name in TABLES["faults"] if name in row and name not in _WHOSE}


def _trim_rows(one: LogEvaluation) -> Iterator[Row]:
    run, log = one.run, one.log
    error = log.measured(run.channels) - run.model
    height = log.channels.get("ALT_ft", np.full(len(log), np.nan))
    step, minute = np.floor(run.level / _LEVELS), np.floor(log.time_s / 60.0)
    for k, name in enumerate(run.channels):
        usable = run.quasi_steady & run.scored & np.isfinite(error[:, k])
        for number in np.unique(step[usable]).tolist():
            rows = usable & (step == number)
            _, of_row, many = np.unique(minute[rows], return_inverse=True, return_counts=True)
            offset, standard_error = batch_means(np.bincount(of_row, error[rows, k]) / many, many)
            known = height[rows][np.isfinite(height[rows])]
            yield {
                "channel": name,
                "level": (number + 0.5) * _LEVELS,
                "altitude_ft": float(known.mean()) if len(known) else None,
                "samples": int(many.sum()),
                "minutes": len(many),
                "offset": offset,
                "standard_error": standard_error,
            }


def batch_means(means: FloatArray, many: IntArray) -> tuple[float, float]:
    """Offset and standard error by the module's formula, of means and counts (minutes,).

    The standard error of a single mean is NaN.
    """
    share, count = many / many.sum(), len(many)
    offset = float(share @ means)
    square = np.sum((share * (means - offset)) ** 2)
    return offset, float(np.sqrt(count / (count - 1) * square)) if count > 1 else math.nan


def not_evaluated(status: str, reason: str, size: int, sha256: str) -> dict[str, list[Row]]:
    """The row of a file without an evaluation."""
    return {"logs": [{"status": status, "reason": reason, "size": size, "sha256": sha256}]}


def as_tables(pa: Any, rows: Mapping[str, Sequence[Row]]) -> dict[str, Any]:
    """Table -> pyarrow table of its rows, in the types of `TABLES` whatever is in them."""
    return {
        name: pa.Table.from_pylist(
            list(rows.get(name, ())),
            pa.schema([(column, pa.type_for_alias(kind)) for column, kind in columns.items()]),
        )
        for name, columns in TABLES.items()
    }
