"""The parameter register: past deviations and inputs of a calibration between two steps.

Source: papers/narx calibration, figure 1.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from narxcal import kernels
from narxcal.lag import Drive, LagModel
from narxcal.narx import AT_START, NarxModel, Weights

FloatArray = NDArray[np.float64]
# An EGT overshoots its final value by up to 1.6 times the change (FACTS: frozen-speed response).
_OVERSHOOT = 2.0


class Parts(NamedTuple):
    """What a register runs: the network, the lags in front of it, raster and fading bound.

    `columns` are those of the schedule among the inputs, which are called `names`.
    """

    narx: NarxModel
    lag: LagModel | None
    dt_s: float
    settle_s: float | None
    names: tuple[str, ...]
    columns: list[int]


class Sample(NamedTuple):
    """Inputs (n_in,), steady state (n_out,) and deviation (n_out,) at the first sample."""

    inputs: FloatArray
    ss: FloatArray
    deviation: FloatArray


class Register:
    """Runs forward from one sample; the deviation is that of the lags plus the network's."""

    def __init__(self, parts: Parts, first: Sample) -> None:
        self.parts = parts
        narx = parts.narx
        self.weights = Weights.of(narx.net)
        self.inputs, self.outputs = narx.input_scaling, narx.output_scaling
        self.taps = np.array(narx.config.taps)
        self.keep = None if parts.settle_s is None else math.exp(-parts.dt_s / parts.settle_s)
        nothing = np.zeros_like(first.deviation)
        # A start away from the steady state is the lags' to lose, where there are any.
        own = first.deviation if parts.lag is None else nothing
        self.fading = np.stack([nothing, np.abs(own)])
        self.lagged = np.stack([first.deviation, nothing])
        self.ss = first.ss
        self.drive: Drive | None = None
        if parts.lag is not None:
            self.drive = parts.lag.drive(first.inputs[None], parts.names, first.ss[None])
        feature = self._features(first.inputs[None], first.ss[None], first.deviation[None])[0]
        self.history = np.tile(self.outputs.down(own), narx.config.lags)
        self.past = np.tile(self.inputs.down(feature), (int(self.taps[-1]) + 1, 1))

    def correct(self, outputs: FloatArray) -> None:
        """Take measured `outputs` (n_out,) at the newest sample for true; NaN is not known."""
        newest = self.history[: len(outputs)]
        known = np.isfinite(outputs)
        deviation = self.ss - outputs
        if self.parts.lag is None:
            newest[:] = np.where(known, self.outputs.down(deviation), newest)
            self.fading[1] = np.maximum(self.fading[1], np.abs(self.outputs.up(newest)))
        else:
            fast = deviation - self.lagged[1] - self.outputs.up(newest)
            self.lagged[0] = np.where(known, fast, self.lagged[0])

    def extend(self, given: FloatArray, ss: FloatArray) -> FloatArray:
        """Deviations (time, n_out) at inputs (time, n_in) and steady states to come."""
        lagged = self._lags(given, ss)
        return self._network(self._features(given, ss, lagged)) + lagged

    def _lags(self, given: FloatArray, ss: FloatArray) -> FloatArray:
        lag = self.parts.lag
        if lag is None or self.drive is None:
            return np.zeros_like(ss)
        drive = lag.drive(given, self.parts.names, ss).after(self.drive)
        fast, slow = lag.run(drive, (AT_START, self.lagged[None]), self.parts.dt_s)
        self.lagged = np.stack([fast[-1], slow[-1]])
        self.drive = drive.rows(slice(-1, None))
        deviation: FloatArray = (fast + slow)[1:]
        return deviation

    def _features(self, given: FloatArray, ss: FloatArray, lagged: FloatArray) -> FloatArray:
        increments = np.diff(ss, axis=0, prepend=self.ss[None])
        self.ss = ss[-1]
        shown = None if self.parts.lag is None else lagged
        return stacked(increments, shown, ss, given[:, self.parts.columns])

    def _network(self, features: FloatArray) -> FloatArray:
        """The network's deviations (time, n_out)."""
        rows = np.concatenate([self.past, self.inputs.down(features)])
        newest = np.arange(len(self.past), len(rows))
        tapped = rows[newest[:, None] - self.taps].reshape(len(features), -1)
        limit = self._limit(features[:, : len(self.ss)])
        deviation, _, fed = self.weights.run(tapped, (AT_START, self.history[None]), limit)
        self.history = np.concatenate([deviation[-1], fed[-1, : -deviation.shape[1]]])
        self.past = rows[-len(self.past) :]
        return self.outputs.up(deviation)

    def _limit(self, increments: FloatArray) -> FloatArray | None:
        if self.keep is None:
            return None
        envelope = kernels.fading(np.ascontiguousarray(increments), self.fading, self.keep)
        limit: FloatArray = _OVERSHOOT * envelope / self.outputs.scale
        return limit


def stacked(
    increments: FloatArray, lagged: FloatArray | None, ss: FloatArray, schedule: FloatArray
) -> FloatArray:
    """The network's inputs (time, features): what vanishes at rest first."""
    moving = [increments] if lagged is None else [increments, lagged]
    return np.concatenate([*moving, ss, schedule], axis=1)
