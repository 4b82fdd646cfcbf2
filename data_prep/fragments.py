"""Parts of one recording as one log again: gaps are samples that nobody measured.

Reading divides a recording where its rows are more than `max_gap_s` apart, and what is learned
needs inputs without gaps. What is judged is the recording: it has one free run, one set of figures
and one picture, however often its recorder stopped for a moment.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from data_prep.grid import ON_GRID
from data_prep.log import Audit, AuditEntry, Log
from narxcal.channels import described
from narxcal.support.arrays import FloatArray

GAP = "gap in the recording"
# Times the rows that there are. A recorder that was off for longer wrote several recordings.
_LONGEST = 3.0


def joined(logs: Sequence[Log]) -> list[Log]:
    """Join the parts of each engine of each file, in their order; logs without a file stay."""
    groups: dict[tuple[str, str], list[Log]] = {}
    for number, log in enumerate(logs):
        file = log.source.file or f"log {number}"
        groups.setdefault((file, log.source.engine), []).append(log)
    return [log for parts in groups.values() for log in _one(parts)]


def _one(parts: list[Log]) -> list[Log]:
    first, dt_s = parts[0], parts[0].dt_s
    if len(parts) == 1:
        return parts
    count = round((parts[-1].time_s[-1] - first.time_s[0]) / dt_s) + 1
    known = sum(map(len, parts))
    same = all(one.channels.keys() == first.channels.keys() for one in parts)
    if not same or not known <= count <= _LONGEST * known:
        return parts
    time_s = first.time_s[0] + dt_s * np.arange(count, dtype=np.float64)
    channels = {name: np.full(count, np.nan) for name in first.channels}
    between = {name: np.zeros(count, dtype=np.bool_) for one in parts for name in one.interpolated}
    measured = np.zeros(count, dtype=np.bool_)
    for one in parts:
        start = int(np.ceil((one.time_s[0] - time_s[0]) / dt_s - ON_GRID))
        stop = min(count, int(np.floor((one.time_s[-1] - time_s[0]) / dt_s + ON_GRID)) + 1)
        rows = slice(start, stop)
        measured[rows] = True
        for name, values in one.channels.items():
            channels[name][rows] = _at(time_s[rows], one, values, switch=_is_switch(name))
        for name, flags in one.interpolated.items():
            near = np.clip(np.searchsorted(one.time_s, time_s[rows]), 0, len(one) - 1)
            between[name][rows] = flags[near]
    lost = int((~measured).sum())
    gaps = [AuditEntry(name, "masked", GAP, lost) for name in channels]
    audit = Audit(tuple(entry for one in parts for entry in one.audit.entries)).add(*gaps)
    found = (replace(each, log=first.name) for one in parts for each in one.findings)
    findings = tuple(dict.fromkeys(found))
    whole = replace(first, time_s=time_s, channels=channels, audit=audit, findings=findings)
    return [replace(whole, interpolated=between)]


def _is_switch(name: str) -> bool:
    return described(name).role == "switch"


def _at(time_s: FloatArray, part: Log, values: FloatArray, *, switch: bool) -> FloatArray:
    """Values of a part at grid times: as they are on its own grid, else between two known ones."""
    steps = (time_s - part.time_s[0]) / part.dt_s
    nearest = np.clip(np.round(steps), 0, len(part) - 1).astype(np.intp)
    if switch or (np.abs(steps - nearest) <= ON_GRID).all():
        return np.asarray(values[nearest])
    below = np.clip(np.floor(steps), 0, len(part) - 1).astype(np.intp)
    above = np.minimum(below + 1, len(part) - 1)
    share = steps - below
    return np.asarray((1.0 - share) * values[below] + share * values[above])
