"""Transport delay: inputs that act late, as whole samples and a part of one.

    u_d(k) = (1 - f) u(k - n) + f u(k - n - 1),   n + f = delay_s / dt_s,  0 <= f < 1

Before the first sample the inputs are taken as constant.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Self

import numpy as np

from narxcal.steady.model import ALTERED
from narxcal.support.arrays import FloatArray, IntArray
from narxcal.support.errors import ModelError
from narxcal.support.settings import read_stored


@dataclass(frozen=True)
class TransportDelay:
    """The inputs `channels` act `delay_s` late; held-out errors allow `low_s` to `high_s`."""

    channels: tuple[str, ...]
    delay_s: float
    low_s: float
    high_s: float

    @property
    def words(self) -> str:
        span = f"{self.low_s:.2f} to {self.high_s:.2f} s"
        return f"{', '.join(self.channels)} acts {self.delay_s:.2f} s late ({span})"

    def line(self, names: Sequence[str], first: FloatArray, dt_s: float) -> DelayLine:
        """Start a line at inputs (n_in,) called `names` that were constant."""
        columns = np.array([names.index(name) for name in self.channels], dtype=np.int64)
        return DelayLine(self.delay_s / dt_s, columns, first)

    def late(self, values: FloatArray, dt_s: float) -> FloatArray:
        columns = np.arange(values.shape[1])
        return DelayLine(self.delay_s / dt_s, columns, values[0]).advance(values)

    def to_json(self) -> dict[str, Any]:
        return asdict(self)

    @classmethod
    def from_json(cls, stored: Mapping[str, Any], names: Sequence[str]) -> Self:
        """Inverse of `to_json`; `ModelError` for a channel that is no input, or a bad time."""
        found = read_stored(cls, stored, "delay")
        if not set(found.channels) <= set(names) or not 0.0 <= found.delay_s < np.inf:
            raise ModelError("'delay' does not fit the inputs", hint=ALTERED)
        return found


class DelayLine:
    """Past rows of the delayed columns, a ring of as many samples as the delay takes."""

    def __init__(self, samples: float, columns: IntArray, first: FloatArray) -> None:
        self._whole = int(samples)
        self._part = samples - self._whole
        self._columns = columns
        self._past = np.tile(first[columns], (self._whole + 1, 1))

    def advance(self, inputs: FloatArray) -> FloatArray:
        """Inputs (n, n_in) as they act: the delayed columns from before."""
        rows = np.concatenate([self._past, inputs[:, self._columns]])
        acting, n = inputs.copy(), len(inputs)
        acting[:, self._columns] = (1.0 - self._part) * rows[1 : 1 + n] + self._part * rows[:n]
        self._past = rows[n:]
        return acting
