"""What may be learned: training logs are screened by each other, stretches masked, gaps cut out.

A model can't be fitted to inputs that nobody measured: where one is held for longer than the gap
that divides a recording, the log is divided, too.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from data_prep.log import Log
from data_prep.prepare import HELD, LEAST_PART_S, hold_inputs
from narxcal.support.arrays import spans
from narxcal.support.errors import DataError
from training.config import RunConfig
from training.records import Split
from training.screening.redundancy import Bank
from training.screening.redundancy_fit import MOST_FOLDS, Pool
from training.screening.scatter import PRIORS, Priors
from training.screening.screen import files_of, screened
from training.steady.steady_choice import Outlier


def cross_screen(
    logs: Sequence[Log], channels: Sequence[str], priors: Priors = PRIORS
) -> tuple[list[Log], Bank | None]:
    """Return prepared training logs with the findings that the other recordings show, and the bank.

    `channels` are those of the model. A recording is a file, of many a group is left out at a time;
    a single one is compared with itself, of which a stretch is not most. What the first pass masks
    is not learned from in the second, nor what this one masks in the bank.
    """
    found, groups = list(logs), _groups(logs)
    pool = _pool(logs, priors)
    for _ in range(2):
        before = [_spans(log) for log in found]
        for own in groups:
            bank = pool.bank(channels, own if len(groups) > 1 else ())
            for k, log in zip(own, screened(bank, [logs[k] for k in own]), strict=True):
                found[k] = log
        if [_spans(log) for log in found] == before:
            break
        pool = _pool(found, priors)
    return found, pool.bank(channels)


def _pool(logs: Sequence[Log], priors: Priors) -> Pool:
    return Pool.of([log.without_faults() for log in logs], priors)


def _groups(logs: Sequence[Log]) -> list[list[int]]:
    """Files that are left out together, at most `MOST_FOLDS` groups; of one file its engines."""
    files = files_of(logs)
    if len(files) == 1:
        engines = [log.source.engine for log in logs]
        files = [
            [k for k, each in enumerate(engines) if each == one] for one in dict.fromkeys(engines)
        ]
    count = min(MOST_FOLDS, len(files))
    return [[k for own in files[first::count] for k in own] for first in range(count)]


def _spans(log: Log) -> set[tuple[str, float | None, float | None]]:
    return {(each.channel, each.start_s, each.end_s) for each in log.findings if each.masks}


@dataclass(frozen=True, eq=False)
class TrainingData:
    """What can be learned: `split` are parts of `train` and `validate`, whole logs with masks.

    `before` are those logs with nothing masked. `contradicting` logs are in no part of `split`.
    `bank` is what the logs to train on say of each other.
    """

    split: Split
    train: tuple[Log, ...]
    validate: tuple[Log, ...]
    before: tuple[Log, ...]
    bank: Bank | None
    contradicting: tuple[Outlier, ...] = ()

    @property
    def _whole(self) -> tuple[Log, ...]:
        return (*self.train, *self.validate)

    def row(self) -> dict[str, Any]:
        """For the bundle: findings, and by log how many samples they mask and how many rows go."""
        rows = []
        for log, recorded in zip(self._whole, self.before, strict=True):
            parts = [
                one for one in (*self.split.train, *self.split.validate) if one.name == log.name
            ]
            kept = sum(len(one) for one in parts)
            rows.append(
                {
                    "log": log.name,
                    "rows": len(log),
                    "masked": _counts(log, recorded),
                    "left_out_rows": len(log) - kept,
                }
            )
        findings = [each.row() for log in self._whole for each in log.findings]
        contradicting = [{**asdict(each), "words": each.words} for each in self.contradicting]
        return {"findings": findings, "logs": rows, "contradicting": contradicting}


def _counts(log: Log, recorded: Log) -> dict[str, int]:
    lost = {
        name: int((np.isfinite(recorded[name]) & ~np.isfinite(log[name])).sum())
        for name in recorded.channels
    }
    return {name: count for name, count in lost.items() if count}


def training_data(split: Split, config: RunConfig, *, screen: bool = True) -> TrainingData:
    """Mask what the logs of `split` show to be at fault, and leave out where inputs are lost.

    Without `screen` the logs have the findings of such a screening. Raises `DataError` where they
    leave no log.
    """
    names = (*config.narx.outputs, *config.steady_state.inputs)
    train, validate = list(split.train), list(split.validate)
    if screen:
        train, bank = cross_screen(train, names)
        validate = screened(bank, validate)
    else:
        bank = _pool(train, PRIORS).bank(names)
    usable = [tuple(log.without_faults() for log in logs) for logs in (train, validate)]
    found: list[tuple[Log, ...]] = []
    for before, after in zip((split.train, split.validate), usable, strict=True):
        pairs = zip(before, after, strict=True)
        kept = [log for was, log in pairs if not _lost(log, was if screen else None, config)]
        found.append(_long_enough([part for log in kept for part in _parts(log, config)]))
    if not found[0]:
        raise _nothing_left(usable[0])
    return TrainingData(
        Split(found[0], found[1], split.test),
        usable[0],
        usable[1],
        (*split.train, *split.validate),
        bank,
    )


def _long_enough(parts: Sequence[Log]) -> tuple[Log, ...]:
    """Those that show a response with its settling; all where none is so long."""
    long = tuple(part for part in parts if np.ptp(part.time_s) >= LEAST_PART_S)
    return long or tuple(parts)


def _lost(log: Log, before: Log | None, config: RunConfig) -> bool:
    """Whether nothing is left of an input that was recorded `before`, or of all outputs."""
    inputs = [name for name in config.steady_state.inputs if name in log.channels]
    recorded = inputs if before is None else before.recorded(inputs)
    return len(log.recorded(recorded)) < len(recorded) or not log.recorded(config.narx.outputs)


def _nothing_left(logs: Sequence[Log]) -> DataError:
    found = [each.caution for log in logs for each in log.findings if each.masks]
    hint = f"Masked is {found[0]}" if found else "Check the columns under [logs.columns]"
    problem = "no training log has a stretch with all inputs and an output"
    return DataError(problem, file=logs[0].name, hint=hint)


def _parts(log: Log, config: RunConfig) -> list[Log]:
    """Parts of a log between long stretches without an input; in short ones it is held."""
    inputs = config.steady_state.inputs
    held = hold_inputs(log, inputs)
    unknown = np.zeros(len(held), dtype=np.bool_)
    for entry in held.audit.entries:
        for start_s, stop_s in entry.spans_s if entry.reason == HELD else ():
            if entry.channel in inputs and stop_s - start_s > config.logs.max_gap_s:
                unknown |= (held.time_s >= start_s) & (held.time_s <= stop_s)
    if not unknown.any():
        return [held]
    parts = [held.part(start, stop) for start, stop in spans(~unknown)]
    return [part for part in parts if len(part) * held.dt_s >= LEAST_PART_S]
