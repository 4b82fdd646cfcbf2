"""One sample through the register, compiled: what an engine running beside the model pays for.

`narxcal.register.Register.extend` does the same for a block of samples by array operations, each
of which costs more than all arithmetic of one sample; it is the exact twin of `step`, and its test.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from narxcal.atmosphere import total_ratios
from narxcal.kernels import compiled, fading, free_run
from narxcal.lag_steps import CASING, run_lags

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
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

    `order`, `own` and `sign` are those of `narxcal.lag.Wiring`, and `air` its `air_columns`.
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


@compiled
def _of(given: FloatArray, column: int) -> float:
    return given[column] if column >= 0 else 0.0


@compiled
def _lag(lags: Lags, memory: Memory, given: FloatArray, ss: FloatArray) -> None:
    """Move the lags on by one sample: `drive` and `run` of `narxcal.lag.LagModel` in one."""
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


@compiled
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


@compiled
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


@compiled
def step(
    network: Network, lags: Lags, memory: Memory, given: FloatArray, ss: FloatArray
) -> FloatArray:
    """Deviation (o,) at the next sample, of inputs `given` (n_in,) and steady state `ss` (o,)."""
    lagged = len(lags.parameters) > 0
    if lagged:
        _lag(lags, memory, given, ss)
    return behind(network, memory, (given, ss), lagged)


@compiled
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
