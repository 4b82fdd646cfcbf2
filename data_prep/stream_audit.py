"""The audit of a log that is read block by block: every row and every sample counted once."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from data_prep.log import Audit, AuditEntry
from data_prep.raster import LARGEST

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from numpy.typing import NDArray

    from data_prep.log import Action, FloatArray
    from data_prep.raster import Raster

_Key = tuple[str, "Action", str]
_ROWS = ("dropped", "duplicate time stamp"), ("dropped", "not finite")  # in blocks that overlap


class StreamAudit:
    """Adds entries up; spans that meet at the edge of two blocks become one."""

    def __init__(self) -> None:
        self._samples: dict[_Key, int] = {}
        self._spans: dict[_Key, list[tuple[float, float]]] = {}

    def count(self, channel: str, action: Action, reason: str, samples: int) -> None:
        """Add `samples`."""
        key = channel, action, reason
        self._samples[key] = self._samples.get(key, 0) + samples

    def add(self, entries: Iterable[AuditEntry], interval_s: float) -> None:
        """Add entries about samples `interval_s` apart; those about rows are counted elsewhere."""
        for entry in entries:
            if (entry.action, entry.reason) in _ROWS:
                continue
            self.count(entry.channel, entry.action, entry.reason, entry.samples)
            key = entry.channel, entry.action, entry.reason
            spans = self._spans.setdefault(key, [])
            for start, stop in entry.spans_s:
                if spans and start - spans[-1][1] < 1.5 * interval_s:
                    spans[-1] = spans[-1][0], stop
                else:
                    spans.append((start, stop))

    def rows(
        self, time: FloatArray, rows: Mapping[str, FloatArray], new: NDArray[np.bool_], on: Raster
    ) -> None:
        """Count the faults of those rows `(rows,)`, in order of time, that are `new`."""
        steps = on.steps(time)
        self.count("*", "repaired", "time stamp off the raster", _uneven(steps[new]))
        for name, values in rows.items():
            if name == "time_s":
                continue
            valid = np.abs(values) < LARGEST
            absurd = ~valid & ~np.isnan(values) & new
            self.count(name, "dropped", "not finite", int(absurd.sum()))
            again = (np.diff(steps[valid]) <= 0.0) & new[valid][1:]
            self.count(name, "dropped", "duplicate time stamp", int(again.sum()))

    def taken(self) -> Audit:
        """Everything so far as an audit; the count begins anew."""
        entries = [
            AuditEntry(*key, samples, tuple(self._spans.get(key, ())))
            for key, samples in self._samples.items()
        ]
        self._samples, self._spans = {}, {}
        return Audit().add(*entries)


def _uneven(steps: FloatArray) -> int:
    return int((steps != np.round(steps)).sum())
