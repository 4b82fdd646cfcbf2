"""Compiled closed-loop kernels of the NARX network, and nothing else.

The network (papers/narx calibration, equations 2 and 3, plus a linear path) is

    y(k) = clip( b2 + A phi(k) + W2 tanh(b1 + W1 phi(k)),  low, high )
    phi(k) = [ y(k-1) .. y(k-n),  u(k-d1) .. u(k-dm) ]

An *anchored* network subtracts its own value at rest, `W2 tanh(b1 + W1 rest(k)) + A rest(k)`,
where `rest` is phi with the feedback and all moving inputs set to zero; it has no b2.

All that depends on the inputs alone is one matrix product, done beforehand:
`drive_hidden = b1 + W1u phi_u` and `drive_linear = b2 + Au phi_u`. Only the feedback
part, `W1y` and `Ay`, is left in the recursion (the value at rest goes into `drive_linear`). The PyTorch module in `narxcal.narx` is the
slow exact twin of these functions and their test.

Shapes: T steps, o outputs, h hidden units, m = lags * o feedback entries (newest lag first),
f = m + input taps features, P parameters in the order W1 (h, f), b1 (h), W2 (o, h), b2 (o),
A (o, f), each flattened by rows.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
_compile: Any = njit(cache=True, nogil=True, fastmath={"contract", "reassoc", "nsz", "arcp"})


@_compile
def free_run(
    drive_hidden: FloatArray,
    drive_linear: FloatArray,
    feedback: tuple[FloatArray, FloatArray, FloatArray],
    history: FloatArray,
    bounds: tuple[FloatArray, FloatArray],
) -> tuple[FloatArray, FloatArray]:
    """Run the network on its own outputs.

    `feedback` is (W1y (h, m), W2 (o, h), Ay (o, m)); `history` (m,) is left holding the last
    `lags` outputs, so that a run can go on where another stopped. Returns outputs (T, o) and
    tanh activations (T, h).
    """
    w1y, w2, ay = feedback
    low, high = bounds
    steps, hidden = drive_hidden.shape
    outputs = drive_linear.shape[1]
    m = history.shape[0]
    y = np.empty((steps, outputs))
    active = np.empty((steps, hidden))
    for k in range(steps):
        for i in range(hidden):
            z = drive_hidden[k, i]
            for j in range(m):
                z += w1y[i, j] * history[j]
            active[k, i] = math.tanh(z)
        for o in range(outputs):
            v = drive_linear[k, o]
            for j in range(m):
                v += ay[o, j] * history[j]
            for i in range(hidden):
                v += w2[o, i] * active[k, i]
            y[k, o] = min(max(v, low[o]), high[o])
        for j in range(m - 1, outputs - 1, -1):
            history[j] = history[j - outputs]
        for o in range(outputs):
            history[o] = y[k, o]
    return y, active


@_compile
def _gain(
    active: FloatArray, feedback: tuple[FloatArray, FloatArray, FloatArray], gain: FloatArray
) -> None:
    """Fill `gain` (o, m) with dy(k)/dhistory at tanh activations `active` (h,)."""
    w1y, w2, ay = feedback
    gain[:] = ay
    for i in range(active.shape[0]):
        slope = 1.0 - active[i] * active[i]
        for o in range(gain.shape[0]):
            c = w2[o, i] * slope
            for j in range(gain.shape[1]):
                gain[o, j] += c * w1y[i, j]


@_compile
def adjoint(
    outer: FloatArray,
    run: tuple[FloatArray, FloatArray],
    feedback: tuple[FloatArray, FloatArray, FloatArray],
    bounds: tuple[FloatArray, FloatArray],
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Back-propagate through time: from dLoss/dy (T, o) to the loss's sensitivities.

    `run` is what `free_run` returned. Returns `total` (T, o) = dLoss/d(drive_linear),
    `hidden` (T, h) = dLoss/d(drive_hidden) and `start` (m,) = dLoss/d(history).
    """
    y, active = run
    _, w2, ay = feedback
    low, high = bounds
    steps, outputs = outer.shape
    units = active.shape[1]
    m = ay.shape[1]
    gain = np.empty((outputs, m))
    # pending[j] is dLoss/d(history entry j) as seen from the step in hand.
    pending = np.zeros(m + outputs)
    total = np.zeros((steps, outputs))
    hidden = np.zeros((steps, units))
    for k in range(steps - 1, -1, -1):
        _gain(active[k], feedback, gain)
        for o in range(outputs):
            inside = low[o] < y[k, o] < high[o]
            total[k, o] = outer[k, o] + pending[o] if inside else 0.0
        for j in range(m):
            pending[j] = pending[j + outputs]
            for o in range(outputs):
                pending[j] += total[k, o] * gain[o, j]
        for i in range(units):
            back = 0.0
            for o in range(outputs):
                back += total[k, o] * w2[o, i]
            hidden[k, i] = back * (1.0 - active[k, i] * active[k, i])
    return total, hidden, pending[:m].copy()


@_compile
def jacobian(
    features: tuple[FloatArray, FloatArray, FloatArray],
    run: tuple[FloatArray, FloatArray],
    feedback: tuple[FloatArray, FloatArray, FloatArray],
    bounds: tuple[FloatArray, FloatArray],
    memory: FloatArray,
) -> FloatArray:
    """Forward sensitivities dy/dtheta (T, o, P) along a free run, for Gauss-Newton steps.

    `features` is phi (T, f), rest (T, f) and the tanh activations at rest (T, h); the latter two
    have no rows if the network is not anchored. `memory` (m, P) is dhistory/dtheta at the start
    and is left at its value at the end, so that a long run can be done in blocks.
    """
    phi, rest, rest_active = features
    anchored = len(rest) > 0
    y, active = run
    w2 = feedback[1]
    low, high = bounds
    steps, outputs = y.shape
    units = active.shape[1]
    m, size = memory.shape
    width = phi.shape[1]
    gain = np.empty((outputs, m))
    result = np.zeros((steps, outputs, size))
    at_b1 = units * width
    at_w2 = at_b1 + units
    at_b2 = at_w2 + outputs * units
    at_a = at_b2 + outputs
    for k in range(steps):
        _gain(active[k], feedback, gain)
        for o in range(outputs):
            row = result[k, o]
            if low[o] < y[k, o] < high[o]:
                for i in range(units):
                    c = w2[o, i] * (1.0 - active[k, i] * active[k, i])
                    base = i * width
                    for j in range(width):
                        row[base + j] = c * phi[k, j]
                    row[at_b1 + i] = c
                    row[at_w2 + o * units + i] = active[k, i]
                base = at_a + o * width
                for j in range(width):
                    row[base + j] = phi[k, j]
                if not anchored:
                    row[at_b2 + o] = 1.0
                else:
                    for i in range(units):
                        c = w2[o, i] * (1.0 - rest_active[k, i] * rest_active[k, i])
                        for j in range(width):
                            row[i * width + j] -= c * rest[k, j]
                        row[at_b1 + i] -= c
                        row[at_w2 + o * units + i] -= rest_active[k, i]
                    for j in range(width):
                        row[base + j] -= rest[k, j]
                for j in range(m):
                    g = gain[o, j]
                    if g != 0.0:
                        past = memory[j]
                        for p in range(size):
                            row[p] += g * past[p]
        for j in range(m - 1, outputs - 1, -1):
            memory[j] = memory[j - outputs]
        for o in range(outputs):
            memory[o] = result[k, o]
    return result
