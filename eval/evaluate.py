"""`narxcal evaluate`: free-run errors, Ti and Tt of every event, baselines on the same rows."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from data_prep.log import Log
from data_prep.prepare import prepare
from data_prep.reading import read_logs
from data_prep.recorded import with_outputs
from eval.judged import EvaluateConfig, LogEvaluation, Task, judge_log
from eval.rows import log_row, tally_rows
from eval.rules import rules as rules_of
from eval.scores import ChannelScores, score
from eval.tally import Tally, tally
from narxcal.bundle import Bundle
from narxcal.errors import ConfigError, ModelError
from training.config import RunConfig
from training.pipeline import split_logs

__all__ = [
    "EvaluateConfig",
    "Evaluation",
    "LogEvaluation",
    "evaluate",
    "evaluation_logs",
    "run_config",
]

SCHEMA = "narxcal.evaluate/1"


@dataclass(frozen=True, eq=False)
class Evaluation:
    """All logs and what they have to reach; `document` is `evaluate.json`."""

    logs: tuple[LogEvaluation, ...]
    config: EvaluateConfig
    trim: float | None = None

    @property
    def tally(self) -> Tally:
        """Ti/Tt over all logs and channels."""
        return tally([each for log in self.logs for each in log.assessments])

    @property
    def pooled(self) -> dict[str, ChannelScores]:
        """Scores per channel over all logs as one recording."""
        return score([log.runs for log in self.logs])

    def missed(self) -> list[str]:
        """Say each tolerance that was missed; empty if the evaluation is passed."""
        found, texts = self.tally, []
        least = self.config.least_passed_pct
        if found.passed_pct is not None and found.passed_pct < least:
            texts.append(
                f"Ti/Tt: {found.passed} of {found.assessed} transients pass "
                f"({found.passed_pct:.1f} %), at least {least:g} % have to"
            )
        pooled = self.pooled
        for name, bound in self.config.largest_rmse.items():
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

    def document(self) -> dict[str, Any]:
        """Everything as JSON-able values; None where a figure does not exist."""
        rules = rules_of(self.config.transients.rules)
        missed = self.missed()
        return {
            "schema": SCHEMA,
            "ok": not missed,
            "missed": missed,
            "trim": self.trim,
            "rules": {"name": rules.name, "source": rules.source, "tt_origin": rules.tt_origin},
            "logs": [log_row(log) for log in self.logs],
            "pooled": {
                "channels": {name: one.row() for name, one in self.pooled.items()},
                "ti_tt": tally_rows([each for log in self.logs for each in log.assessments]),
            },
        }


def run_config(bundle: Bundle) -> tuple[RunConfig, EvaluateConfig]:
    """The configuration stored in a bundle; `ModelError` where there is none."""
    stored = bundle.meta.get("config")
    if not isinstance(stored, Mapping):
        raise ModelError(
            "the bundle does not say how its logs were prepared", hint="Train it with narxcal train"
        )
    config = RunConfig.parse(stored, "bundle.json")
    return config, EvaluateConfig.parse(config.evaluate, "bundle.json, [evaluate]")


def evaluation_logs(bundle: Bundle, files: Sequence[Path] | None = None) -> list[Log]:
    """Read `files` with the column mapping of the bundle, cleaned and smoothed as for training.

    Without `files`, the configured test logs (all configured ones where the split leaves none).
    Masked inputs stay NaN here, so that the evaluation knows them; so are outputs that a file
    lacks. Raises `DataError` for a file without any output.
    """
    config, _ = run_config(bundle)
    outputs = bundle.calibration.output_names
    lacking_some = config.logs.sparing(set(outputs) - set(bundle.calibration.input_names))
    reading = lacking_some.model_copy(update={"raster_hz": 1.0 / bundle.calibration.dt_s})
    chosen: Sequence[Log]
    if files is not None:
        chosen = read_logs(list(files), reading)
    else:
        logs = read_logs(config.logs.resolve(Path(str(bundle.meta.get("base", ".")))), reading)
        chosen = split_logs(logs, config.split).test or logs
    return [with_outputs(log, outputs) for log in prepare(chosen, config)]


def evaluate(
    bundle: Bundle,
    logs: Sequence[Log],
    trim: float | None = None,
    settings: EvaluateConfig | None = None,
) -> Evaluation:
    """Evaluate prepared logs; with `trim`, that share of each log is used up for offsets.

    Raises `DataError` for logs that the model cannot be run on, `ConfigError` for a trim
    outside of 0 to 1.
    """
    config, stored = run_config(bundle)
    settings = settings or stored
    task = Task(settings, trim)
    return Evaluation(tuple(judge_log(bundle, config, log, task) for log in logs), settings, trim)
