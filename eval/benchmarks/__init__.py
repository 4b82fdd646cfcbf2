"""Our own figures, each measured when its command runs; `eval.bench` prints them as rows."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import Any, Literal

from narxcal.support.files import finite

Bound = Literal["at most", "at least", ""]


@dataclass(frozen=True)
class Row:
    """A measured figure and what it is compared with.

    `target` is a bound that `value` has to keep (`bound` "" : none). `source` says where the
    target comes from, `note` how the figure was measured. A figure that could not be measured
    is NaN and `note` says why.
    """

    group: str
    name: str
    value: float
    unit: str
    target: float = math.nan
    bound: Bound = ""
    source: str = ""
    note: str = ""

    @property
    def reached(self) -> bool | None:
        """Whether the target is kept; None without one or without a figure."""
        if not self.bound or math.isnan(self.value) or math.isnan(self.target):
            return None
        return self.value <= self.target if self.bound == "at most" else self.value >= self.target

    def document(self) -> dict[str, Any]:
        """As JSON; None for a figure that does not exist."""
        table: dict[str, Any] = finite({**asdict(self), "reached": self.reached})
        return table
