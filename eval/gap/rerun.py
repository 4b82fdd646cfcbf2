"""A simulator that can be run again is run again, with the effect on its inputs.

What such a simulator says of other inputs is exact where an emulator is a guess. It runs on its own
raster, on straight lines between the middles of the diagnosis' blocks; what another pace changes,
which it cannot have, the emulator says.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from data_prep.log import Log
from eval.gap.blocks import block_means
from eval.gap.simulators import Simulate
from narxcal.channels import CHANNELS
from narxcal.effects.pace import Pace
from narxcal.effects.running import Emulator, Flights, Shift
from narxcal.support.arrays import FloatArray, bridge_gaps
from narxcal.support.errors import ModelError


@dataclass(frozen=True, eq=False)
class Rerun:
    """`simulate` takes logs of `block` samples per sample of the flights."""

    emulator: Emulator
    simulate: Simulate
    block: int
    _as_flown: list[tuple[Flights, FloatArray]] = field(default_factory=list)

    def run(
        self,
        flights: Flights,
        told: FloatArray,
        pace: Pace | None = None,
        shift: Shift | None = None,
    ) -> FloatArray:
        """Outputs (rows, time, outputs) for `told` (blocks, time, inputs).

        With a pace, and a shift of where it settles, it is the emulator's run, anchored to what the
        simulator says of these inputs. Samples of which it says nothing are bridged, as in its
        logs. Raises `ModelError` where the simulator leaves out one of the outputs.
        """
        if pace is None:
            return self._flown(flights) if told is flights.u else self._told(flights, told)
        found = self.emulator.run(flights, told, pace, shift)
        if told is flights.u:
            return found
        blocks, rows = len(told), np.arange(len(found))
        here, there = rows % blocks, rows % len(flights.u)
        anchored = self.run(flights, told)[here] - self._flown(flights)[there]
        guessed = self.emulator.run(flights, told)[here]
        return np.asarray(found + anchored - guessed + self.emulator.run(flights, flights.u)[there])

    def _flown(self, flights: Flights) -> FloatArray:
        """What it says of the inputs as they were flown: asked once."""
        for known, found in self._as_flown:
            if known is flights:
                return found
        found = self._told(flights, flights.u)
        self._as_flown[:] = [(flights, found)]
        return found

    def _told(self, flights: Flights, told: FloatArray) -> FloatArray:
        return np.stack([self._one(flights, u) for u in told])

    def _one(self, flights: Flights, u: FloatArray) -> FloatArray:
        signals, count = flights.signals, len(u)
        dt_s = signals.dt_s / self.block
        rows = np.arange(count * self.block, dtype=np.float64)
        middles = (np.arange(count) + 0.5) * self.block - 0.5
        channels = {
            name: np.interp(rows, middles, u[:, j])
            for j, name in enumerate(signals.inputs)
            if name in CHANNELS
        }
        found = self.simulate(
            Log("flight run again", np.asarray(rows * dt_s, dtype=np.float64), channels)
        )
        for name in signals.outputs:
            if name not in found or not np.isfinite(found[name]).any():
                raise ModelError("the simulator no longer gives it", channel=name)
        y = np.column_stack([bridge_gaps(found[name]) for name in signals.outputs])
        return block_means(y, self.block)
