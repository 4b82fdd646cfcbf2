"""Compiled closed-loop kernels of the NARX network, and nothing else.

The network (papers/narx calibration, equations 2 and 3, plus a linear path) is

    y(k) = clip( b2 + A phi(k) + W2 tanh(b1 + W1 phi(k)),  low, high )
    phi(k) = [ y(k-1) .. y(k-n),  u(k-d1) .. u(k-dm) ]

An *anchored* network subtracts its own value at rest, `W2 tanh(b1 + W1 rest(k)) + A rest(k)`,
where `rest` is phi with the feedback and all moving inputs set to zero; it has no b2.

All that depends on the inputs alone is one matrix product, done beforehand:
`drive_hidden = b1 + W1u phi_u` and `drive_linear = b2 + Au phi_u`, less the value at rest. Only
the feedback part, `W1y` and `Ay`, is left in the recursion. The PyTorch module in `narx.network`
is the slow exact twin of these functions and their test.

Several windows are run as one: `restarts` is (positions (n,), histories (n, m)), the steps at
which a window begins and the outputs just before it.

Shapes: T steps, o outputs, h hidden units, m = lags * o feedback entries (newest lag first),
f = m + input taps features, P parameters in the order W1 (h, f), b1 (h), W2 (o, h), b2 (o),
A (o, f), each flattened by rows.
"""

from __future__ import annotations

import math

import numpy as np

from narxcal.support.arrays import FloatArray, IntArray
from narxcal.support.compiled import compiled

Run = tuple[FloatArray, FloatArray, FloatArray]


@compiled(exact=False)
def _push(register: FloatArray, newest: FloatArray) -> None:
    """Shift `newest` in at the front of `register`."""
    count = len(newest)
    for j in range(len(register) - 1, count - 1, -1):
        register[j] = register[j - count]
    for o in range(count):
        register[o] = newest[o]


@compiled(exact=False)
def free_run(
    drive_hidden: FloatArray,
    drive_linear: FloatArray,
    feedback: tuple[FloatArray, FloatArray, FloatArray],
    restarts: tuple[IntArray, FloatArray],
    bounds: tuple[FloatArray, FloatArray, FloatArray],
) -> Run:
    """Run the network on its own outputs.

    `feedback` is (W1y (h, m), W2 (o, h), Ay (o, m)); `bounds` are low (o,), high (o,) and a
    limit (T, o) on the magnitude at each step, which has no rows where there is none. Returns
    outputs (T, o), tanh activations (T, h) and what was fed back into each step (T, m).
    """
    w1y, w2, ay = feedback
    positions, histories = restarts
    low, high, limit = bounds
    steps, hidden = drive_hidden.shape
    outputs = drive_linear.shape[1]
    m = histories.shape[1]
    history = np.zeros(m)
    y = np.empty((steps, outputs))
    active = np.empty((steps, hidden))
    fed = np.empty((steps, m))
    window = 0
    for k in range(steps):
        if window < len(positions) and positions[window] == k:
            history[:] = histories[window]
            window += 1
        fed[k] = history
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
            # Written so that an overflow to NaN, too, ends inside the bounds.
            y[k, o] = min(v, high[o]) if v > low[o] else low[o]
            if len(limit) > 0:
                y[k, o] = max(min(y[k, o], limit[k, o]), -limit[k, o])
        _push(history, y[k])
    return y, active, fed


@compiled(exact=False)
def fading(increments: FloatArray, state: FloatArray, keep: float) -> FloatArray:
    """Envelope (T, o) of what a slow first-order lag behind moving targets would be off by.

    `increments` (T, o) are those of the targets, `keep` is the lag's pole. With the lag's error
    e(k) = keep (e(k-1) + increment(k)), the envelope is E(k) = max(|e(k)|, keep E(k-1)).
    `state` (2, o) holds e and E before the first step, and is left at their last values.
    """
    steps, outputs = increments.shape
    envelope = np.empty((steps, outputs))
    for k in range(steps):
        for o in range(outputs):
            state[0, o] = keep * (state[0, o] + increments[k, o])
            state[1, o] = max(abs(state[0, o]), keep * state[1, o])
            envelope[k, o] = state[1, o]
    return envelope


@compiled(exact=False)
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


@compiled(exact=False)
def adjoint(
    outer: FloatArray,
    run: Run,
    feedback: tuple[FloatArray, FloatArray, FloatArray],
    positions: IntArray,
    bounds: tuple[FloatArray, FloatArray],
) -> tuple[FloatArray, FloatArray]:
    """Back-propagate through time: from dLoss/dy (T, o) to the loss's sensitivities.

    `run` is what `free_run` returned, `positions` are its restarts. Returns `total` (T, o) =
    dLoss/d(drive_linear) and `hidden` (T, h) = dLoss/d(drive_hidden).
    """
    y, active, _ = run
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
    window = len(positions) - 1
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
        if window >= 0 and positions[window] == k:
            pending[:] = 0.0
            window -= 1
    return total, hidden


@compiled(exact=False)
def _direct(
    row: FloatArray,
    sample: tuple[int, int, float],
    features: tuple[FloatArray, FloatArray],
    weights: FloatArray,
) -> None:
    """Add `sign` times dy_o/dtheta at fixed history to `row` (P,).

    `sample` is (step, output, sign); `features` are phi (T, f) and activations (T, h);
    `weights` is W2.
    """
    k, o, sign = sample
    phi, active = features
    outputs, units = weights.shape
    width = phi.shape[1]
    at_b1 = units * width
    at_w2 = at_b1 + units
    at_a = at_w2 + outputs * units + outputs
    for i in range(units):
        c = sign * weights[o, i] * (1.0 - active[k, i] * active[k, i])
        for j in range(width):
            row[i * width + j] += c * phi[k, j]
        row[at_b1 + i] += c
        row[at_w2 + o * units + i] += sign * active[k, i]
    row[at_a - outputs + o] += sign
    for j in range(width):
        row[at_a + o * width + j] += sign * phi[k, j]


@compiled(exact=False)
def _recall(row: FloatArray, gain: FloatArray, ring: FloatArray, slot: int) -> None:
    """Add what the history passes on, the gains (m,) times its sensitivities, to `row` (P,).

    `ring` is (lags + 1, o, P) in the order of steps, `slot` the place of the step in hand.
    """
    lags, outputs = len(ring) - 1, ring.shape[1]
    for lag in range(lags):
        slot = slot - 1 if slot > 0 else lags
        for o in range(outputs):
            g = gain[lag * outputs + o]
            if g != 0.0:
                past = ring[slot, o]
                for p in range(len(row)):
                    row[p] += g * past[p]


@compiled(exact=False)
def jacobian(
    features: tuple[FloatArray, FloatArray, FloatArray],
    run: Run,
    feedback: tuple[FloatArray, FloatArray, FloatArray],
    restarts: tuple[IntArray, FloatArray],
    scored: tuple[FloatArray, FloatArray, FloatArray],
) -> FloatArray:
    """Weighted forward sensitivities root dy/dtheta (rows, P) along a free run, for Gauss-Newton.

    `features` is phi (T, f), rest (T, f) and the tanh activations at rest (T, h); the latter two
    have no rows if the network is not anchored. `restarts` is (positions (n,), memory (lags, o,
    P)): dhistory/dtheta at the start, newest first, left at its value at the end, so that a long
    run can be done in blocks. `scored` is low (o,), high (o,) and root (T, o), the roots of the
    weights: where one is zero there is no row.

    Only the last `lags` steps are held beside what is returned, each at a place of its own in a
    ring, so that nothing is shifted and the work stays in the processor's cache.
    """
    phi, rest, rest_active = features
    y, active, _ = run
    positions, memory = restarts
    low, high, root = scored
    lags, outputs, size = memory.shape
    gain = np.empty((outputs, lags * outputs))
    result = np.empty((np.count_nonzero(root > 0.0), size))
    ring = np.empty((lags + 1, outputs, size))
    ring[:lags] = memory[::-1]
    slot, window, n = lags, 0, 0
    for k in range(len(y)):
        if window < len(positions) and positions[window] == k:
            ring[:] = 0.0
            window += 1
        _gain(active[k], feedback, gain)
        for o in range(outputs):
            row = ring[slot, o]
            row[:] = 0.0
            if low[o] < y[k, o] < high[o]:
                _direct(row, (k, o, 1.0), (phi, active), feedback[1])
                if len(rest):
                    _direct(row, (k, o, -1.0), (rest, rest_active), feedback[1])
                _recall(row, gain[o], ring, slot)
            if root[k, o] > 0.0:
                result[n] = root[k, o] * row
                n += 1
        slot = slot + 1 if slot < lags else 0
    for lag in range(lags):
        slot = slot - 1 if slot > 0 else lags
        memory[lag] = ring[slot]
    return result
