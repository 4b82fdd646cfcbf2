"""What a gap diagnosis works on: pairs of logs, and all pairs as one batch of arrays."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from narxcal.effects.running import Flights
from narxcal.support.arrays import FloatArray


@dataclass(frozen=True, eq=False)
class Pair:
    """One flight of one engine, recorded and simulated on the same raster.

    `inputs`, `real` and `sim` map channels to `(time,)`; `real` is NaN where nothing was recorded.
    `others` holds recorded and simulated outputs, `(time, 2)`, that are compared but not diagnosed.
    `counts` says what was changed: reason -> samples; `lone` says of channels that cannot be used
    why: channel -> where it is missing.
    """

    name: str
    time_s: FloatArray
    inputs: Mapping[str, FloatArray]
    real: Mapping[str, FloatArray]
    sim: Mapping[str, FloatArray]
    others: Mapping[str, FloatArray] = field(default_factory=dict)
    counts: Mapping[str, int] = field(default_factory=dict)
    lone: Mapping[str, str] = field(default_factory=dict)

    @property
    def dt_s(self) -> float:
        """Raster interval in seconds."""
        return float(self.time_s[-1] - self.time_s[0]) / (len(self.time_s) - 1)

    @property
    def driver(self) -> str:
        """The input that pushes and pulls: the lever, or the fuel flow where there is none."""
        return "TRA_deg" if "TRA_deg" in self.inputs else "FF_kgph"


@dataclass(frozen=True, eq=False)
class GapData:
    """All flights as one batch.

    `real` (flights, time, outputs) is NaN where unknown and beyond a flight's end; `noise`
    (outputs,) is its standard deviation on the raster of `flights`; `fast` (outputs,) what the mean
    squared gap of the logs is more than that on this raster; `names` are the flights'.
    """

    flights: Flights
    real: FloatArray
    noise: FloatArray
    fast: FloatArray
    names: tuple[str, ...]

    @property
    def gap(self) -> FloatArray:
        """Recorded less simulated, (flights, time, outputs), NaN where unknown."""
        return self.real - self.flights.y

    @property
    def span(self) -> FloatArray:
        """Range of each output in the simulator's logs: (outputs,)."""
        signals = self.flights.signals
        return np.maximum(signals.high - signals.low, 1e-9)
