"""The parameter register: past deviations and inputs of a calibration between two steps.

Source: papers/narx calibration, figure 1.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from narxcal import kernels, register_step
from narxcal.lag import Drive, LagModel, air_columns
from narxcal.lag_governed import AnyLags, GovernedLags
from narxcal.lag_steps import CASING, FAST, STATES
from narxcal.narx import AT_START, Weights
from narxcal.narx_model import NarxModel
from narxcal.register_step import OVERSHOOT, Lags, Memory, Network

FloatArray = NDArray[np.float64]


class Parts(NamedTuple):
    """What a register runs: the network, the lags in front of it, raster and fading bound.

    `columns` are those of the schedule among the inputs, which are called `names`.
    """

    narx: NarxModel
    lag: AnyLags | None
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
    """Runs forward from one sample; the deviation is that of the lags plus the network's.

    `extend` takes a block of samples, `step` one: the same numbers, at a small part of the cost.
    """

    def __init__(self, parts: Parts, first: Sample) -> None:
        self.parts = parts
        narx = parts.narx
        self.weights = Weights.of(narx.net)
        self.inputs, self.outputs = narx.input_scaling, narx.output_scaling
        self.taps = np.array(narx.config.taps)
        self.keep = None if parts.settle_s is None else math.exp(-parts.dt_s / parts.settle_s)
        nothing = np.zeros_like(first.deviation)
        # A start away from the steady state is the lags' to lose, where there are any.
        own, shown, target = first.deviation, None, nothing.copy()
        started = np.zeros((len(STATES), len(nothing)))
        if parts.lag is not None:
            own, shown, started = nothing, first.deviation[None], parts.lag.start(first.deviation)
            target = parts.lag.drive(first.inputs[None], parts.names, first.ss[None]).target[0]
        schedule = first.inputs[None, parts.columns]
        feature = stacked(nothing[None], shown, first.ss[None], schedule)[0]
        self.memory = Memory(
            ss=first.ss.copy(),
            target=target,
            lagged=started,
            fading=np.stack([nothing, np.abs(own)]),
            history=np.tile(self.outputs.down(own), narx.config.lags),
            past=np.tile(self.inputs.down(feature), (int(self.taps[-1]) + 1, 1)),
        )

    def correct(self, outputs: FloatArray) -> None:
        """Take measured `outputs` (n_out,) at the newest sample for true; NaN is not known."""
        lagged, fading = self.memory.lagged, self.memory.fading
        newest = self.memory.history[: len(outputs)]
        known = np.isfinite(outputs)
        deviation = self.memory.ss - outputs
        if self.parts.lag is None:
            newest[:] = np.where(known, self.outputs.down(deviation), newest)
            fading[1] = np.maximum(fading[1], np.abs(self.outputs.up(newest)))
        else:
            fast = deviation - lagged[FAST + 1 : CASING + 1].sum(axis=0) - self.outputs.up(newest)
            lagged[FAST] = np.where(known, fast, lagged[FAST])

    def step(self, given: FloatArray, ss: FloatArray) -> FloatArray:
        """Deviation (n_out,) at inputs (n_in,) and steady state (n_out,) one sample on."""
        if isinstance(self.parts.lag, GovernedLags):
            self._lags(given[None], ss[None])
            network, memory = self._compiled[0], self.memory
            governed: FloatArray = register_step.behind(network, memory, (given, ss), True)  # noqa: FBT003
            return governed
        deviation: FloatArray = register_step.step(*self._compiled, self.memory, given, ss)
        return deviation

    def extend(self, given: FloatArray, ss: FloatArray) -> FloatArray:
        """Deviations (time, n_out) at inputs (time, n_in) and steady states to come."""
        lagged = self._lags(given, ss)
        return self._network(self._features(given, ss, lagged)) + lagged

    @cached_property
    def _compiled(self) -> tuple[Network, Lags]:
        """What `register_step.step` takes beside the memory."""
        w, lag = self.weights, self.parts.lag
        network = Network(
            feedback=w.feedback,
            drive=(w.w1u, w.b1, w.au, w.b2),
            fixed=w.fixed,
            bounds=w.bounds,
            inputs=(np.array(self.inputs.centre), np.array(self.inputs.scale)),
            outputs=(np.array(self.outputs.centre), np.array(self.outputs.scale)),
            taps=self.taps,
            schedule=np.array(self.parts.columns, dtype=np.int64),
            keep=-1.0 if self.keep is None else self.keep,
        )
        plain = lag if isinstance(lag, LagModel) else None  # the other form runs before it
        return network, lags_of(plain, self.parts.names, self.parts.dt_s)

    def _lags(self, given: FloatArray, ss: FloatArray) -> FloatArray:
        lag, memory = self.parts.lag, self.memory
        if lag is None:
            return np.zeros_like(ss)
        drive = lag.drive(given, self.parts.names, ss)
        # The air and the scale of the newest sample are behind it.
        unused = np.ones((1, ss.shape[1])), np.zeros((1, drive.air.shape[1]))
        drive = drive.after(Drive(memory.ss[None], memory.target[None], *unused))
        states = lag.run(drive, (AT_START, memory.lagged[None]), self.parts.dt_s)
        memory.lagged[:] = states[-1]
        memory.target[:] = drive.target[-1]
        deviation: FloatArray = states[1:, : CASING + 1].sum(axis=1)
        return deviation

    def _features(self, given: FloatArray, ss: FloatArray, lagged: FloatArray) -> FloatArray:
        increments = np.diff(ss, axis=0, prepend=self.memory.ss[None])
        self.memory.ss[:] = ss[-1]
        shown = None if self.parts.lag is None else lagged
        return stacked(increments, shown, ss, given[:, self.parts.columns])

    def _network(self, features: FloatArray) -> FloatArray:
        """The network's deviations (time, n_out)."""
        memory = self.memory
        rows = np.concatenate([memory.past, self.inputs.down(features)])
        newest = np.arange(len(memory.past), len(rows))
        tapped = rows[newest[:, None] - self.taps].reshape(len(features), -1)
        limit = self._limit(features[:, : len(memory.ss)])
        deviation, _, fed = self.weights.run(tapped, (AT_START, memory.history[None]), limit)
        memory.history[:] = np.concatenate([deviation[-1], fed[-1, : -deviation.shape[1]]])
        memory.past[:] = rows[-len(memory.past) :]
        return self.outputs.up(deviation)

    def _limit(self, increments: FloatArray) -> FloatArray | None:
        if self.keep is None:
            return None
        envelope = kernels.fading(np.ascontiguousarray(increments), self.memory.fading, self.keep)
        limit: FloatArray = OVERSHOOT * envelope / self.outputs.scale
        return limit


def lags_of(lag: LagModel | None, names: Sequence[str], dt_s: float) -> Lags:
    """The arrays of `lag` as `register_step.step` takes them, of inputs called `names`."""
    if lag is None:
        nothing, none = np.empty(0), np.empty(0, dtype=np.int64)
        return Lags(np.empty((0, 0)), nothing, (nothing, nothing), none, none, nothing, none, dt_s)
    order, own, sign = lag.wiring
    return Lags(
        parameters=lag.parameters[order],
        limit=lag.limit[order],
        scale=(np.array(lag.centre), np.array(lag.half)),
        order=order,
        own=own,
        sign=sign,
        air=air_columns(names),
        dt_s=dt_s,
    )


def stacked(
    increments: FloatArray, lagged: FloatArray | None, ss: FloatArray, schedule: FloatArray
) -> FloatArray:
    """The network's inputs (time, features): what vanishes at rest first."""
    moving = [increments] if lagged is None else [increments, lagged]
    return np.concatenate([*moving, ss, schedule], axis=1)
