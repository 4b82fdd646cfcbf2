"""The parameter register: past deviations and inputs of a calibration between two steps.

Source: papers/narx calibration, figure 1.

One sample through the register, compiled: what an engine running beside the model pays for.

`Register.extend` does the same for a block of samples by array operations, each
of which costs more than all arithmetic of one sample; it is the exact twin of `step`, and its test.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cached_property
from typing import NamedTuple

import numpy as np

from narxcal.atmosphere import total_ratios
from narxcal.lumped.lag import CASING, FAST, STATES, Drive, LagModel, air_columns, run_lags
from narxcal.lumped.lag_governed import AnyLags, GovernedLags
from narxcal.narx import kernels
from narxcal.narx.kernels import fading, free_run
from narxcal.narx.network import AT_START, NarxModel, Weights
from narxcal.support.arrays import FloatArray, IntArray
from narxcal.support.compiled import compiled

# An EGT overshoots its final value by up to 1.6 times the change (FACTS: frozen-speed response).
OVERSHOOT = 2.0


class Network(NamedTuple):
    """The network's arrays as of `narxcal.narx.Weights`, its scalings, taps and fading bound.

    `keep` is the pole of the fading bound, negative where there is none.
    """

    feedback: tuple[FloatArray, FloatArray, FloatArray]
    drive: tuple[FloatArray, FloatArray, FloatArray, FloatArray]
    fixed: FloatArray
    bounds: tuple[FloatArray, FloatArray]
    inputs: tuple[FloatArray, FloatArray]
    outputs: tuple[FloatArray, FloatArray]
    taps: IntArray
    schedule: IntArray
    keep: float


class Lags(NamedTuple):
    """The lags' arrays, core spool first; no rows of `parameters` (o, 38) where there are none.

    `order`, `own` and `sign` are those of `narxcal.lumped.lag.Wiring`, and `air` its `air_columns`.
    """

    parameters: FloatArray
    limit: FloatArray
    scale: tuple[FloatArray, FloatArray]
    order: IntArray
    own: IntArray
    sign: FloatArray
    air: IntArray
    dt_s: float


class Memory(NamedTuple):
    """What the register remembers; `step` changes it in place.

    `ss` (o,) and the corrected, scaled `target` (o,) are those of the newest sample, `lagged`
    (3, o) the states of the lags, `fading` (2, o) the state of the bound, `history`
    (lags * o,) past outputs, newest first, and `past` (depth, features) past features, newest
    last, both as the network sees them.
    """

    ss: FloatArray
    target: FloatArray
    lagged: FloatArray
    fading: FloatArray
    history: FloatArray
    past: FloatArray


@compiled(exact=False)
def _of(given: FloatArray, column: int) -> float:
    return given[column] if column >= 0 else 0.0


@compiled(exact=False)
def _lag(lags: Lags, memory: Memory, given: FloatArray, ss: FloatArray) -> None:
    """Move the lags on by one sample: `drive` and `run` of `narxcal.lumped.lag.LagModel` in one."""
    count = len(ss)
    theta2, delta2 = total_ratios(
        _of(given, lags.air[0]), _of(given, lags.air[1]), _of(given, lags.air[2])
    )
    root = math.sqrt(theta2)
    values, target, per_unit = np.empty((2, count)), np.empty((2, count)), np.empty((2, count))
    parts = np.empty((1, len(memory.lagged), count))
    centre, half = lags.scale
    for j in range(count):
        o, q = lags.order[j], lags.own[lags.order[j]]
        values[0, j], values[1, j] = memory.ss[o], ss[o]
        target[0, j], target[1, j] = memory.target[o], (ss[q] / root - centre[q]) / half[q]
        per_unit[0, j] = per_unit[1, j] = lags.sign[o] / (root * half[q])
        parts[0, :, j] = memory.lagged[:, o]
    air = np.empty((2, 2))
    air[:, 0], air[:, 1] = math.log(root / delta2), math.log(root)
    states = run_lags(
        (values, target, per_unit, air),
        (lags.parameters, lags.limit),
        (np.zeros(1, dtype=np.int64), parts),
        np.empty((0, count)),
        lags.dt_s,
    )
    for j in range(count):
        o = lags.order[j]
        memory.target[o] = target[1, j]
        memory.lagged[:, o] = states[1, :, j]


@compiled(exact=False)
def _remember(
    network: Network, memory: Memory, given: FloatArray, ss: FloatArray, lagged: bool
) -> FloatArray:
    """Shift the features of the newest sample into `memory.past`; returns the increments (1, o)."""
    past, count = memory.past, len(ss)
    for k in range(len(past) - 1):
        past[k] = past[k + 1]
    newest = past[len(past) - 1]
    increments = np.empty((1, count))
    behind = 2 * count if lagged else count
    for o in range(count):
        increments[0, o] = newest[o] = ss[o] - memory.ss[o]
        if lagged:
            newest[count + o] = memory.lagged[: CASING + 1, o].sum()
        newest[behind + o] = memory.ss[o] = ss[o]
    for j in range(len(network.schedule)):
        newest[behind + count + j] = given[network.schedule[j]]
    centre, scale = network.inputs
    for i in range(len(newest)):
        newest[i] = (newest[i] - centre[i]) / scale[i]
    return increments


@compiled(exact=False)
def _driven(network: Network, past: FloatArray) -> tuple[FloatArray, FloatArray]:
    """What the inputs alone drive, less the value at rest: hidden (1, h) and linear (1, o)."""
    w1u, b1, au, b2 = network.drive
    w2, fixed = network.feedback[1], network.fixed
    width = past.shape[1]
    hidden, linear = np.empty((1, len(b1))), np.zeros((1, len(b2)))
    still = np.zeros(len(b1))
    if len(fixed) == 0:
        linear[0] = b2
    hidden[0] = still[:] = b1
    for tap in range(len(network.taps)):
        row = past[len(past) - 1 - network.taps[tap]]
        for i in range(width):
            at = tap * width + i
            kept = fixed[at] * row[i] if len(fixed) else 0.0
            for j in range(len(b1)):
                hidden[0, j] += w1u[j, at] * row[i]
                still[j] += w1u[j, at] * kept
            for o in range(len(b2)):
                linear[0, o] += au[o, at] * (row[i] - kept)
    if len(fixed):
        for o in range(len(b2)):
            for j in range(len(b1)):
                linear[0, o] -= w2[o, j] * math.tanh(still[j])
    return hidden, linear


@compiled(exact=False)
def step(
    network: Network, lags: Lags, memory: Memory, given: FloatArray, ss: FloatArray
) -> FloatArray:
    """Deviation (o,) at the next sample, of inputs `given` (n_in,) and steady state `ss` (o,)."""
    lagged = len(lags.parameters) > 0
    if lagged:
        _lag(lags, memory, given, ss)
    return behind(network, memory, (given, ss), lagged)


@compiled(exact=False)
def behind(
    network: Network, memory: Memory, sample: tuple[FloatArray, FloatArray], lagged: bool
) -> FloatArray:
    """What `step` does behind lags that are there already; `sample` are `given` and `ss`."""
    given, ss = sample
    count = len(ss)
    increments = _remember(network, memory, given, ss, lagged)
    hidden, linear = _driven(network, memory.past)
    centre, scale = network.outputs
    limit = np.empty((0, count))
    if network.keep >= 0.0:
        limit = OVERSHOOT * fading(increments, memory.fading, network.keep) / scale
    history = memory.history
    start = history.copy().reshape(1, len(history))
    low, high = network.bounds
    scaled, _, _ = free_run(
        hidden,
        linear,
        network.feedback,
        (np.zeros(1, dtype=np.int64), start),
        (low, high, limit),
    )
    deviation = np.empty(count)
    for j in range(len(history) - 1, count - 1, -1):
        history[j] = history[j - count]
    for o in range(count):
        history[o] = scaled[0, o]
        deviation[o] = scaled[0, o] * scale[o] + centre[o]
        if lagged:
            deviation[o] += memory.lagged[: CASING + 1, o].sum()
    return deviation


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
            governed: FloatArray = behind(network, memory, (given, ss), True)  # noqa: FBT003
            return governed
        deviation: FloatArray = step(*self._compiled, self.memory, given, ss)
        return deviation

    def extend(self, given: FloatArray, ss: FloatArray) -> FloatArray:
        """Deviations (time, n_out) at inputs (time, n_in) and steady states to come."""
        lagged = self._lags(given, ss)
        return self._network(self._features(given, ss, lagged)) + lagged

    @cached_property
    def _compiled(self) -> tuple[Network, Lags]:
        """What `step` takes beside the memory."""
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
    """The arrays of `lag` as `step` takes them, of inputs called `names`."""
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
