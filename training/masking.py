"""What may be learned: training logs are screened by each other, faults masked, gaps cut out.

Each recording is compared with a bank (`training.redundancy`) of the others. The one that they
contradict most is masked first, since its faults are in the banks of the others, too; then all are
compared anew, until none is contradicted. Recordings are files, or engines where there are fewer
than three files.

A contradiction says that logs differ, not which of them is wrong. A minority of the recordings may
be masked for it, of two neither. Always masked is what one log shows by itself: what contradicts
physics; stuck, dead and noisy channels; steps.

A model can't be fitted to inputs that nobody measured: where one is held for longer than the gap
that divides a recording, the log is divided, too.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from data_prep.log import AuditEntry, Fault, Log
from data_prep.prepare import HELD, hold_inputs
from narxcal.support.arrays import FloatArray, spans
from narxcal.support.errors import DataError
from training.config import RunConfig
from training.outlying import Outlier
from training.records import Split
from training.redundancy import learn
from training.screening import contradiction, screened

MASK = 0.95  # least confidence of what is masked
_ALONE = frozenset({"stuck", "dead", "held", "noise"})
_EITHER = 0.5  # confidence of a finding that either of two logs may be the cause of
_LEAST_PART_S = 20.0  # shorter parts of a divided log show no response with its settling
_REASON = "fault: "


def masked(log: Log) -> Log:
    """Return the log with the channels of its faults NaN from `from_s` to `to_s`, and that counted.

    A fault of the time stamps masks every channel: none can be compared with a model.
    """
    changed: dict[str, FloatArray] = {}
    entries = []
    for each in log.faults:
        inside = (log.time_s >= each.from_s) & (log.time_s <= each.to_s)
        names = tuple(log.channels) if "time_s" in each.channels else each.channels
        for name in names if each.confidence >= MASK else ():
            values = changed.get(name, log.channels.get(name, np.empty(0))).copy()
            count = int((inside & np.isfinite(values)).sum()) if len(values) else 0
            if count:
                values[inside] = np.nan
                changed[name] = values
                entries.append(AuditEntry(name, "masked", f"{_REASON}{each.kind}", count))
    return log.with_channels(changed, *entries) if changed else log


@dataclass(frozen=True, eq=False)
class _Finding:
    """What the other recordings say against one: log's number -> faults, and how much it is."""

    recording: int
    faults: dict[int, tuple[Fault, ...]]
    size: float

    def sure(self, *, minority: bool) -> dict[int, tuple[Fault, ...]]:
        """What is masked; contradictions only of a `minority`."""
        chosen = {
            number: tuple(
                each
                for each in faults
                if each.confidence >= MASK and (minority or each.kind in _ALONE)
            )
            for number, faults in self.faults.items()
        }
        return {number: faults for number, faults in chosen.items() if faults}


def by_each_other(logs: Sequence[Log], channels: Sequence[str]) -> list[Log]:
    """Return prepared logs with the faults that the other ones show added to their own.

    `channels` are those of the model. A fault that may as well be one of another log has a
    confidence of at most one half.
    """
    found, recordings = list(logs), _recordings(logs)
    accused = {k for k, own in enumerate(recordings) if any(_faulty(found[i]) for i in own)}
    findings: list[_Finding] = []
    for _ in range(2 * len(logs)):
        findings = [_against(found, recordings, k, channels) for k in range(len(recordings))]
        sure = {
            each: each.sure(minority=2 * len(accused | {each.recording}) < len(recordings))
            for each in findings
        }
        able = [each for each in findings if sure[each]]
        if not able:
            break
        worst = max(able, key=lambda each: each.size)
        accused.add(worst.recording)
        for number, faults in sure[worst].items():
            found[number] = _with_faults(found[number], faults)
    for each in findings:
        for number, faults in each.faults.items():
            found[number] = _with_faults(found[number], [_doubtful(fault) for fault in faults])
    return found


def _with_faults(log: Log, faults: Sequence[Fault]) -> Log:
    return replace(log, faults=(*log.faults, *faults))


def _doubtful(fault: Fault) -> Fault:
    return replace(fault, confidence=_EITHER) if fault.confidence >= MASK else fault


def _faulty(log: Log) -> bool:
    return any(fault.confidence >= MASK for fault in log.faults)


def _recordings(logs: Sequence[Log]) -> list[list[int]]:
    """Numbers of the logs of each file, or of each engine where there are few files."""
    files = [log.source.file or log.name for log in logs]
    whole = len(set(files)) >= 3
    names = [
        file if whole else (file, log.source.engine) for file, log in zip(files, logs, strict=True)
    ]
    return [[k for k, each in enumerate(names) if each == name] for name in dict.fromkeys(names)]


def _against(
    logs: Sequence[Log], recordings: Sequence[list[int]], number: int, channels: Sequence[str]
) -> _Finding:
    """Compare the logs of one recording with the bank of the others."""
    own = recordings[number]
    bank = learn([masked(log) for k, log in enumerate(logs) if k not in own], channels)
    if bank is None:
        return _Finding(number, {}, 0.0)
    subjects = [masked(logs[k]) for k in own]
    faults = {
        k: tuple(each for each in after.faults if each not in logs[k].faults)
        for k, after in zip(own, screened(bank, subjects), strict=True)
    }
    return _Finding(number, faults, max(contradiction(bank, log) for log in subjects))


@dataclass(frozen=True, eq=False)
class Learnable:
    """What can be learned: `split` are parts of `train` and `validate`, whole logs with masks.

    `before` are those logs with nothing masked. `contradicting` logs are in no part of `split`.
    """

    split: Split
    train: tuple[Log, ...]
    validate: tuple[Log, ...]
    before: tuple[Log, ...]
    contradicting: tuple[Outlier, ...] = ()

    @property
    def _whole(self) -> tuple[Log, ...]:
        return (*self.train, *self.validate)

    def row(self) -> dict[str, Any]:
        """For the bundle: faults, and by log how many samples they mask and how many rows go."""
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
        faults = [fault.row() for log in self._whole for fault in log.faults]
        contradicting = [{**asdict(each), "words": each.words} for each in self.contradicting]
        return {"faults": faults, "logs": rows, "contradicting": contradicting}


def _counts(log: Log, recorded: Log) -> dict[str, int]:
    """Channel -> samples that were masked for a fault."""
    lost = {
        name: int((np.isfinite(recorded[name]) & ~np.isfinite(log[name])).sum())
        for name in recorded.channels
    }
    return {name: count for name, count in lost.items() if count}


def learnable(split: Split, config: RunConfig, *, screen: bool = True) -> Learnable:
    """Mask the faults of the logs of `split`, and leave out where inputs are lost.

    Without `screen` the logs have the faults of such a screening. Raises `DataError` where faults
    leave nothing of an output, or no log.
    """
    outputs, inputs = config.narx.outputs, config.steady_state.inputs
    train, validate = list(split.train), list(split.validate)
    if screen:
        train = by_each_other(train, (*outputs, *inputs))
        if validate:
            bank = learn([masked(log) for log in train], (*outputs, *inputs))
            validate = screened(bank, validate)
    usable = (tuple(map(masked, train)), tuple(map(masked, validate)))
    _check(split.train, usable[0], outputs)
    found: list[tuple[Log, ...]] = []
    for before, after in zip((split.train, split.validate), usable, strict=True):
        pairs = zip(before, after, strict=True)
        kept = [log for was, log in pairs if not _lost(log, was if screen else None, config)]
        found.append(tuple(part for log in kept for part in _parts(log, config)))
    if not found[0]:
        raise _nothing_left(usable[0])
    return Learnable(
        Split(found[0], found[1], split.test),
        *usable,
        (*split.train, *split.validate),
    )


def _lost(log: Log, before: Log | None, config: RunConfig) -> bool:
    """Whether nothing is left of an input that was recorded `before`, or of all outputs."""
    inputs = [name for name in config.steady_state.inputs if name in log.channels]
    recorded = inputs if before is None else before.recorded(inputs)
    return len(log.recorded(recorded)) < len(recorded) or not log.recorded(config.narx.outputs)


def _check(before: Sequence[Log], after: Sequence[Log], outputs: Sequence[str]) -> None:
    """Refuse logs in which all samples of an output are at fault."""
    for name in outputs:
        if any(log.recorded([name]) for log in before) and not any(
            log.recorded([name]) for log in after
        ):
            raise _at_fault(after, name)


def _nothing_left(logs: Sequence[Log]) -> DataError:
    faulty = [name for log in logs for fault in log.faults for name in fault.channels]
    if not faulty:
        return DataError("no training log has a stretch with all inputs", file=logs[0].name)
    return _at_fault(logs, faulty[0])


def _at_fault(logs: Sequence[Log], name: str) -> DataError:
    why = next(each for log in logs for each in log.faults if {name, "time_s"} & {*each.channels})
    hint = "Correct its column under [logs.columns], or leave these logs out"
    if why.kind == "unit":
        hint = "Set its unit under [logs.columns]"
    problem = f"it is at fault in every training log, first in {why.log} ({why.kind}: {why.detail})"
    return DataError(problem, channel=name, hint=hint)


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
    return [part for part in parts if len(part) * held.dt_s >= _LEAST_PART_S]
