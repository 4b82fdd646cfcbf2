"""The state of a calibration between samples, and the one compiled step that advances it.

Source: the calibration paper, figure 1 (parameter register). `Register.advance` takes n >= 1
samples: one of a stream, a block, or a whole log. All give the same numbers.

| symbol | meaning | shape |
|---|---|---|
| n, o, s | samples, outputs, channels of the schedule | |
| ss | steady-state outputs | (n, o) |
| lagged | deviation of the lags in front of the network; (n, 0) without any | (n, o) |
| features | increments of ss, lagged, ss, schedule: the network's inputs, scaled | (n, f) |
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from narxcal.lumped.engine import LumpedEngine
from narxcal.lumped.states import CASING, FAST, ROWS, Drive
from narxcal.narx.kernels import Layers, fading, free_run
from narxcal.narx.network import AT_START, NarxModel
from narxcal.support.arrays import BoolArray, FloatArray, IntArray
from narxcal.support.compiled import compiled

# An EGT overshoots its final value by up to 1.6 times the change (AGTF30 at frozen speeds).
OVERSHOOT = 2.0


class Network(NamedTuple):
    """The network's arrays as `advance` takes them: weights, bounds, scalings, taps, fading pole.

    `keep` is the pole of the fading bound, negative where there is none.
    """

    layers: Layers
    bounds: tuple[FloatArray, FloatArray]
    inputs: tuple[FloatArray, FloatArray]
    outputs: tuple[FloatArray, FloatArray]
    taps: IntArray
    keep: float


class State(NamedTuple):
    """What lasts from one sample to the next; `advance` changes it in place.

    `ss` (o,) is of the newest sample, `fading` (2, o) the state of the bound, `history` (lags * o,)
    past outputs, newest first, and `past` (last tap, f) features, newest last, both scaled.
    """

    ss: FloatArray
    fading: FloatArray
    history: FloatArray
    past: FloatArray


@compiled(exact=False)
def _rows(
    network: Network,
    state: State,
    samples: tuple[FloatArray, FloatArray, FloatArray],
    increments: FloatArray,
) -> FloatArray:
    """Scaled features of past and new samples (last tap + n, f); fills `increments` (n, o)."""
    schedule, ss, lagged = samples
    count, lags = ss.shape[1], lagged.shape[1]
    depth, width = state.past.shape
    rows = np.empty((depth + len(ss), width))
    rows[:depth] = state.past
    centre, scale = network.inputs
    for k in range(len(ss)):
        row = rows[depth + k]
        for o in range(count):
            increments[k, o] = ss[k, o] - (ss[k - 1, o] if k else state.ss[o])
            row[o] = increments[k, o]
            row[count + lags + o] = ss[k, o]
        row[count : count + lags] = lagged[k]
        row[2 * count + lags :] = schedule[k]
        for i in range(width):
            row[i] = (row[i] - centre[i]) / scale[i]
    return rows


@compiled(exact=False)
def advance(
    network: Network, state: State, samples: tuple[FloatArray, FloatArray, FloatArray]
) -> FloatArray:
    """Deviations (n, o) of lags and network at n further samples: schedule, ss and lagged."""
    ss, lagged = samples[1], samples[2]
    samples_, count = ss.shape
    depth, width = state.past.shape
    increments = np.empty((samples_, count))
    rows = _rows(network, state, samples, increments)
    tapped = np.empty((samples_, len(network.taps) * width))
    for t in range(len(network.taps)):
        first = depth - network.taps[t]
        tapped[:, t * width : (t + 1) * width] = rows[first : first + samples_]
    centre, scale = network.outputs
    limit = np.empty((0, count))
    if network.keep >= 0.0:
        limit = OVERSHOOT * fading(increments, state.fading, network.keep) / scale
    history = state.history
    low, high = network.bounds
    restarts = np.zeros(1, dtype=np.int64), history.copy().reshape(1, len(history))
    run = free_run(tapped, network.layers, restarts, (low, high, limit), keep=False)
    scaled, fed = run[0], run[1]
    state.ss[:] = ss[-1]
    state.past[:] = rows[samples_:]
    history[count:] = fed[-1, : len(history) - count]
    history[:count] = scaled[-1]
    deviation = scaled * scale + centre
    return deviation + lagged if lagged.shape[1] else deviation


class Parts(NamedTuple):
    """What a register runs: network, lags in front of it, sampling interval and fading bound.

    `columns` are those of the schedule among the inputs, which are called `names`. `share` (n_out,)
    of the network's deviation counts; None means all of it.
    """

    narx: NarxModel
    lag: LumpedEngine | None
    dt_s: float
    settle_s: float | None
    names: tuple[str, ...]
    columns: list[int]
    share: FloatArray | None = None


class Sample(NamedTuple):
    """Inputs (n_in,), steady state (n_out,) and deviation (n_out,) at the first sample."""

    inputs: FloatArray
    ss: FloatArray
    deviation: FloatArray


class Register:
    """Runs forward from one sample; the deviation is that of the lags plus the network's."""

    def __init__(self, parts: Parts, first: Sample) -> None:
        self.parts = parts
        self.share: FloatArray | float = 1.0 if parts.share is None else parts.share
        self.network = _network(parts)
        narx, nothing = parts.narx, np.zeros_like(first.deviation)
        # With lags the initial deviation is theirs, else the network's.
        own = first.deviation if parts.lag is None else nothing
        shown = np.empty((1, 0)) if parts.lag is None else first.deviation[None]
        self.lagged = np.zeros((ROWS, len(nothing)))
        self._drive: Drive | None = None
        if parts.lag is not None:
            self.lagged = parts.lag.start(first.deviation)
            self._drive = parts.lag.drive(first.inputs[None], parts.names, first.ss[None])
        schedule = first.inputs[None, parts.columns]
        row = stacked(nothing[None], shown, first.ss[None], schedule)[0]
        self.state = State(
            ss=first.ss.copy(),
            fading=np.stack([nothing, np.abs(own)]),
            history=np.tile(narx.output_scaling.down(own), narx.config.lags),
            past=np.tile(narx.input_scaling.down(row), (int(self.network.taps[-1]), 1)),
        )

    @property
    def vector(self) -> FloatArray:
        """States of the lags that take part, then past deviations of the network (n,)."""
        return np.concatenate([self.lagged[self._used], self.state.history])

    @vector.setter
    def vector(self, values: FloatArray) -> None:
        split = np.count_nonzero(self._used)
        self.lagged[self._used], self.state.history[:] = values[:split], values[split:]

    @property
    def _used(self) -> BoolArray:
        lag = self.parts.lag
        return np.zeros(self.lagged.shape, dtype=np.bool_) if lag is None else lag.used

    def correct(self, outputs: FloatArray) -> None:
        """Replace the newest outputs by measured ones (n_out,); NaN keeps the model's own."""
        scaling, fading_ = self.parts.narx.output_scaling, self.state.fading
        newest = self.state.history[: len(outputs)]
        known = np.isfinite(outputs)
        deviation = self.state.ss - outputs
        if self.parts.lag is None:
            newest[:] = np.where(known, scaling.down(deviation), newest)
            fading_[1] = np.maximum(fading_[1], np.abs(scaling.up(newest)))
        else:
            slow = self.lagged[FAST + 1 : CASING + 1].sum(axis=0)
            fast = deviation - slow - self.share * scaling.up(newest)
            self.lagged[FAST] = np.where(known, fast, self.lagged[FAST])

    def advance(self, inputs: FloatArray, ss: FloatArray) -> FloatArray:
        """Deviations (n, n_out) at the next samples: inputs (n, n_in), steady states (n, n_out)."""
        schedule = np.ascontiguousarray(inputs[:, self.parts.columns])
        lagged = self._lags(inputs, ss)
        samples = schedule, np.ascontiguousarray(ss), lagged
        deviation: FloatArray = advance(self.network, self.state, samples)
        return deviation if self.parts.share is None else lagged + self.share * (deviation - lagged)

    def _lags(self, inputs: FloatArray, ss: FloatArray) -> FloatArray:
        lag = self.parts.lag
        if lag is None or self._drive is None:
            return np.empty((len(ss), 0))
        drive = lag.drive(inputs, self.parts.names, ss)
        start = AT_START, self.lagged[None]
        deviation, self.lagged = lag.run(drive.after(self._drive), start, self.parts.dt_s)
        self._drive = drive.rows(slice(-1, None))
        return deviation[1:]


def _network(parts: Parts) -> Network:
    weights, narx = parts.narx.weights, parts.narx
    return Network(
        layers=weights.layers,
        bounds=weights.bounds,
        inputs=(np.array(narx.input_scaling.centre), np.array(narx.input_scaling.scale)),
        outputs=(np.array(narx.output_scaling.centre), np.array(narx.output_scaling.scale)),
        taps=np.array(narx.config.taps),
        keep=-1.0 if parts.settle_s is None else math.exp(-parts.dt_s / parts.settle_s),
    )


def stacked(
    increments: FloatArray, lagged: FloatArray, ss: FloatArray, schedule: FloatArray
) -> FloatArray:
    """The network's inputs (time, features): what vanishes in equilibrium first."""
    return np.concatenate([increments, lagged, ss, schedule], axis=1)
